"""Compute the cells of a plan that have no current record."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console

from experiments.backend import Backend
from experiments.evaluate import evaluate_pair
from experiments.plan import Plan
from experiments.progress import duration, progress


def compute(planned: Plan, backend: Backend, console: Console, alike: Sequence[Plan] = ()) -> None:
    """Compute the cells that have no current record; all plans `alike` help to say how long it takes."""
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
    console.print(estimate([planned], alike))
    with progress(console, "cells", len(missing)) as advance:
        for done in backend.run(evaluate_pair, planned.tasks(missing)):
            advance(done)


def estimate(plans: Sequence[Plan], alike: Sequence[Plan] = ()) -> str:
    """In words, the time that is left for some plans, from what was computed of them, or of all plans alike."""
    missing = [cell for planned in plans for cell in planned.cells if planned.finished(cell) is None]
    if not missing:
        return "estimated time: nothing left to compute"
    seconds = _seconds(alike or plans)
    if not seconds:
        return "estimated time: no earlier cells to judge by; the first pair will show what remains"
    total = sum(seconds.get(cell.row.name, 0.0) for cell in missing)
    return f"estimated time: about {duration(total)} of computing for the {len(missing)} cells left"


def _seconds(plans: Sequence[Plan]) -> dict[str, float]:
    """Of a cell, by row, on average over those that are finished."""
    taken: dict[str, list[float]] = {}
    for planned, cell in [(each, cell) for each in plans for cell in each.cells]:
        header = planned.finished(cell)
        if header is not None and header["fit_seconds"] is not None:
            per_frame = header["seconds_per_expression"] * planned.study.test_expressions
            taken.setdefault(cell.row.name, []).append(header["fit_seconds"] + per_frame)
    return {name: sum(values) / len(values) for name, values in taken.items()}
