"""Compute the cells of a plan that have no current record."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console

from experiments.backend import Backend
from experiments.evaluate import Cell, evaluate_pair
from experiments.plan import Plan
from experiments.progress import duration, progress


def compute(planned: Plan, backend: Backend, console: Console) -> None:
    """Compute the cells that have no current record."""
    missing = [cell for cell in planned.cells if planned.finished(cell) is None]
    pairs = len({(cell.source, cell.target) for cell in planned.cells})
    reused = len(planned.cells) - len(missing)
    console.print(
        f"{planned.study.title}: {len(planned.rows)} rows x {pairs} pairs x "
        f"{list(planned.study.n_examples)} examples x {planned.study.draws} draws = {len(planned.cells)} cells"
        + (f", {reused} of them finished earlier" if reused else "")
    )
    for name, reason in planned.left_out.items():
        console.print(f"metric {name} is left out: {reason}")
    console.print(estimate([planned]))
    with progress(console, "cells", len(missing)) as advance:
        for done in backend.run(evaluate_pair, planned.tasks(missing)):
            advance(done)


def estimate(plans: Sequence[Plan]) -> str:
    """In words, the time that is left, from the cells of these plans that this machine has computed before."""
    seconds: dict[str, list[float]] = {}
    missing: list[Cell] = []
    for planned, cell in [(each, cell) for each in plans for cell in each.cells]:
        header = planned.finished(cell)
        if header is None:
            missing.append(cell)
        elif header["fit_seconds"] is not None:
            per_frame = header["seconds_per_expression"] * planned.study.test_expressions
            seconds.setdefault(cell.row.name, []).append(header["fit_seconds"] + per_frame)
    if not missing:
        return "estimated time: nothing left to compute"
    if not seconds:
        return "estimated time: no earlier cells to judge by; the first pair will show what remains"
    typical = {name: sum(values) / len(values) for name, values in seconds.items()}
    total = sum(typical.get(cell.row.name, 0.0) for cell in missing)
    return f"estimated time: about {duration(total)} of computing for the {len(missing)} cells left"
