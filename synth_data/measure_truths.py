"""What docs/truths.md reports: `python -m synth_data.measure_truths [people]`."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from retarget.rig.ebfr import EbfrSettings
from retarget.types import FloatArray, IntArray
from synth_data.cache import ArrayCache
from synth_data.makehuman.anthropometry import personalisation
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.rig import generic_rig, person_of
from synth_data.makehuman.targets import load_head
from synth_data.personal.face import personal_face
from synth_data.personal.scans import personal_scans
from synth_data.truth import GenericRig, Person, cast, truth_kinds
from synth_data.truths.ebfr_arkit import HELD, Rigger, generic_units
from synth_data.weights import blending_weights

FOLDS = 4  # a scan in so many is held out at a time
FRAMES = 40  # recombined expressions over which kinds are compared
SETTINGS = {
    "held, beta 0.01": HELD,
    "held, beta 0.1": EbfrSettings(beta_first=0.1, beta_last=0.1, alternations=1),
    "published": EbfrSettings(),
}


@dataclass(frozen=True)
class Session:
    """The scans of one person."""

    neutral: FloatArray  # (n, 3) mm
    frames: FloatArray  # (j, n, 3) mm
    weights: FloatArray  # (j, 51)

    @classmethod
    def of(cls, person: Person, generic: GenericRig) -> Session:
        face = personal_face(person.neutral, generic.faces, generic.regions, person.traits)
        scans = personal_scans(face)
        return cls(person.neutral, *(np.stack([getattr(s, what) for s in scans]) for what in ("vertices", "weights")))

    @property
    def motions(self) -> FloatArray:
        return self.frames - self.neutral

    def missed(self, deltas: FloatArray) -> FloatArray:
        """(j, n, 3) mm by which a rig's blend with the weights that were asked for misses the scans."""
        return self.motions - blended(self.weights, deltas)


def blended(weights: FloatArray, deltas: FloatArray) -> FloatArray:
    return np.tensordot(weights, deltas, axes=1)


def distance(motion: FloatArray, region: IntArray) -> float:
    """Mean length in mm over frames (t, n, 3) and the vertices of a region."""
    return float(np.linalg.norm(motion[:, region], axis=2).mean())


def held_out(rigger: Rigger, session: Session, region: IntArray) -> float:
    """Mean distance in mm of scans to rigs that were made without them."""
    errors = []
    for fold in range(FOLDS):
        out = np.arange(len(session.frames)) % FOLDS == fold
        deltas = rigger(session.neutral, session.frames[~out], session.weights[~out])
        errors.append(distance(session.missed(deltas)[out], region))
    return float(np.mean(errors))


def span_residual(motions: FloatArray, deltas: FloatArray, region: IntArray) -> tuple[float, float]:
    """RMS in mm of what motions (j, n, 3) have outside of the span of deltas (51, n, 3), and its share of them."""
    basis, wanted = (each[:, region].reshape(len(each), -1).T for each in (deltas, motions))
    left = wanted - basis @ np.linalg.lstsq(basis, wanted, rcond=None)[0]
    count = len(region) * len(motions)
    return float(np.sqrt((left**2).sum() / count)), float(np.sqrt((left**2).sum() / (wanted**2).sum()))


def differ(motions: Sequence[FloatArray], region: IntArray) -> float:
    """Mean over pairs of people of the share of the motion by which they differ."""
    return float(np.mean([personalisation(a, b, region) for a, b in itertools.combinations(motions, 2)]))


def table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    print(f"\n| {' | '.join(columns)} |\n| {' | '.join('---' for _ in columns)} |")
    for row in rows:
        print(f"| {' | '.join(row)} |", flush=True)


def transferred(rigger: Rigger, session: Session) -> FloatArray:
    """(51, n, 3) mm: the rig of deformation transfer alone."""
    return rigger(session.neutral, session.frames[:0], session.weights[:0])


def main(people: str = "4") -> None:
    head, targets = load_head(progress=print)
    regions = load_regions()
    region, sampler = regions.vertices["head"], IdentitySampler(head, targets, regions)
    generic, cache = generic_rig(head, targets, regions), ArrayCache.of(None)
    persons = {f"person-{seed:03d}": person_of(sampler(seed)) for seed in range(int(people))}
    sessions = [Session.of(person, generic) for person in persons.values()]
    units = generic_units(generic, cache)

    def mean(values: Iterable[float], digits: int = 2) -> str:
        return f"{np.mean(list(values)):.{digits}f}"

    print(
        f"\nScans move the head by {mean(distance(s.motions, region) for s in sessions)} mm. Mean distance to them, mm:"
    )
    choices = [("average traits", units, name) for name in SETTINGS]
    choices.append(("the artist's", generic.deltas, "held, beta 0.01"))
    rows: list[tuple[str, ...]] = []
    for template, deltas, name in choices:
        rigger = Rigger(generic, deltas, SETTINGS[name])
        plain = mean(distance(s.missed(transferred(rigger, s)), region) for s in sessions)
        given = mean(distance(s.missed(rigger(s.neutral, s.frames, s.weights)), region) for s in sessions)
        rows.append((template, name, plain, mean(held_out(rigger, s, region) for s in sessions), given))
    table(("template", "settings", "deformation transfer", "rigs without the scan", "rigs with it"), rows)

    weights = blending_weights("recombined", FRAMES)
    names = truth_kinds()
    performed: dict[str, list[FloatArray]] = {}
    asked: dict[str, list[FloatArray]] = {}
    for kind in names:
        performers = cast(kind, generic, persons, weights, cache, print)
        performed[kind] = [performers[name](weights) - person.neutral for name, person in persons.items()]
        asked[kind] = [performers[name](s.weights) - s.neutral for name, s in zip(persons, sessions, strict=True)]
    plain_rigs = [transferred(Rigger(generic, units, HELD), s) for s in sessions]
    asked["deformation transfer alone"] = [blended(s.weights, rig) for s, rig in zip(sessions, plain_rigs, strict=True)]
    performed["deformation transfer alone"] = [blended(weights, rig) for rig in plain_rigs]
    print("\nTwo people differ by this share of their motion:")
    rows = [(kind, f"{differ(asked[kind], region):.0%}", f"{differ(performed[kind], region):.0%}") for kind in asked]
    table(("kind", "the scans' weights", f"{FRAMES} recombined expressions"), rows)

    print("\nMean distance in mm between two kinds, same person and weights; on the diagonal the motion:")
    rows = []
    for one in names:
        pairs = [list(zip(performed[one], performed[other], strict=True)) for other in names]
        rows.append((one, *(mean(distance(a if a is b else a - b, region) for a, b in each) for each in pairs)))
    table(("", *names), rows)

    print("\nScans outside of the span of 51 units:")
    rigs = [Rigger(generic, units, HELD)(s.neutral, s.frames, s.weights) for s in sessions]
    spans = {
        "the artist's": [generic.deltas] * len(sessions),
        "average traits": [units] * len(sessions),
        "ebfr_arkit": rigs,
    }
    rows = []
    for name, bases in spans.items():
        found = np.mean(
            [span_residual(s.motions, basis, region) for s, basis in zip(sessions, bases, strict=True)], axis=0
        )
        rows.append((name, f"{found[0]:.2f}", f"{found[1]:.0%}"))
    table(("units", "RMS (mm)", "share of the motion"), rows)


if __name__ == "__main__":
    main(*sys.argv[1:])
