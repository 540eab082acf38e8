"""Whether a result keeps the target's identity, whoever the source is."""

from __future__ import annotations

import numpy as np

from retarget.types import FloatArray


def identity_spread(frames: FloatArray) -> float:
    """mm: how far results of several sources lie from each other, who all perform the same on one target.

    frames (s, t, n, 3) mm: by source. The root mean square over sources, frames and vertices of the distance from the
    mean of the sources, unbiased; 0 for the truth, which is the same for all. Lower is better; it cannot see an error
    that all sources share. Raises ValueError for fewer than two sources.
    """
    if len(frames) < 2:
        raise ValueError(f"expected at least 2 sources, got {len(frames)}")
    apart = frames - frames.mean(axis=0)
    return float(np.sqrt((apart**2).sum(axis=-1).sum(axis=0).mean() / (len(frames) - 1)))
