"""The linear face model in the clone: a generic skin, face units and identity modes, read once and then cached."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from retarget.types import FloatArray, IntArray
from synth_data.arkit import SKIN_NAMES
from synth_data.cache import ArrayCache, fingerprint
from synth_data.dataset import Progress
from synth_data.ict_facekit.clone import Clone, read_neutral, read_skin
from synth_data.ict_facekit.expressions import parts

VERSION = "1"  # of what is cached


@dataclass(frozen=True)
class FaceModel:
    """neutral + sum_k c_k mode_k at rest; each mode is one standard deviation of the scanned people."""

    neutral: FloatArray  # (n, 3) mm
    faces: IntArray  # (f, 3)
    units: FloatArray  # (51, n, 3) mm: displacements of `SKIN_NAMES` at full strength
    modes: Mapping[int, FloatArray]  # (n, 3) mm by number


def read_model(clone: Clone, digest: str, cache: ArrayCache, progress: Progress = lambda line: None) -> FaceModel:
    """The model of a clone with this digest of its contents. Raises InvalidInput as `read_skin`."""
    neutral, faces = read_neutral(clone.neutral)

    def displacements() -> FloatArray:
        """(e + m, n, 3) mm: expressions, then modes."""
        files = [*clone.expressions.values(), *clone.modes.values()]
        progress(f"Reading {len(files)} meshes of ICT-FaceKit (once; they are kept in the cache)")
        read = np.empty((len(files), *neutral.shape))
        for row, path in zip(read, files, strict=True):
            row[:] = read_skin(path) - neutral
        return read

    stored = cache(fingerprint([__name__, VERSION, digest]), displacements)
    expressions = dict(zip(clone.expressions, stored, strict=False))
    return FaceModel(
        neutral=neutral,
        faces=faces,
        units=np.stack([np.sum([expressions[name] for name in parts(unit)], axis=0) for unit in SKIN_NAMES]),
        modes=dict(zip(clone.modes, stored[len(expressions) :], strict=True)),
    )
