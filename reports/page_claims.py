"""Published claims on the page: those that its studies say something of as a table, all others as a list."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

from reports.page_lists import named_list
from reports.page_tables import Cell, Column, table

Claim = Mapping[str, Any]
_CLASSES = {"reproduced": "good", "not reproduced": "alarm", "inconclusive": "", "not testable": "muted"}


def claims_part(claims: Mapping[str, Any]) -> str:
    """`claims` is what `reports.report.alone` made of them."""
    counts = ", ".join(f"{count} {status}" for status, count in claims["counts"].items())
    said = (
        "Claims of Wagner, Schwanecke and Botsch 2024, each with a rule that was written down before it was tested. "
        f"Of {sum(claims['counts'].values())} claims, by the records of this page: {counts}. A difference counts as "
        f"found where the test on pairs (Holm's correction over the {claims['family']} claims of a difference, a "
        "family of their own beside the primary family of the tests), the tests on sources and on targets and the "
        "bootstrap interval agree, which takes at least 6 people. That two methods hardly differ is reproduced where "
        "the interval of the ratio lies inside the margin, not where it lies outside, and is inconclusive where it "
        "overlaps a bound. A claim is reproduced where every study that can test it finds it."
    )
    shown = _table(claims["shown"], claims["several"]) if claims["shown"] else ""
    return f"<p class='muted'>{escape(said)}</p>{shown}{_untested(claims['untested'])}"


def _table(claims: list[Claim], several: bool) -> str:
    """A row for each claim and each study that says something of it."""
    published = any(claim["published"] for claim in claims)
    heads = ["section", "examples", *["published"] * published, "status", *["study", "there"] * several, "ours", "why"]
    columns = [Column("claim", words=True), *(Column(head, words=head != "examples") for head in heads)]
    rows = (
        list(_cells(claim, verdict, published, several))
        for claim in claims
        for verdict in claim["verdicts"]
        if verdict["study"]
    )  # fmt: skip
    caption = "Ours: ratio of geometric means with its 95 % interval; below 1, the first is smaller."
    return table(columns, rows, caption)


def _cells(claim: Claim, verdict: Claim, published: bool, several: bool) -> Iterator[Cell | str]:
    yield from (claim["says"], claim["section"], ", ".join(map(str, claim["counts"])))
    if published:
        yield claim["published"]
    yield _status(claim["status"])
    if several:
        yield from (verdict["study"], _status(verdict["status"]))
    yield from (Cell(verdict["value"], claim["compared"]), verdict["sentence"])


def _status(word: str) -> Cell:
    return Cell(word, classes=_CLASSES[word])


def _untested(claims: list[Claim]) -> str:
    if not claims:
        return ""
    listed = named_list([(claim["says"], _why(claim)) for claim in claims])
    return f"<details><summary>{len(claims)} claims that these records cannot test</summary>{listed}</details>"


def _why(claim: Claim) -> str:
    counts = f"; {' and '.join(map(str, claim['counts']))} examples" if claim["counts"] else ""
    published = f"; published: {claim['published']}" if claim["published"] else ""
    return f"({claim['section']}{counts}{published}) {claim['verdicts'][0]['sentence']}"
