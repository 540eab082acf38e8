"""What a recording or a set of expressions is like: how sparse, how coupled, how fast, of how many dimensions.

``python -m synth_data.weight_statistics [FILE.csv ...]`` compares Live Link Face recordings with the built-in
conversation.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping

import numpy as np
from scipy.signal import welch

from retarget.check import InvalidInput
from retarget.types import FloatArray, IntArray
from synth_data.arkit import MIRRORED, SKIN_NAMES
from synth_data.conversation import conversation
from synth_data.live_link import read_live_link
from synth_data.recording import Recording

ACTIVE, ZERO, COUPLED, SHUT = 0.1, 0.02, 0.8, 0.6
WINDOW = 8.0  # s of a spectrum's segments


def statistics(recording: Recording) -> dict[str, float]:
    """Named figures of the skin units of a recording of at least two rows; docs/sequences.md explains them."""
    weights, pairs = recording.skin, _pairs()
    from_rest = np.abs(weights - np.median(weights, axis=0))
    r = correlations(weights)
    others = np.triu(np.ones_like(r, dtype=bool), 1)
    others[tuple(np.sort(pairs, axis=1).T)] = False
    speed = speeds(recording)
    frequency, power = spectrum(recording)
    below = np.cumsum(power) / max(power.sum(), np.finfo(float).tiny)
    shut = weights[:, SKIN_NAMES.index("eyeBlinkLeft")] > SHUT
    p95, p99 = dimensions(weights)
    return {
        "active units": float(np.median((weights > ACTIVE).sum(axis=1))),
        "active units, from rest": float(np.median((from_rest > ACTIVE).sum(axis=1))),
        "share at zero": float((weights < ZERO).mean()),
        "left with right": float(np.median(r[tuple(pairs.T)])),
        "coupled pairs": float((r[others] > COUPLED).sum()),
        "mean |r|": float(np.abs(r[others]).mean()),
        "half the power below": float(frequency[np.argmax(below >= 0.5)]),
        "95 % of the power below": float(frequency[np.argmax(below >= 0.95)]),
        "speed, median": float(np.median(speed)),
        "speed, 95 %": float(np.quantile(speed, 0.95)),
        "speed, 99 %": float(np.quantile(speed, 0.99)),
        "blinks": float((shut[1:] & ~shut[:-1]).sum() / np.ptp(recording.times) * 60),
        "dimensions, 95 %": p95,
        "dimensions, 99 %": p99,
    }


def correlations(weights: FloatArray) -> FloatArray:
    """(51, 51) Pearson correlations of the units; 0 for a unit that does not move."""
    centred = weights - weights.mean(axis=0)
    norm = np.linalg.norm(centred, axis=0)
    unit = np.divide(centred, norm, out=np.zeros_like(centred), where=norm > 1e-9)
    return unit.T @ unit


def speeds(recording: Recording) -> FloatArray:
    """(t - 1, 51) absolute rates of change of the weights per second."""
    return np.abs(np.diff(recording.skin, axis=0)) / np.diff(recording.times)[:, None]


def spectrum(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Frequencies in Hz and the power of all units there, without their means; sampled evenly at the nominal rate."""
    fps = recording.fps
    even = recording.at(np.arange(int(recording.times[-1] * fps) + 1) / fps)
    frequency, power = welch(even, fs=fps, nperseg=min(int(WINDOW * fps), len(even)), axis=0)
    return frequency, power.sum(axis=1)


def dimensions(weights: FloatArray, gram: FloatArray | None = None) -> tuple[int, int]:
    """How many principal components hold 95 and 99 % of the variance of rows (t, 51).

    In units of weights, or, with the Gram matrix (51, 51) of a rig's deltas, of the motion of its vertices; 0 where
    nothing varies.
    """
    centred = weights - weights.mean(axis=0)
    variance = np.linalg.svd(centred if gram is None else centred @ _root(gram), compute_uv=False) ** 2
    if not variance.any():
        return 0, 0
    share = np.cumsum(variance) / variance.sum()
    p95, p99 = (int(np.argmax(share >= part - 1e-12)) + 1 for part in (0.95, 0.99))
    return p95, p99


def unexplained(weights: FloatArray, gram: FloatArray, examples: int, draws: int = 20, seed: int = 0) -> float:
    """The share of a motion that linear blends of this many examples cannot reach, at best.

    RMS over the rows (t, 51) that are no examples and over the vertices of a rig with this Gram matrix (51, 51),
    divided by the RMS of the motion; the mean over random draws of examples.
    """
    if not 0 < examples < len(weights):
        raise InvalidInput(f"examples: expected 1 to {len(weights) - 1} of {len(weights)} rows, got {examples}.")
    rng, moved, shares = np.random.default_rng(seed), weights @ _root(gram), []
    for _ in range(draws):
        order = rng.permutation(len(moved))
        span, rest = moved[order[:examples]], moved[order[examples:]]
        _, size, axes = np.linalg.svd(span, full_matrices=False)
        axes = axes[size > 1e-9 * size[0]]
        shares.append(np.linalg.norm(rest - rest @ axes.T @ axes) / np.linalg.norm(rest))
    return float(np.mean(shares))


def _root(gram: FloatArray) -> FloatArray:
    """(51, 51) A with A A^T = gram, so that rows w A are as long as the motion of w."""
    values, vectors = np.linalg.eigh(gram)
    return np.asarray(vectors * np.sqrt(values.clip(0)))


def _pairs() -> IntArray:
    """(p, 2) columns of the units of the left and of the right side."""
    left = [name for name in SKIN_NAMES if "Left" in name]
    return np.array([[SKIN_NAMES.index(name), SKIN_NAMES.index(MIRRORED[name])] for name in left])


def _table(columns: Mapping[str, Mapping[str, float]]) -> str:
    rows = next(iter(columns.values()))
    lines = [f"{'':28}" + "".join(f"{name[:20]:>22}" for name in columns)]
    return "\n".join(lines + [f"{row:28}" + "".join(f"{c[row]:22.3g}" for c in columns.values()) for row in rows])


def main(files: list[str]) -> None:
    """Print the statistics of recordings beside those of the built-in conversation."""
    takes = [*map(read_live_link, files), conversation(300)]
    print(_table({take.name: statistics(take) for take in takes}))


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except InvalidInput as error:
        sys.exit(str(error))
