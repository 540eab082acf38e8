"""What a results folder must hold to be reported: checked once, when it is read.

All refusals are InvalidInput that name the file, what was expected and what came.
"""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_bool_dtype, is_integer_dtype, is_numeric_dtype

from reports.cells import CONDITIONS, FINISHED, check_metrics
from retarget.check import InvalidInput
from retarget.types import IntArray

_AGAIN = "The results were changed after the study wrote them; run it again, finished cells are reused."
_CELL = ("method", "source", "target", "n_examples", "draw", *CONDITIONS)
_VALUE = (*_CELL, "expression", "metric", "region")
_CELL_COLUMNS = (
    "cell", *_CELL, "status", "reason", "prepare_seconds", "fit_seconds", "seconds_per_expression", "peak_memory_mb",
)  # fmt: skip
_WHOLE = ("n_examples", "draw")
_NUMBERS = (
    "value", "noise_mm", "prepare_seconds", "fit_seconds", "seconds_per_expression", "peak_memory_mb",
)  # fmt: skip
_WORDS = {str: "a text", int: "a whole number", float: "a number", dict: "named entries", list: "a list"}
_FACTS: Mapping[str, Any] = {  # of study.json; a mapping stands for named entries, a list for entries of one kind
    "study": str, "title": str, "description": str, "config": dict, "reference": str, "primary_family": [str],
    "primary_metric": str, "primary_region": str,
    "methods": [{"name": str, "label": str, "description": str, "kind": str, "settings": dict}],
    "n_examples": [int], "draws": int, "identities": [str], "expressions": int, "vertices": int, "faces": int,
    "dataset": {"name": str, "truth": str, "weights": str, "noise_mm": float, "favours": str, "fingerprint": str},
    "provenance": {
        "project_version": str, "code_hash": str, "python": str, "platform": str, "cores": int, "threads": int,
        "packages": dict, "started": str, "finished": str, "wall_seconds": float, "seed": int,
    },
}  # fmt: skip
_OPTIONAL: Mapping[str, Any] = {"tables": [list], "measures": dict, "glossary": dict}


def check_facts(path: Path, facts: Mapping[str, Any]) -> None:
    """Raises InvalidInput unless study.json holds what a report prints of it."""
    if missing := [name for name in _FACTS if name not in facts]:
        raise InvalidInput(f"{path}: expected the entries {', '.join(missing)}; run the study again.")
    _check_entry(path, "", facts, _FACTS)
    _check_entry(path, "", facts, {name: kind for name, kind in _OPTIONAL.items() if name in facts})
    for name, listed in {"tables": facts.get("tables", []), **facts.get("measures", {})}.items():
        if not isinstance(listed, list) or any(not isinstance(pair, list) or len(pair) != 2 for pair in listed):
            raise InvalidInput(f"{path}, {name}: expected pairs (metric, region), got {reprlib.repr(listed)}. {_AGAIN}")
    for name in ("methods", "n_examples", "identities"):
        if not facts[name]:
            raise InvalidInput(f"{path}, {name}: expected at least one entry, got an empty list. {_AGAIN}")
    finished = facts["provenance"]["finished"]
    try:
        datetime.fromisoformat(finished)
    except ValueError as error:
        raise InvalidInput(f"{path}, provenance.finished: expected a time, got {finished!r}. {_AGAIN}") from error


def _check_entry(path: Path, name: str, value: Any, kind: Any) -> None:
    wanted = kind if isinstance(kind, type) else type(kind)
    fits = isinstance(value, (int, float) if wanted is float else wanted) and not isinstance(value, bool)
    if not fits:
        raise InvalidInput(f"{path}, {name}: expected {_WORDS[wanted]}, got {reprlib.repr(value)}. {_AGAIN}")
    inner = f"{name}." if name else ""
    if isinstance(kind, list):
        for i, entry in enumerate(value):
            _check_entry(path, f"{name}[{i}]", entry, kind[0])
    elif isinstance(kind, Mapping):
        for key, part in kind.items():
            if key not in value:
                raise InvalidInput(f"{path}: expected the entry {inner}{key}, found none. {_AGAIN}")
            _check_entry(path, f"{inner}{key}", value[key], part)


def check_tables(folder: Path, facts: Mapping[str, Any], metrics: pd.DataFrame, cells: pd.DataFrame) -> None:
    """Raises InvalidInput unless both tables are whole, tidy, and speak of the same cells."""
    paths = folder / "metrics.parquet", folder / "cells.parquet"
    check_metrics(str(paths[0]), metrics)
    if lacking := [name for name in _CELL_COLUMNS if name not in cells.columns]:
        raise InvalidInput(f"{paths[1]}: columns {', '.join(lacking)} are missing; run the study again.")
    for path, table, keys in ((paths[0], metrics, _VALUE), (paths[1], cells, _CELL)):
        if table.empty:
            raise InvalidInput(f"{path}: expected at least one row, got none. {_AGAIN}")
        _check_columns(path, table, keys)
        _check_once(path, table, keys)
    _check_values(paths[0], metrics)
    _check_units(paths[0], metrics)
    _check_measure(folder / "study.json", facts, metrics)
    _check_listed(folder / "study.json", "methods", [method["name"] for method in facts["methods"]], metrics["method"])
    _check_listed(folder / "study.json", "n_examples", facts["n_examples"], metrics["n_examples"])
    _check_same_cells(paths, metrics.iloc[np.unique(_numbered(metrics, _CELL), return_index=True)[1]], cells)
    _check_same_expressions(paths[0], metrics)


