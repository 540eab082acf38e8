"""What the studies of a document have in common, said once, and what sets each apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from reports.load import StudyResults
from reports.tables import Row, setting_rows, time_rows

Named = Sequence[tuple[str, Sequence[tuple[str, str]]]]  # per study its name and its facts (what, value)


def shared_sentences(said: Sequence[Sequence[str]]) -> list[str]:
    """The sentences that all of several studies say, in their order; none of a single study."""
    if len(said) < 2:
        return []
    return [sentence for sentence in said[0] if all(sentence in other for other in said[1:])]


def merged_facts(named: Named) -> list[tuple[str, list[tuple[str, str]]]]:
    """(what, [(studies, value)]) of all facts: one value without a name where all studies agree, else each once."""
    merged: dict[str, dict[str, list[str]]] = {}
    for name, facts in named:
        for what, value in facts:
            merged.setdefault(what, {}).setdefault(value, []).append(name)
    return [
        (what, [("" if len(names) == len(named) else ", ".join(names), value) for value, names in values.items()])
        for what, values in merged.items()
    ]


def merged_methods(named: Sequence[tuple[str, StudyResults]]) -> list[Row]:
    """Rows of `tables.setting_rows` of all studies: one per method, or per its settings where studies differ.

    `studies` names those that a row holds for, and is empty where it holds for all that have the method.
    """
    rows: dict[str, dict[str, Row]] = {}
    for name, study in named:
        for row in setting_rows(study):
            same = rows.setdefault(row["label"], {}).setdefault(repr(row), row | {"names": []})
            same["names"].append(name)
    return [
        {key: value for key, value in row.items() if key != "names"}
        | {"studies": "" if len(different) == 1 else ", ".join(row["names"])}
        for different in rows.values()
        for row in different.values()
    ]


def common_times(studies: Sequence[StudyResults]) -> list[Row] | None:
    """`tables.time_rows` over all conditions together; None where their methods or example counts differ."""
    first = studies[0]
    if any(_columns(study) != _columns(first) for study in studies):
        return None
    cells = [study.cells.assign(source=f"{i} " + study.cells["source"]) for i, study in enumerate(studies)]
    return time_rows(replace(first, cells=pd.concat(cells, ignore_index=True)))


def _columns(study: StudyResults) -> tuple[list[str], list[int]]:
    return [method.name for method in study.methods], list(study.facts["n_examples"])
