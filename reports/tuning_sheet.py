"""The pages of a study of the kind `tuning`, and their tables as Markdown: from its files alone, no method runs."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from reports.sheet import Picture, PictureRow, Pictures, Table, write_sheet
from reports.text import number
from reports.tuning_figures import Space, curves, slices
from retarget.check import InvalidInput
from retarget.io.files import write_whole

CHOSEN = "*"  # marks the chosen trial in a table


def build_tuning_sheet(folder: Path) -> Path:
    """Write ``tuning.pdf`` and ``tables.md`` beside the study's files; returns the path of the PDF.

    Raises InvalidInput for a folder without a finished study of this kind.
    """
    try:
        facts = json.loads((folder / "study.json").read_text(encoding="utf-8"))
        trials = pd.read_csv(folder / "trials.csv").astype({"trial": "Int64"})
    except FileNotFoundError as error:
        raise InvalidInput(f"{error.filename}: this file is missing; run study=tuning until it ends.") from error
    spaces: Mapping[str, Space] = facts["config"]["study"]["spaces"]
    counts: list[int] = facts["n_examples"]
    found = {method: trials[trials["method"] == method].reset_index(drop=True) for method in spaces}
    alone = {method: mine for method, mine in found.items() if len(spaces[method]) == 1}
    several = {method: mine for method, mine in found.items() if method not in alone}
    choices = choice_table(found, spaces, counts)
    compared = comparison_table(trials[trials["trial"].isna()], counts)
    grids = [grid_table(part, setting, counts) for setting, part in _same_grid(alone, spaces)]
    points = {method: trial_table(mine, list(spaces[method]), method, counts) for method, mine in several.items()}
    with tempfile.TemporaryDirectory(prefix="sheet-") as name:
        work = Path(name)
        blocks: list[Pictures | Table] = [choices]
        if alone:
            curves(alone, spaces, counts, work / "curves.svg")
            blocks += [_alone("curves.svg", "Mean vertex error over the setting that was searched."), *grids]
        for method, table in points.items():
            slices(several[method], spaces[method], method, work / f"{method}.svg")
            caption = f"{method}: error of every trial, averaged over the numbers of examples, over each setting."
            blocks += [_alone(f"{method}.svg", caption), table]
        if compared.rows:
            blocks.append(compared)
        write_sheet(folder / "tuning.pdf", facts["title"], _description(facts), blocks, work)
    text = "\n".join(markdown(table) for table in (choices, *grids, *points.values(), compared) if table.rows)
    write_whole(folder / "tables.md", lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return folder / "tuning.pdf"


def choice_table(found: Mapping[str, pd.DataFrame], spaces: Mapping[str, Space], counts: Sequence[int]) -> Table:
    """What was chosen for each method, with its error, the present one and the smallest."""
    rows = []
    for method, mine in found.items():
        present, chosen = mine[mine["trial"] == 0].iloc[0], mine[mine["chosen"]]
        if chosen.empty:
            rows.append((method, "none: no trial finished", "", _mean(present), "", ""))
            continue
        best = mine.sort_values(["error", "trial"]).iloc[0]
        said = f"trial {chosen.iloc[0]['trial']}"
        if len(spaces[method]) == 1:
            [setting] = spaces[method]
            said = f"{setting} {scientific(chosen.iloc[0][setting])}"
        if chosen.iloc[0]["trial"] == 0:
            said = f"as it is ({said})"
        rows.append((method, said, _mean(chosen.iloc[0]), _mean(present), _mean(best), str(best["trial"])))
    caption = (
        f"Error in mm, averaged over {_counts(counts)} examples: of the chosen trial, of the present configuration "
        "(trial 0), and the smallest of all trials."
    )
    return Table(("method", "chosen", "error", "present", "smallest", "in trial"), tuple(rows), caption)


def grid_table(found: Mapping[str, pd.DataFrame], setting: str, counts: Sequence[int]) -> Table:
    """Methods side by side that were searched on the same values of one setting."""
    first = next(iter(found.values())).sort_values(setting)
    by_value = {method: mine.set_index(setting) for method, mine in found.items()}
    rows = tuple(
        (scientific(value), *(_errors(mine.loc[value], counts) for mine in by_value.values()))
        for value in first[setting]
    )
    return Table((setting, *found), rows, f"Error in mm with {_counts(counts)} examples; {CHOSEN} chosen.")


def trial_table(mine: pd.DataFrame, settings: Sequence[str], method: str, counts: Sequence[int]) -> Table:
    """Every trial of one method, the smallest error first."""
    rows = tuple(
        (
            f"{row['trial']} {CHOSEN}" if row["chosen"] else str(row["trial"]),
            *(scientific(row[name]) for name in settings),
            _errors(row, counts, mark=False),
            _mean(row),
        )
        for _, row in mine.sort_values(["error", "trial"]).iterrows()
    )
    heads = ("trial", *settings, " / ".join(map(str, counts)), "mean")
    return Table(heads, rows, f"{method}: error in mm with {_counts(counts)} examples; 0 present, {CHOSEN} chosen.")


def comparison_table(others: pd.DataFrame, counts: Sequence[int]) -> Table:
    """Rows that were not tuned."""
    rows = tuple((str(row["method"]), _errors(row, counts), _mean(row)) for _, row in others.iterrows())
    return Table(("for comparison", "error", "mean"), rows, f"Error in mm with {_counts(counts)} examples, not tuned.")


def markdown(table: Table) -> str:
    """A table in the form of the project's documentation, its caption below."""
    lines = [table.heads, ("---",) * len(table.heads), *table.rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + f"\n\n{table.caption}\n"


def scientific(value: Any) -> str:
    """Numbers as in 4.6e-6, others as they are."""
    if not isinstance(value, float):
        return str(value)
    if 0.01 <= abs(value) < 1e5 or value == 0:
        return f"{value:g}"
    digits, exponent = f"{value:.1e}".split("e")
    return f"{digits}e{int(exponent)}"


def _same_grid(alone: Mapping[str, pd.DataFrame], spaces: Mapping[str, Space]) -> list[tuple[str, dict[str, Any]]]:
    """Methods that were searched on the same values of the same setting, together."""
    groups: dict[tuple[str, tuple[Any, ...]], dict[str, Any]] = {}
    for method, mine in alone.items():
        [setting] = spaces[method]
        groups.setdefault((setting, tuple(sorted(mine[setting]))), {})[method] = mine
    return [(setting, part) for (setting, _), part in groups.items()]


def _alone(file: str, caption: str) -> Pictures:
    return Pictures(("",), (1.0,), (PictureRow((Picture(file),)),), caption)


def _description(facts: Mapping[str, Any]) -> str:
    pairs = len(facts["identities"]) * (len(facts["identities"]) - 1)
    study = facts["config"]["study"]
    draws = "1 draw" if facts["draws"] == 1 else f"{facts['draws']} draws"
    return (
        f"{facts['description']} {study['trials']} trials of each; {pairs} ordered pairs of "
        f"{len(facts['identities'])} identities that no other study uses ({', '.join(facts['identities'])}), "
        f"{facts['vertices']:,} vertices, {draws}, {study['test_expressions']} test expressions each."
    )


def _errors(row: pd.Series[Any], counts: Sequence[int], mark: bool = True) -> str:
    said = " / ".join(number(row[f"error_{count}"]) for count in counts)
    if row["n_failed"]:
        said = f"{row['n_failed']} cells failed"
    return f"{said} {CHOSEN}" if mark and row["chosen"] else said


def _mean(row: pd.Series[Any]) -> str:
    return number(row["error"], 4)


def _counts(counts: Sequence[int]) -> str:
    return " / ".join(map(str, counts))
