"""How fast the simulation is, beside the published rates: a page from the tables of a study of the kind `runtime`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from reports.sheet import Table
from reports.text import number

PUBLISHED = {  # section 4.1 of the paper: "approximately 10 fps", "0.3 fps", initialised in about 9 s
    "expressions_per_s": "10",
    "expressions_per_s_collisions": "0.3",
    "setup_seconds": "9",
}
_ROWS = (  # column, what it is, digits
    ("expressions_per_s", "expressions per second", 1),
    ("expressions_per_s_collisions", "the same with lip collisions resolved", 1),
    ("setup_seconds", "initialising the simulations, s", 2),
    ("fit_seconds", "fitting two heads, s", 2),
    ("adt_inverse_ms", "inverse simulation of adt, ms", 0),
    ("adt_forward_ms", "forward simulation of adt, ms", 0),
    ("anacon_inverse_ms", "inverse simulation of anacon, ms", 0),
    ("anacon_forward_ms", "forward simulation of anacon, ms", 0),
    ("anacondar_per_s", "the whole method, expressions per second", 1),
    ("anacondar_per_s_collisions", "the same with lip collisions resolved", 1),
    ("anacondar_setup_seconds", "the whole method's set-up, s", 1),
    ("peak_memory_mb", "largest memory of the simulations, MB", 0),
    ("anacondar_peak_memory_mb", "largest memory of the whole method, MB", 0),
    ("not_converged", "expressions that did not converge", 0),
)
_SIZES = {  # Table 2 of the paper
    "skin_vertices": ("vertices of the skin", "29,826"),
    "tet_vertices": ("vertices of the tetrahedra", "61,875"),
    "tets": ("tetrahedra", "234,049"),  # 126,612 of soft tissue and 107,437 of muscle
    "threads": ("threads", "128 at most"),  # AMD Ryzen Threadripper PRO 3995WX: 64 cores
}


def runtime_blocks(summary: pd.DataFrame) -> list[Table]:
    """A table with one column for each form of the surface target, and the published values."""
    shown = summary.to_dict("records")
    heads = ("", "published", *(f"{row['surface']} target" for row in shown))
    rows = [
        (said, PUBLISHED.get(column, ""), *(_text(row, column, digits) for row in shown))
        for column, said, digits in _ROWS
        if column in summary
    ]
    rows += [
        (said, published, *(_text(row, column, 0) for row in shown))
        for column, (said, published) in _SIZES.items()
        if column in summary
    ]
    template = str(shown[0].get("template", "unknown")) if shown else "unknown"
    expressions = int(shown[0].get("expressions", 0)) if shown else 0
    compared = (
        "its sizes are near those of Table 2 of the paper"
        if template == "paper"
        else "it is smaller than that of the paper, so that rates do not compare; set study.template=paper"
    )
    caption = (
        f"Medians over {expressions} expressions of an animation, one at a time: two inverse and two forward "
        f"simulations each (section 4.1). Template: {template}; {compared}. Published rates are of another "
        "machine, an AMD Ryzen Threadripper PRO 3995WX. The paper states no memory. "
        "The soft target is that of eq. (13)."
    )
    return [Table(heads, tuple(rows), caption)]


def _text(row: Mapping[Any, Any], column: str, digits: int) -> str:
    value = row.get(column)
    if not isinstance(value, int | float):
        return "n/a"
    return f"{value:,.0f}" if digits == 0 and value == round(value) else number(float(value), digits)
