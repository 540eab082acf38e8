"""Accuracy gates: values under version control that a finished study must reproduce, from both sides."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import yaml
from omegaconf import DictConfig
from rich import box
from rich.console import Console
from rich.table import Table

from experiments.catalogue import CONF
from experiments.progress import print_path
from retarget.check import InvalidInput
from retarget.io.files import write_whole

GATES = CONF.parent / "gates"
SIGNED_TOLERANCE_MM = 0.01  # a constant offset hardly moves a mean distance, so the signed error is held tightly
RELATIVE_TOLERANCE = 0.02  # of the value, for distances: room for other CPUs and library versions, none for a change


COLUMNS = ("method", "n_examples", "metric", "region", "value", "tolerance")
SHARED = ("unit", "direction", "reason", "origin")
DIRECTIONS = ("lower", "higher", "zero")


@dataclass(frozen=True)
class Gate:
    """Mean over a study's cells of one metric, with its two-sided tolerance.

    Raises ValueError for entries that hold nothing.
    """

    method: str
    n_examples: int
    metric: str
    region: str
    value: float
    tolerance: float
    unit: str
    direction: str  # what is better; the gate fails on either side
    reason: str
    origin: str

    def __post_init__(self) -> None:
        if not isinstance(self.value, int | float) or not math.isfinite(self.value):
            raise ValueError(f"value: expected a number, got {self.value!r} of {self.method}")
        if not isinstance(self.tolerance, int | float) or not 0 < self.tolerance < math.inf:
            raise ValueError(f"tolerance: expected a number above 0, got {self.tolerance!r} of {self.method}")
        if self.direction not in DIRECTIONS:
            raise ValueError(f"direction: expected one of {', '.join(DIRECTIONS)}, got {self.direction!r}")
        if not self.reason:
            raise ValueError("reason: expected why these values were set, got none")


@dataclass(frozen=True)
class Verdict:
    gate: Gate
    measured: float | None  # None: the study has no such row, or a cell of it has no answer

    @property
    def passed(self) -> bool:
        return self.measured is not None and abs(self.measured - self.gate.value) <= self.gate.tolerance


def gate(folder: Path, config: DictConfig, console: Console) -> bool:
    """Print the table of gates; True if all hold. Raises InvalidInput where there is nothing to compare."""
    metrics = _metrics(folder)
    path = Path(config.gates).absolute() if config.gates else GATES / f"{config.study.name}.yaml"
    if config.propose:
        proposal = propose(metrics, origin=f"study={config.study.name}")
        write_gates(Path(config.propose).absolute(), proposal)
        console.print(f"{len(proposal)} gates proposed; review them before they replace {path.name}:")
        print_path(Path(config.propose).absolute(), console)
        return True
    verdicts = compare(metrics, read_gates(path))
    _print(verdicts, console)
    return all(verdict.passed for verdict in verdicts)


def read_gates(path: Path) -> list[Gate]:
    """The gates of a file: groups that share SHARED, each with rows of COLUMNS.

    Raises InvalidInput for a missing file, one of another form, one without gates, and values that hold nothing.
    """
    if not path.exists():
        raise InvalidInput(f"{path}: no gates file. Choose one with gates=FILE, or write one with propose=FILE.")
    try:
        gates = [
            Gate(**dict(zip(COLUMNS, row, strict=True)), **{name: group[name] for name in SHARED})
            for group in yaml.safe_load(path.read_text(encoding="utf-8"))
            for row in group["gates"]
        ]
    except (TypeError, KeyError, ValueError, yaml.YAMLError) as error:
        raise InvalidInput(
            f"{path}: expected groups with {', '.join(SHARED)} and gates, each a row of {', '.join(COLUMNS)}; {error}."
        ) from None
    if not gates:
        raise InvalidInput(f"{path}: expected at least one gate, got none; nothing would be held.")
    return gates


def write_gates(path: Path, gates: Iterable[Gate]) -> None:
    """The inverse of `read_gates`."""
    groups: dict[tuple[str, ...], list[Gate]] = {}
    for entry in gates:
        groups.setdefault(tuple(getattr(entry, name) for name in SHARED), []).append(entry)
    lines = []
    for shared, members in groups.items():
        lines += [f"{'-' if i == 0 else ' '} {name}: {shared[i]}" for i, name in enumerate(SHARED)]
        lines += [f"  gates:  # {', '.join(COLUMNS)}"]
        lines += [
            f"  - [{entry.method}, {entry.n_examples}, {entry.metric}, {entry.region}, "
            f"{entry.value:.5f}, {entry.tolerance:.5f}]"
            for entry in members
        ]
    write_whole(path, lambda temporary: temporary.write_text("\n".join(lines) + "\n"))


def compare(metrics: pd.DataFrame, gates: Iterable[Gate]) -> list[Verdict]:
    """One verdict per gate."""
    means = _means(metrics)
    return [Verdict(entry, means.get((entry.method, entry.n_examples, entry.metric, entry.region))) for entry in gates]


def propose(metrics: pd.DataFrame, origin: str) -> list[Gate]:
    """Gates that hold the mean distance over the head, and every signed error, of every row."""
    units = metrics.drop_duplicates("metric").set_index("metric")["unit"].to_dict()
    proposal = []
    for (method, n_examples, metric, region), value in _means(metrics).items():
        signed = metric.startswith("signed_error")
        if value is None or not (signed or (metric, region) == ("vertex_l2_mean", "head")):
            continue
        proposal.append(
            Gate(
                method,
                n_examples,
                metric,
                region,
                round(value, 5),
                SIGNED_TOLERANCE_MM if signed else round(max(RELATIVE_TOLERANCE * value, 1e-4), 5),
                units[metric],
                "zero" if signed else "lower",
                "a constant offset shows here first" if signed else "accuracy as measured when the gate was set",
                origin,
            )
        )
    return proposal


def _metrics(folder: Path) -> pd.DataFrame:
    path = folder / "metrics.parquet"
    if not path.exists():
        raise InvalidInput(
            f"{path}: no finished study there. Run `python -m experiments run study={folder.name}` first."
        )
    try:
        metrics = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise InvalidInput(f"{path}: cannot be read as a table ({error}); run the study again.") from error
    if missing := [name for name in (*COLUMNS[:-1], "unit") if name not in metrics.columns]:
        raise InvalidInput(f"{path}: expected the column {missing[0]} among others; run the study again.")
    return metrics


def _means(metrics: pd.DataFrame) -> dict[tuple[Any, ...], float | None]:
    groups = metrics.groupby(["method", "n_examples", "metric", "region"], sort=False)["value"]
    return {key: None if values.isna().any() else float(values.mean()) for key, values in groups}


def _print(verdicts: list[Verdict], console: Console) -> None:
    table = Table(
        title="Accuracy gates", title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False
    )
    table.add_column("method", no_wrap=True)
    table.add_column("ex.", justify="right", no_wrap=True)
    table.add_column("measure", no_wrap=True)
    for name in ("expected", "measured", ""):
        table.add_column(name, justify="right", no_wrap=True)
    listed = [v for v in verdicts if not v.passed or not v.gate.metric.startswith("signed_error")]
    for verdict in sorted(listed, key=lambda verdict: verdict.passed):
        entry = verdict.gate
        measured = "missing" if verdict.measured is None else f"{verdict.measured:.4f}"
        mark = "[green]ok[/green]" if verdict.passed else "[bold red]FAIL[/bold red]"
        table.add_row(
            entry.method, str(entry.n_examples), f"{entry.metric} {entry.region}",
            f"{entry.value:.4f}±{entry.tolerance:.4f}", measured, mark,
        )  # fmt: skip
    console.print(table)
    failed = sum(not verdict.passed for verdict in verdicts)
    unlisted = len(verdicts) - len(listed)
    console.print(f"{len(verdicts) - failed} gates hold ({unlisted} on signed errors are not listed), {failed} fail")
