"""Sums of what threads scatter, in one order whatever their number."""

from __future__ import annotations

from numba import njit, prange

CHUNKS = 8  # fixed, so that sums have one order whatever the number of threads


@njit(cache=True, parallel=True)
def gather(parts, ranges, total):  # type: ignore[no-untyped-def]
    """total (n, 3): the sum over chunks of parts (CHUNKS, n, 3), each read in its ranges (CHUNKS, 2) of rows alone."""
    for v in prange(len(total)):
        x, y, z = 0.0, 0.0, 0.0
        for chunk in range(len(ranges)):
            if ranges[chunk, 0] <= v < ranges[chunk, 1]:
                x += parts[chunk, v, 0]
                y += parts[chunk, v, 1]
                z += parts[chunk, v, 2]
        total[v, 0], total[v, 1], total[v, 2] = x, y, z
