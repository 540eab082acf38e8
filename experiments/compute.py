"""Compute the cells of a plan that have no current record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console

from experiments.backend import Backend
from experiments.evaluate import Cell, evaluate_pair
from experiments.plan import Plan
from experiments.progress import duration, progress


def compute(planned: Plan, backend: Backend, console: Console) -> None:
    """Compute the cells that have no current record."""
    headers = {cell.id: planned.finished(cell) for cell in planned.cells}
    missing = [cell for cell in planned.cells if headers[cell.id] is None]
    pairs = len({(cell.source, cell.target) for cell in planned.cells})
    reused = len(planned.cells) - len(missing)
    console.print(
        f"{planned.study.title}: {len(planned.rows)} rows x {pairs} pairs x "
        f"{list(planned.study.n_examples)} examples x {planned.study.draws} draws = {len(planned.cells)} cells"
        + (f", {reused} of them finished earlier" if reused else "")
    )
    for name, reason in planned.left_out.items():
        console.print(f"metric {name} is left out: {reason}")
    console.print(f"estimated time: {_estimate(planned, missing, headers)}")
    with progress(console, "cells", len(missing)) as advance:
        for done in backend.run(evaluate_pair, planned.tasks(missing)):
            advance(done)


def _estimate(planned: Plan, missing: list[Cell], headers: Mapping[str, Mapping[str, Any] | None]) -> str:
    """From the cells of this study that have been computed on this machine before."""
    seconds: dict[str, list[float]] = {}
    for cell in planned.cells:
        header = headers[cell.id]
        if header is not None and header["fit_seconds"] is not None:
            per_frame = header["seconds_per_expression"] * planned.study.test_expressions
            seconds.setdefault(cell.row.name, []).append(header["fit_seconds"] + per_frame)
    if not missing:
        return "nothing left to compute"
    if not seconds:
        return "no earlier cells to judge by; the remaining time is shown as soon as the first pair is done"
    typical = {name: sum(values) / len(values) for name, values in seconds.items()}
    total = sum(typical.get(cell.row.name, 0.0) for cell in missing)
    return f"about {duration(total)} of computing for the {len(missing)} cells left"
