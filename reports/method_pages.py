"""Fig. 1 of the paper: the patches on a head."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb

from reports.camera import look
from reports.heads import RAISE, TURN, framed
from reports.load import StudyResults
from reports.render import render_mesh, write_image
from retarget.check import InvalidInput
from retarget.geometry.patches import contiguous_patches
from retarget.types import IntArray

SIZE = (420, 520)  # pixels
PATCHES = 80  # of the paper's Fig. 1
_TINTS = ("#7fb3d5", "#f2c078", "#8ccfb5", "#e3a5c7", "#d9d27a", "#b9a3d3", "#e69a8d", "#c2c2c2")


def patch_figure(study: StudyResults, folder: Path, name: str) -> dict[str, object] | None:
    """Two views of the patches on the target of the first kept cell: {files, count, vertices}; None without frames.

    The patches are those of the study's patchwise blendshapes, or 80; they follow from faces alone.
    """
    cells = study.figure_cells
    if not cells:
        return None
    counts = {m.name: m.settings.get("patch_count") for m in study.methods}
    count = next((counts[m] for m in ("anacondar", "plbs") if isinstance(counts.get(m), int)), PATCHES)
    frames = cells[0].frames
    skin = frames.target_neutral.astype(np.float64)
    try:
        patches = contiguous_patches(frames.faces, len(skin), int(count or PATCHES))
    except InvalidInput:  # a mesh in many pieces, or a coarse one
        return None
    colors = np.array([to_rgb(tint) for tint in _TINTS])[_tints(frames.faces, patches, len(skin))]
    files = []
    for i, turn in enumerate((0.0, TURN + 16.0)):
        camera = look(framed(frames), SIZE, turn=turn, raise_=RAISE, margin=0.03)
        file = f"{name}-{i}.jpg"
        write_image(folder / file, render_mesh(skin, frames.faces, camera, SIZE, vertex_colors=colors))
        files.append(file)
    return {"files": files, "count": len(patches), "vertices": len(skin)}


def _tints(faces: IntArray, patches: Sequence[IntArray], count: int) -> IntArray:
    """(n,) index of a tint for each vertex: neighbouring patches differ, as long as the tints last."""
    of = np.empty(count, dtype=np.int64)
    for i, patch in enumerate(patches):
        of[patch] = i
    edges = of[faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)]
    pairs = np.unique(np.concatenate([edges, edges[:, ::-1]]), axis=0)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    tint = np.full(len(patches), -1)
    for i in range(len(patches)):
        taken = set(tint[pairs[pairs[:, 0] == i, 1]].tolist())
        free = [t for t in range(len(_TINTS)) if t not in taken]
        tint[i] = min(free, key=lambda t: (np.count_nonzero(tint == t), t), default=i % len(_TINTS))
    return np.asarray(tint[of], dtype=np.int64)