def _check_columns(path: Path, table: pd.DataFrame, keys: Sequence[str]) -> None:
    for name in (column for column in (*keys, *_NUMBERS) if column in table):
        column = table[name]
        number = name in _NUMBERS or name in _WHOLE
        if number and (not is_numeric_dtype(column) or is_bool_dtype(column)):
            _refuse(path, f"numbers in the column {name}", f"{reprlib.repr(column.tolist()[0])} of type {column.dtype}")
        if name in _WHOLE and not is_integer_dtype(column):
            _refuse(path, f"whole numbers in the column {name}", f"{column.tolist()[0]!r} of type {column.dtype}")
        if name in keys and column.isna().any():
            _refuse(path, f"an entry of the column {name} in every row", f"{int(column.isna().sum())} rows without")


def _numbered(table: pd.DataFrame, keys: Sequence[str]) -> IntArray:
    """(rows,) a number for each combination of keys."""
    numbers = np.zeros(len(table), dtype=np.int64)
    for key in keys:
        code, found = pd.factorize(table[key])
        numbers = pd.factorize(numbers * len(found) + code)[0].astype(np.int64)
    return numbers


def _check_once(path: Path, table: pd.DataFrame, keys: Sequence[str]) -> None:
    more = pd.Series(_numbered(table, keys)).duplicated().to_numpy()
    if more.any():
        row = table.iloc[int(np.flatnonzero(more)[0])]
        what = ", ".join(f"{key} {row[key]}" for key in keys if key not in CONDITIONS)
        _refuse(path, f"one row for each {', '.join(keys)}", f"{int(more.sum())} rows more, the first: {what}")


def _check_values(path: Path, metrics: pd.DataFrame) -> None:
    values = metrics["value"].to_numpy(dtype=np.float64)
    lost = metrics["status"].isin(FINISHED).to_numpy() & ~np.isfinite(values)
    if lost.any():
        row = metrics.iloc[int(np.flatnonzero(lost)[0])]
        what = f"{row['metric']} of {row['method']} on {row['region']}, {row['source']} to {row['target']}"
        _refuse(path, "finite values of all finished cells", f"{int(lost.sum())} others, the first: {what}")


def _check_units(path: Path, metrics: pd.DataFrame) -> None:
    for metric, units in metrics[["metric", "unit"]].drop_duplicates().groupby("metric", sort=False)["unit"]:
        if len(units) > 1:
            _refuse(path, f"one unit of {metric}", " and ".join(map(str, units)))


def _check_measure(path: Path, facts: Mapping[str, Any], metrics: pd.DataFrame) -> None:
    wanted = facts["primary_metric"], facts["primary_region"]
    taken = metrics.loc[metrics["metric"] == wanted[0], "region"]
    if taken.empty:
        listed = ", ".join(map(str, metrics["metric"].unique()))
        _refuse(f"{path}, primary_metric", f"a metric of metrics.parquet ({listed})", repr(wanted[0]))
    if not (taken == wanted[1]).any():
        listed = ", ".join(map(str, taken.unique()))
        _refuse(f"{path}, primary_region", f"a region of {wanted[0]} in metrics.parquet ({listed})", repr(wanted[1]))


def _check_listed(path: Path, name: str, listed: Sequence[object], found: pd.Series[Any]) -> None:
    if unknown := [str(one) for one in found.unique() if one not in listed]:
        _refuse(f"{path}, {name}", f"also {', '.join(unknown)}, as in metrics.parquet", ", ".join(map(str, listed)))


def _check_same_cells(paths: tuple[Path, Path], first_rows: pd.DataFrame, cells: pd.DataFrame) -> None:
    """first_rows: one row of the metrics for each cell."""
    columns = [*_CELL, "status"]
    both = first_rows[columns].merge(cells[columns], on=list(_CELL), how="outer", suffixes=("", "_of_cell"))
    for i, other, column in ((0, 1, "status"), (1, 0, "status_of_cell")):
        if (lost := both[both[column].isna()]).size:
            first = _cell(lost.iloc[0].to_dict())
            came = f"all but {len(lost)} of {len(both)}, the first of them {first}"
            _refuse(paths[i], f"the cells of {paths[other].name}", came)
    differing = both[both["status"] != both["status_of_cell"]]
    if len(differing):
        row = differing.iloc[0]
        what = f"{row['status']!r} instead of {row['status_of_cell']!r} for {_cell(row.to_dict())}"
        _refuse(paths[0], f"the status that {paths[1].name} gives", what)


def _check_same_expressions(path: Path, metrics: pd.DataFrame) -> None:
    """Methods are compared expression by expression: all must be measured on as many."""
    group = _numbered(metrics, [name for name in _VALUE if name not in ("method", "expression")])
    code, names = pd.factorize(metrics["method"])
    counts = np.bincount(group * len(names) + code, minlength=(group.max() + 1) * len(names)).reshape(-1, len(names))
    uneven = np.flatnonzero((counts > 0) & (counts < counts.max(axis=1, keepdims=True)))
    if len(uneven):
        at, method = divmod(int(uneven[0]), len(names))
        row = metrics.iloc[int(np.flatnonzero(group == at)[0])]
        where = f"{row['metric']} on {row['region']}, {_cell(row.to_dict() | {'method': names[method]})}"
        counted = f"{counts[at, method]} of {counts[at].max()}"
        _refuse(path, "values of the same expressions for every method", f"{counted} for {where}")


def _cell(row: Mapping[Any, Any]) -> str:
    return (
        f"{row['method']}, {row['source']} to {row['target']}, {row['n_examples']} examples, draw {row['draw']}, "
        f"{row['correspondence']} correspondence"
    )


def _refuse(where: object, expected: str, came: str) -> None:
    raise InvalidInput(f"{where}: expected {expected}, got {came}. {_AGAIN}")
