"""Anderson acceleration, type II (Walker and Ni 2011), in passes over memory that all threads share."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from retarget.simulation.chunks import CHUNKS
from retarget.types import FloatArray

SMALL = 20_000  # numbers: below, waking threads takes longer than the work
FUSE = {"contract", "reassoc", "nsz"}  # NaN and infinity keep their meaning


class Anderson:
    """The step that a fixed-point iteration should take next."""

    def __init__(self, depth: int) -> None:
        self.depth = depth
        self.restart()

    def restart(self) -> None:
        """Forget the history; the next step is plain."""
        self._last: tuple[FloatArray, FloatArray] | None = None
        self._count = 0  # changes seen; they are kept in a ring

    def __call__(self, state: FloatArray, residual: FloatArray) -> FloatArray:
        """The step from `state`, where the plain one is `residual`; returns `residual` itself without a history.

        Both are kept, not copied: neither may change afterwards.
        """
        if self.depth == 0:
            return residual
        last, self._last = self._last, (state, residual)
        if last is None:
            return residual
        if self._count == 0:
            self._steps = np.empty((self.depth, residual.size))  # change of state plus change of residual
            self._changes = np.empty((self.depth, residual.size))  # change of residual
            self._products = np.zeros((self.depth, self.depth))
        slot = self._count % self.depth
        self._count += 1
        kept = min(self._count, self.depth)
        dots = np.zeros((CHUNKS, 2, kept))
        new, plain, *old = (np.ascontiguousarray(a).reshape(-1) for a in (state, residual, *last))
        remember, combine = (_remember, _combine) if residual.size > SMALL else (_remember_alone, _combine_alone)
        remember(new, plain, old[0], old[1], self._steps, self._changes, slot, dots)
        against_newest, right = dots.sum(axis=0)
        self._products[slot, :kept] = self._products[:kept, slot] = against_newest
        products = self._products[:kept, :kept]
        try:
            weights = np.linalg.solve(products + 1e-12 * np.trace(products) * np.eye(kept), right)
        except np.linalg.LinAlgError:
            return residual
        step = np.empty(residual.size)
        combine(plain, weights, self._steps, step)
        return step.reshape(residual.shape)


@njit(cache=True, parallel=True)
def _remember(state, residual, last_state, last_residual, steps, changes, slot, dots):  # type: ignore[no-untyped-def]
    for chunk in prange(CHUNKS):
        _remember_chunk(chunk, state, residual, last_state, last_residual, steps, changes, slot, dots)


@njit(cache=True)
def _remember_alone(state, residual, last_state, last_residual, steps, changes, slot, dots):  # type: ignore[no-untyped-def]
    for chunk in range(CHUNKS):
        _remember_chunk(chunk, state, residual, last_state, last_residual, steps, changes, slot, dots)


@njit(cache=True, fastmath=FUSE)
def _remember_chunk(chunk, state, residual, last_state, last_residual, steps, changes, slot, dots):  # type: ignore[no-untyped-def]
    begin, end = chunk * len(state) // CHUNKS, (chunk + 1) * len(state) // CHUNKS
    for i in range(begin, end):
        change = residual[i] - last_residual[i]
        changes[slot, i] = change
        steps[slot, i] = state[i] - last_state[i] + change
    for j in range(dots.shape[2]):
        product, right = 0.0, 0.0
        for i in range(begin, end):
            product += changes[j, i] * changes[slot, i]
            right += changes[j, i] * residual[i]
        dots[chunk, 0, j], dots[chunk, 1, j] = product, right


@njit(cache=True, parallel=True)
def _combine(residual, weights, steps, step):  # type: ignore[no-untyped-def]
    for chunk in prange(CHUNKS):
        _combine_chunk(chunk, residual, weights, steps, step)


@njit(cache=True)
def _combine_alone(residual, weights, steps, step):  # type: ignore[no-untyped-def]
    for chunk in range(CHUNKS):
        _combine_chunk(chunk, residual, weights, steps, step)


@njit(cache=True)
def _combine_chunk(chunk, residual, weights, steps, step):  # type: ignore[no-untyped-def]
    begin, end = chunk * len(step) // CHUNKS, (chunk + 1) * len(step) // CHUNKS
    for i in range(begin, end):
        step[i] = residual[i]
    for j in range(len(weights)):
        for i in range(begin, end):
            step[i] -= weights[j] * steps[j, i]
