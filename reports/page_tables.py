"""The tables of the page: what `reports.report.describe` prints, as HTML. Every word from outside is escaped."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

Content = Mapping[str, Any]
_ALARMING = ("no result", "not run")


@dataclass(frozen=True)
class Cell:
    """One cell: its text, a smaller word after it, CSS classes and a colour below (with white letters if `dark`)."""

    text: str
    note: str = ""
    classes: str = ""
    fill: str = ""
    dark: bool = False

    def html(self, tag: str = "td") -> str:
        classes = " ".join(filter(None, (self.classes, "alarm" if self.text in _ALARMING else "")))
        style = f"background:{self.fill};color:{'#fff' if self.dark else '#000'}" if self.fill else ""
        attributes = "".join(
            f' {name}="{escape(value)}"'
            for name, value in (("class", classes), ("style", style), ("data-key", self.text if self.note else ""))
            if value
        )
        scope = ' scope="row"' if tag == "th" else ""
        note = f" <small>{escape(self.note)}</small>" if self.note else ""
        return f"<{tag}{scope}{attributes}>{escape(self.text).replace('_', '_<wbr>')}{note}</{tag}>"


@dataclass(frozen=True)
class Column:
    """The head of a column; neighbours of the same `group` stand below one head."""

    name: str
    group: str = ""
    words: bool = False  # aligned to the left


def table(columns: Sequence[Column], rows: Iterable[Sequence[Cell | str]], caption: str = "") -> str:
    """A table that sorts by a click; the first column names the row. The caption is text."""
    body = "".join(_row(columns, row) for row in rows)
    heads = "".join(
        f'<th scope="col"{_class(column)}><button type="button">{escape(column.name) or "&nbsp;"}</button></th>'
        for column in columns
    )
    groups = _groups(columns) if any(column.group for column in columns) else ""
    said = f'<p class="muted caption">{escape(caption)}</p>' if caption else ""
    name = escape(caption or columns[0].name)
    return (
        f'{said}<div class="wide" tabindex="0" role="region" aria-label="{name}"><table>'
        f"<thead>{groups}<tr>{heads}</tr></thead><tbody>{body}</tbody></table></div>\n"
    )


def _row(columns: Sequence[Column], row: Sequence[Cell | str]) -> str:
    cells = [cell if isinstance(cell, Cell) else Cell(cell) for cell in row]
    marked = [
        Cell(c.text, c.note, " ".join(filter(None, (c.classes, "words" if column.words else ""))), c.fill, c.dark)
        for c, column in zip(cells, columns, strict=True)
    ]
    return f"<tr>{marked[0].html('th')}{''.join(cell.html() for cell in marked[1:])}</tr>\n"


def _class(column: Column) -> str:
    return ' class="words"' if column.words else ""


def _groups(columns: Sequence[Column]) -> str:
    spans: list[tuple[str, int]] = []
    for column in columns:
        if spans and spans[-1][0] == column.group:
            spans[-1] = (column.group, spans[-1][1] + 1)
        else:
            spans.append((column.group, 1))
    return "<tr>" + "".join(f'<th colspan="{n}" class="group">{escape(name)}</th>' for name, n in spans) + "</tr>"


def _named(row: Content) -> Cell:
    notes = {"control": "(control)", "reference": "no method"}
    note = notes.get(str(row.get("kind")), "")
    if row.get("reference") is True:
        note = f"{note} reference".strip()
    return Cell(row["label"], note)


def summary_table(counts: Sequence[int], rows: Sequence[Content], caption: str) -> str:
    """Mean, interval and ratio of every row at each example count."""
    columns = [Column("method", words=True)]
    columns += [Column(name, f"{n} examples", name == "95 % interval") for n in counts for name in _MEASURED]
    return table(columns, ([_named(row), *_measured(row["cells"])] for row in rows), caption)


_MEASURED = ("mean", "95 % interval", "ratio")


def _measured(cells: Sequence[Content]) -> Iterator[Cell]:
    for c in cells:
        failed = f"{c['failed']} missing" if c["failed"] else ""
        yield Cell(c["value"], failed, "best" if c["best"] else "")
        yield Cell(c["interval"], classes="muted")
        yield Cell(c["ratio"])


def region_table(part: Content) -> str:
    columns = [Column("method", words=True), *(Column(name) for name in part["regions"])]
    rows = (
        [_named(row), *(Cell(c["text"], "", "best" if c["strong"] else "", c["fill"], c["dark"]) for c in row["cells"])]
        for row in part["rows"]
    )
    return table(columns, rows, f"{part['count']} examples")


_TESTED = ("ratio", "interval", "effect", "wins", "p", "adjusted", "p_sources", "p_targets", "p_naive")


def tests_table(rows: Sequence[Content], adjusted: str, caption: str) -> str:
    heads = ("ratio", "95 % interval", "effect", "wins", "p", adjusted, "p sources", "p targets", "p naive")
    columns = [Column("method", words=True), Column("examples"), Column("pairs")]
    columns += [Column(name, words=name == "95 % interval") for name in heads]

    def classes(row: Content, key: str) -> str:
        return "muted" if key == "p_naive" else "best" if key == "adjusted" and row["strong"] else ""

    body = (
        [r["label"], str(r["count"]), str(r["pairs"]), *(Cell(r[key], classes=classes(r, key)) for key in _TESTED)]
        for r in rows
    )
    return table(columns, body, caption)


def measures_table(rows: Sequence[Content], reference: str, caption: str) -> str:
    heads = ("examples", "measure", "mean", reference, "ratio", "95 % interval", "wins", "p")
    columns = [Column("row", words=True), *(Column(h, words=h in ("measure", "95 % interval")) for h in heads)]
    body = (
        [r["label"], str(r["count"]), r["measure"], r["mean"], r["reference"], r["ratio"],
         r["interval"], r["wins"], r["p"] if r["pairs"] else r["adjusted"]]
        for r in rows
    )  # fmt: skip
    return table(columns, body, caption)


def correspondence_table(rows: Sequence[Content], caption: str) -> str:
    heads = ("examples", "correspondence", "ratio", "95 % interval", "wins", "p")
    columns = [Column("method", words=True)]
    columns += [Column(h, words=h in ("correspondence", "95 % interval")) for h in heads]
    body = (
        [r["method"], str(r["count"]), r["label"], r["ratio"], r["interval"], r["wins"],
         r["p"] if r["pairs"] else r["adjusted"]]
        for r in rows
    )  # fmt: skip
    return table(columns, body, caption)


def times_table(counts: Sequence[int], rows: Sequence[Content], caption: str) -> str:
    columns = [Column("method", words=True), Column("set-up per pair")]
    columns += [Column(f"fit, {n} examples") for n in counts]
    columns += [Column("per expression")]

    def cell(q: Content) -> Cell:
        return Cell(q["median"], q["range"])

    body = ([r["label"], cell(r["prepare"]), *map(cell, r["fit"]), cell(r["frame"])] for r in rows)
    return table(columns, body, caption)


def status_table(rows: Sequence[Content]) -> str:
    columns = [Column("method", words=True), Column("examples"), Column("status", words=True)]
    columns += [Column("cells"), Column("reason", words=True)]
    body = (
        [r["label"], str(r["count"]), Cell(r["status"], classes="" if r["status"] == "not converged" else "alarm"),
         f"{r['cells']} of {r['of']}", r["reason"]]
        for r in rows
    )  # fmt: skip
    return table(columns, body)


def solves_table(rows: Sequence[Content], caption: str) -> str:
    keys = ("count", "solves", "late", "failed")
    columns = [Column("method", words=True), *map(Column, ("examples", "solves", "not converged", "failed"))]
    return table(columns, ([r["label"], *(str(r[key]) for key in keys)] for r in rows), caption)


def settings_table(rows: Sequence[Content]) -> str:
    columns = [Column(name, words=True) for name in ("name", "what it does", "settings")]
    return table(columns, ([_named(r), r["description"], ", ".join(map(str, r["settings"]))] for r in rows))


def everything_table(everything: Content) -> str:
    """Means of all that was measured at one number of examples."""
    columns = [Column("measure", words=True), Column("region", words=True), Column("unit", words=True)]
    columns += [Column(label) for label in everything["labels"]]
    body = (
        [r["measure"], r["region"].replace("_", " "), "" if r["unit"] == "1" else r["unit"], *r["cells"]]
        for r in everything["rows"]
    )
    return table(columns, body, f"Means over pairs with {everything['count']} examples.")


def glossary_table(rows: Sequence[Content], caption: str) -> str:
    columns = [Column(name, words=True) for name in ("measure", "unit", "better", "what it is")]
    return table(columns, ([r["name"], r["unit"], r["better"], r["says"]] for r in rows), caption)


def agreement_table(counts: Sequence[int], rows: Sequence[Content], caption: str) -> str:
    columns = [Column("condition", words=True), Column("condition", words=True)]
    columns += [Column(f"{n} examples") for n in counts]
    return table(columns, ([r["first"], r["second"], *r["tau"]] for r in rows), caption)


def ordering_table(conditions: Sequence[str], part: Content) -> str:
    """Rank, mean and interval under every condition."""
    heads = ("rank", "mean", "95 % interval")
    columns = [Column("method", words=True)]
    columns += [Column(head, name, head == "95 % interval") for name in conditions for head in heads]

    def cells(row: Content) -> Iterator[Cell]:
        for c in row["cells"]:
            best = "best" if c.get("best") else ""
            missing = c["mean"] == "no result"
            yield Cell("" if missing else c["rank"], classes=best)
            yield Cell(c["mean"], classes=best)
            yield Cell("" if missing else c["interval"], classes="muted")

    return table(columns, ([_named(row), *cells(row)] for row in part["rows"]), f"{part['count']} examples")
