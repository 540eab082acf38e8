"""What an evaluation cannot show: sentences that follow from its records."""

from __future__ import annotations

from collections.abc import Iterator

from reports.claims import FEWEST
from reports.findings import favours
from reports.folders import Gathered
from reports.load import StudyResults

_ARTIST = (
    "No person judged the results. A small error is not the same as a natural expression, and what the eye forgives or "
    "minds is not measured. What the paper's participants preferred is neither confirmed nor refuted here."
)


_TRUTHS = (
    "Truth is made by a model, and every model favours the methods that resemble it; what each favours stands beside "
    "what was found."
)


def limits(gathered: Gathered, truths: bool = True) -> Iterator[tuple[str, str]]:
    """(heading, text) for each thing that these results leave open.

    truths: whether what each kind of truth favours is repeated; False where the same document has it already.
    """
    studies = [study for group in gathered.groups for study in group]
    yield "People who judge.", _ARTIST
    found = _truths(studies)
    for truth, text in found.items() if truths else ():
        yield f"Truth {truth}.", text
    if found and not truths:
        yield "Truth.", _TRUTHS
    if studies:
        people = min(len(study.facts["identities"]) for study in studies)
        few = f"Fewer than {FEWEST} carry no claim at all. " if people < FEWEST else ""
        pairs = (
            "Pairs share people: thirty pairs of six are not thirty samples, and a claim is about people like those "
            f"that were drawn. {few}The smallest study here has {people}."
        )
        own = (
            "All methods are written anew from the papers. What a paper leaves open was decided, weights were tuned on "
            "other identities; the authors' own code may do better."
        )
        yield "Few people.", pairs
        yield "Implementations.", own
        noise = sorted({float(study.facts["dataset"]["noise_mm"]) for study in studies})
        if noise == [0.0]:
            yield (
                "Scans.",
                "Data are without noise: what a scanner adds, and what registration gets wrong, is not seen.",
            )
    correspondences = {str(study.cells["correspondence"].iloc[0]) for study in studies if len(study.cells)}
    if correspondences == {"given"}:
        yield (
            "Correspondence.",
            (
                "The source's counterparts of the examples are given. Finding them (section 3.5 of the paper) is not "
                "measured here; `study=embedding` does."
            ),
        )
    shown = {study.facts["study"] for study in studies} | {sheet.study for sheet in gathered.sheets}
    if "temporal" not in shown:
        yield (
            "Motion.",
            "Expressions are measured one by one; nothing is said of flicker or of timing. `study=temporal` does.",
        )
    if "collision" not in gathered.tables:
        yield (
            "Contact.",
            "Collisions of lips are not among these results; `study=collision` shows them. Lids and teeth never are.",
        )
    yield "Skin.", "A mesh has no wrinkles finer than its edges, no colour and no light: what these add is not judged."
    for left in gathered.left_out:
        yield "Not included.", left


def _truths(studies: list[StudyResults]) -> dict[str, str]:
    return {str(study.facts["dataset"]["truth"]): favours(study) for study in studies if favours(study)}
