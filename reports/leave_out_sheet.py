"""The page of the leave-out study of ALM: held-out shapes by every method, with errors, and the table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from reports.camera import look
from reports.heads import nice
from reports.render import render_mesh, write_image
from reports.sheet import Picture, PictureRow, Pictures, Table, write_sheet
from reports.text import number
from retarget.types import FloatArray, Pair

SIZE = (330, 390)  # pixels
VIEW = {"turn": 18.0, "raise_": 2.0}
COLUMNS = 5


@dataclass(frozen=True)
class Shown:
    """One held-out shape. found and errors (mm): by method."""

    title: str
    pair: Pair
    source: FloatArray  # (n, 3) mm
    truth: FloatArray  # (n, 3) mm
    found: Mapping[str, FloatArray]
    errors: Mapping[str, float]


def write_leave_out_sheet(
    path: Path, title: str, description: str, shapes: Sequence[Shown], summary: pd.DataFrame, work: Path
) -> None:
    """Write the PDF; pictures go into the folder `work`."""
    blocks: list[Pictures | Table] = [_pictures(shown, f"shape{i}", work) for i, shown in enumerate(shapes)]
    table = Table(
        tuple(str(column).replace("_", " ") for column in summary.columns),
        tuple(
            tuple(number(value, 4) if isinstance(value, float) else str(value) for value in row)
            for row in summary.itertuples(index=False)
        ),
        "Mean and median over all held-out shapes of all pairs of the mean vertex error on the visible head.",
    )
    write_sheet(path, title, description, [*blocks, table], work)


def _pictures(shown: Shown, name: str, work: Path) -> Pictures:
    face = np.asarray(shown.pair.regions.vertices.get("face", np.arange(len(shown.truth))), dtype=np.int64)
    distances = {method: np.linalg.norm(found - shown.truth, axis=1) for method, found in shown.found.items()}
    limit = nice(float(np.quantile(np.concatenate([d[face] for d in distances.values()]), 0.97)))
    said = number(limit, 2).rstrip("0").rstrip(".")
    cells: list[Picture] = []
    for label, skin in (("source", shown.source), ("truth", shown.truth)):
        image = render_mesh(skin, shown.pair.faces, look(skin[face], SIZE, margin=0.0, **VIEW), SIZE)
        write_image(work / f"{name}-{label}.jpg", image)
        cells.append(Picture(f"{name}-{label}.jpg", label))
    camera = look(shown.truth[face], SIZE, margin=0.0, **VIEW)
    for i, (method, found) in enumerate(shown.found.items()):
        values = {"vertex_values": distances[method], "limits": (0.0, limit)}
        write_image(work / f"{name}-{i}.jpg", render_mesh(found, shown.pair.faces, camera, SIZE, **values))
        cells.append(Picture(f"{name}-{i}.jpg", f"{method}: {number(shown.errors[method], 3)} mm"))
    rows = [tuple(cells[i : i + COLUMNS]) for i in range(0, len(cells), COLUMNS)]
    return Pictures(
        ("",) * COLUMNS,
        (1.0,) * COLUMNS,
        tuple(PictureRow(row, shown.title if i == 0 else "") for i, row in enumerate(rows)),
        f"Colours: distance from the truth, darkest from {said} mm on.",
    )
