"""Loops over the patches of an anatomical local model, which are small and differ in size, in compiled form.

The arrays of all patches lie one after the other. Patch p has n_p members from `starts[p]`, r_p directions, and a_p of
its members lie over bone, from `over_starts[p]`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from retarget.types import FloatArray, IntArray

SMALL = 100_000  # places: below, waking threads takes longer than the work
HALVINGS = 8  # of a step that does not lower its patch's energy
FUSE = {"contract", "reassoc", "nsz"}  # NaN and infinity keep their meaning


@dataclass(frozen=True)
class Patch:
    """One patch of the neutral, about its middle, and the directions in which it deforms."""

    rest: FloatArray  # (n_p, 3) mm
    directions: FloatArray  # (r_p, n_p, 3) mm
    over: IntArray  # (a_p,) members over bone
    base: FloatArray  # (a_p, 7) bone point, normal, thickness
    slopes: FloatArray  # (r_p, a_p, 7) of the directions


@dataclass(frozen=True)
class Pulls:
    """Weights of the energies and what they draw the patches to."""

    goals: FloatArray  # (m, 3) mm
    data: float
    anatomy: float
    stitch: FloatArray  # (m,)
    products: FloatArray  # (P, width, width) of the directions under `data` and `stitch`


class Patches:
    """All patches of a model."""

    def __init__(self, patches: Sequence[Patch]) -> None:
        self.ranks: IntArray = np.array([len(patch.directions) for patch in patches], dtype=np.int64)
        self._starts = _starts([len(patch.rest) for patch in patches])
        self._over_starts = _starts([len(patch.over) for patch in patches])
        self._direction_starts = _starts([patch.directions.size for patch in patches])
        self._slope_starts = _starts([patch.slopes.size for patch in patches])
        self._rest = np.concatenate([patch.rest for patch in patches])
        self._directions = np.concatenate([patch.directions.ravel() for patch in patches])
        self._over = np.concatenate([patch.over for patch in patches])
        self._base = np.concatenate([patch.base for patch in patches])
        self._slopes = np.concatenate([patch.slopes.ravel() for patch in patches])
        self.width = int(self.ranks.max(initial=0))

    def shown(self, weights: FloatArray, turns: FloatArray, shifts: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(m, 3) mm of the patches in their own frames, and where eq. (3) puts them.

        For weights (P, width) of the directions, turns (P, 3, 3) and shifts (P, 3) mm.
        """
        local, x = self._rest.copy(), np.empty_like(self._rest)
        show = _show if len(x) > SMALL else _show_alone
        show(weights, turns, shifts, self.ranks, self._starts, self._direction_starts, self._directions, local, x)
        return local, x

    def products(self, weights: FloatArray) -> FloatArray:
        """(P, width, width) of the directions, for weights (m,) of the places."""
        found = np.zeros((len(self.ranks), self.width, self.width))
        for p, rank in enumerate(self.ranks):
            first, last = self._starts[p : p + 2]
            shown = self._directions[slice(*self._direction_starts[p : p + 2])].reshape(rank, 3 * (last - first))
            found[p, :rank, :rank] = (shown * np.repeat(weights[first:last], 3)) @ shown.T
        return found

    def factors(self) -> FloatArray:
        """(P, width + 6, width + 6), for `steps` to fill."""
        return np.zeros((len(self.ranks), self.width + 6, self.width + 6))

    def steps(
        self,
        turns: FloatArray,
        weights: FloatArray,
        local: FloatArray,
        x: FloatArray,
        mean: FloatArray,
        pulls: Pulls,
        factors: FloatArray,
        refresh: bool,
    ) -> tuple[FloatArray, float]:
        """Steps (P, 6 + width) of turn and shift, in each patch's frame, and weights, and the energy before them.

        x (m, 3) mm and mean (m, 3) mm are what the patches show at their places, and what all that share the vertex
        show on average. factors: of an earlier call, or made here where `refresh`.
        """
        steps = np.zeros((len(self.ranks), 6 + self.width))
        energies = np.zeros(len(self.ranks))
        step = _step if len(x) > SMALL else _step_alone
        step(
            turns, weights, local, x, mean,
            pulls.goals, pulls.data, pulls.anatomy, pulls.stitch, pulls.products, factors, refresh,
            self.ranks, self._starts, self._direction_starts, self._directions, self._over_starts, self._over,
            self._base, self._slope_starts, self._slopes, steps, energies,
        )  # fmt: skip
        return steps, float(energies.sum())


def _starts(sizes: Sequence[int]) -> IntArray:
    return np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)]).astype(np.int64)


@njit(cache=True, parallel=True)
def _show(weights, turns, shifts, ranks, starts, direction_starts, directions, local, x):  # type: ignore[no-untyped-def]
    for p in prange(len(ranks)):
        _show_patch(p, weights, turns, shifts, ranks, starts, direction_starts, directions, local, x)


@njit(cache=True)
def _show_alone(weights, turns, shifts, ranks, starts, direction_starts, directions, local, x):  # type: ignore[no-untyped-def]
    for p in range(len(ranks)):
        _show_patch(p, weights, turns, shifts, ranks, starts, direction_starts, directions, local, x)


@njit(cache=True, fastmath=FUSE)
def _show_patch(p, weights, turns, shifts, ranks, starts, direction_starts, directions, local, x):  # type: ignore[no-untyped-def]
    flat = local.reshape(-1)
    first, size = 3 * starts[p], 3 * (starts[p + 1] - starts[p])
    for k in range(ranks[p]):
        w, offset = weights[p, k], direction_starts[p] + k * size
        for i in range(size):
            flat[first + i] += w * directions[offset + i]
    for v in range(starts[p], starts[p + 1]):
        a, b, c = local[v, 0], local[v, 1], local[v, 2]
        for i in range(3):
            x[v, i] = turns[p, i, 0] * a + turns[p, i, 1] * b + turns[p, i, 2] * c + shifts[p, i]


@njit(cache=True, parallel=True)
def _step(  # type: ignore[no-untyped-def]
    turns, weights, local, x, mean, goals, data, anatomy, stitch, products, factors, refresh,
    ranks, starts, direction_starts, directions, over_starts, over, base, slope_starts, slopes, steps, energies,
):  # fmt: skip
    for p in prange(len(ranks)):
        _step_patch(
            p, turns, weights, local, x, mean, goals, data, anatomy, stitch, products, factors, refresh,
            ranks, starts, direction_starts, directions, over_starts, over, base, slope_starts, slopes, steps, energies,
        )  # fmt: skip


@njit(cache=True)
def _step_alone(  # type: ignore[no-untyped-def]
    turns, weights, local, x, mean, goals, data, anatomy, stitch, products, factors, refresh,
    ranks, starts, direction_starts, directions, over_starts, over, base, slope_starts, slopes, steps, energies,
):  # fmt: skip
    for p in range(len(ranks)):
        _step_patch(
            p, turns, weights, local, x, mean, goals, data, anatomy, stitch, products, factors, refresh,
            ranks, starts, direction_starts, directions, over_starts, over, base, slope_starts, slopes, steps, energies,
        )  # fmt: skip


@njit(cache=True)
def _step_patch(  # type: ignore[no-untyped-def]
    p, turns, weights, local, x, mean, goals, data, anatomy, stitch, products, factors, refresh,
    ranks, starts, direction_starts, directions, over_starts, over, base, slope_starts, slopes, steps, energies,
):  # fmt: skip
    first, last, rank = starts[p], starts[p + 1], ranks[p]
    size, held = last - first, over_starts[p + 1] - over_starts[p]
    turn = turns[p]
    shown = directions[direction_starts[p] : direction_starts[p + 1]].reshape(rank, 3 * size)
    slope = slopes[slope_starts[p] : slope_starts[p + 1]].reshape(rank, 7 * held)
    known = base[over_starts[p] : over_starts[p + 1]]
    members = over[over_starts[p] : over_starts[p + 1]]
    y = local[first:last]
    own, shape, asked = np.empty((size, 3)), np.empty((held, 7)), np.empty((held, 7))
    gradient = np.zeros(6 + rank)
    here, wanted, pull = x[first:last], goals[first:last], stitch[first:last]
    energies[p] = _pull_of_surface(turn, here, mean[first:last], wanted, data, pull, own)
    _known(known, slope, weights[p], shape)
    energies[p] += _pull_of_bone(turn, here, members, shape, anatomy, own, asked)
    _gradient(y, own, shown, slope, asked, gradient)
    if refresh:
        matrix = np.zeros((6 + rank, 6 + rank))
        matrix[6:, 6:] = products[p, :rank, :rank]
        _add_surface(y, shown, data, pull, matrix)
        _add_bone(turn, y, shown, slope, members, shape, anatomy, matrix)
        for i in range(6 + rank):
            matrix[i, i] = matrix[i, i] * (1 + 1e-9) + 1e-9
        factors[p, : 6 + rank, : 6 + rank] = np.linalg.inv(matrix)
    step = -(np.ascontiguousarray(factors[p, : 6 + rank, : 6 + rank]) @ gradient)
    moved, placed = np.empty((size, 3)), np.empty((size, 3))
    for _ in range(HALVINGS):
        _known(y, shown, step[6:], moved)
        _put(turn, x[first:last], y, step, moved, placed)
        _known(known, slope, weights[p, :rank] + step[6:], shape)
        after = _pull_of_surface(turn, placed, mean[first:last], wanted, data, pull, own)
        after += _pull_of_bone(turn, placed, members, shape, anatomy, own, asked)
        if after <= energies[p]:
            break
        step *= 0.5
    else:
        step[:] = 0.0
    steps[p, : 6 + rank] = step


@njit(cache=True, fastmath=FUSE)
def _pull_of_surface(turn, x, mean, goals, data, stitch, own):  # type: ignore[no-untyped-def]
    """Energy of eq. (12) and of the overlap; own (n, 3): its gradient over the points, in the patch's frame."""
    energy = 0.0
    pull = np.empty(3)
    for v in range(len(x)):
        for c in range(3):
            off, apart = x[v, c] - goals[v, c], x[v, c] - mean[v, c]
            pull[c] = data * off + stitch[v] * apart
            energy += data * off * off + stitch[v] * apart * apart
        for c in range(3):
            own[v, c] = turn[0, c] * pull[0] + turn[1, c] * pull[1] + turn[2, c] * pull[2]
    return energy


@njit(cache=True, fastmath=FUSE)
def _known(base, slope, weights, shape):  # type: ignore[no-untyped-def]
    """shape (a, 7): bone point, normal, thickness of eqs (4) to (6)."""
    flat, start = shape.reshape(-1), base.reshape(-1)
    for i in range(len(flat)):
        flat[i] = start[i]
    for k in range(len(slope)):
        w = weights[k]
        for i in range(len(flat)):
            flat[i] += w * slope[k, i]


@njit(cache=True, fastmath=FUSE)
def _put(turn, x, y, step, moved, placed):  # type: ignore[no-untyped-def]
    """placed (n, 3): where a step takes a patch that is at x, y in its own frame; `moved` is its new shape."""
    angle = np.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
    sine = np.sin(angle) / angle if angle > 0 else 1.0
    cosine = (1 - np.cos(angle)) / angle**2 if angle > 0 else 0.5
    a, b, c = step[0], step[1], step[2]
    own = np.empty(3)
    for v in range(len(x)):
        first, second, third = moved[v, 0], moved[v, 1], moved[v, 2]
        s0, s1, s2 = b * third - c * second, c * first - a * third, a * second - b * first
        own[0] = first + sine * s0 + cosine * (b * s2 - c * s1) - y[v, 0] + step[3]
        own[1] = second + sine * s1 + cosine * (c * s0 - a * s2) - y[v, 1] + step[4]
        own[2] = third + sine * s2 + cosine * (a * s1 - b * s0) - y[v, 2] + step[5]
        for i in range(3):
            placed[v, i] = x[v, i] + turn[i, 0] * own[0] + turn[i, 1] * own[1] + turn[i, 2] * own[2]


@njit(cache=True, fastmath=FUSE)
def _pull_of_bone(turn, x, members, shape, anatomy, own, asked):  # type: ignore[no-untyped-def]
    """Energy of the anatomical constraint; its gradient over the points is added to `own`, and that over bone point,
    normal and thickness goes to asked (a, 7)."""
    energy = 0.0
    miss, normal = np.empty(3), np.empty(3)
    for a in range(len(members)):
        v, thickness = members[a], shape[a, 6]
        length = np.sqrt(shape[a, 3] ** 2 + shape[a, 4] ** 2 + shape[a, 5] ** 2)
        along = 0.0
        for c in range(3):
            normal[c] = shape[a, 3 + c] / length
            miss[c] = x[v, c] - shape[a, c] - thickness * normal[c]
            energy += anatomy * miss[c] * miss[c]
            along += miss[c] * normal[c]
        for c in range(3):
            own[v, c] += anatomy * (turn[0, c] * miss[0] + turn[1, c] * miss[1] + turn[2, c] * miss[2])
            asked[a, c] = -anatomy * miss[c]
            asked[a, 3 + c] = -anatomy * thickness / length * (miss[c] - normal[c] * along)
        asked[a, 6] = -anatomy * along
    return energy


@njit(cache=True, fastmath=FUSE)
def _gradient(y, own, shown, slope, asked, gradient):  # type: ignore[no-untyped-def]
    """Over turn, shift and weights, in the patch's frame."""
    for v in range(len(y)):
        gradient[0] += y[v, 1] * own[v, 2] - y[v, 2] * own[v, 1]
        gradient[1] += y[v, 2] * own[v, 0] - y[v, 0] * own[v, 2]
        gradient[2] += y[v, 0] * own[v, 1] - y[v, 1] * own[v, 0]
        for c in range(3):
            gradient[3 + c] += own[v, c]
    pull, bone = own.reshape(-1), asked.reshape(-1)
    for k in range(len(shown)):
        total = 0.0
        for i in range(len(pull)):
            total += shown[k, i] * pull[i]
        for i in range(len(bone)):
            total += slope[k, i] * bone[i]
        gradient[6 + k] = total


@njit(cache=True, fastmath=FUSE)
def _add_surface(y, shown, data, stitch, matrix):  # type: ignore[no-untyped-def]
    """Gauss and Newton's matrix of the data and of the overlap with the mean as it is, but for weights by weights."""
    rows = np.zeros((len(matrix), 3))
    for v in range(len(y)):
        _row(y[v], shown, v, rows)
        _add(rows, data + stitch[v], 6, matrix)
    for i in range(6, len(matrix)):
        for j in range(6):
            matrix[i, j] = matrix[j, i]


@njit(cache=True, fastmath=FUSE)
def _add_bone(turn, y, shown, slope, members, shape, anatomy, matrix):  # type: ignore[no-untyped-def]
    """That of the anatomical constraint, in the patch's frame."""
    rows = np.zeros((len(matrix), 3))
    normal, moved = np.empty(3), np.empty(3)
    for a in range(len(members)):
        _row(y[members[a]], shown, members[a], rows)
        length = np.sqrt(shape[a, 3] ** 2 + shape[a, 4] ** 2 + shape[a, 5] ** 2)
        for c in range(3):
            normal[c] = shape[a, 3 + c] / length
        for k in range(len(shown)):
            at = 7 * a
            along = normal[0] * slope[k, at + 3] + normal[1] * slope[k, at + 4] + normal[2] * slope[k, at + 5]
            for c in range(3):
                turned = (slope[k, at + 3 + c] - normal[c] * along) / length
                moved[c] = slope[k, at + c] + shape[a, 6] * turned + slope[k, at + 6] * normal[c]
            for c in range(3):
                rows[6 + k, c] -= turn[0, c] * moved[0] + turn[1, c] * moved[1] + turn[2, c] * moved[2]
        _add(rows, anatomy, len(rows), matrix)


@njit(cache=True, fastmath=FUSE)
def _row(y, shown, v, rows):  # type: ignore[no-untyped-def]
    """(6 + r, 3): how a member at y moves with turn, shift and weights."""
    rows[0, 1], rows[0, 2] = -y[2], y[1]
    rows[1, 0], rows[1, 2] = y[2], -y[0]
    rows[2, 0], rows[2, 1] = -y[1], y[0]
    for c in range(3):
        rows[3 + c, c] = 1.0
    for k in range(len(shown)):
        for c in range(3):
            rows[6 + k, c] = shown[k, 3 * v + c]


@njit(cache=True, fastmath=FUSE)
def _add(rows, weight, count, matrix):  # type: ignore[no-untyped-def]
    for i in range(count):
        a, b, c = weight * rows[i, 0], weight * rows[i, 1], weight * rows[i, 2]
        for j in range(len(matrix)):
            matrix[i, j] += a * rows[j, 0] + b * rows[j, 1] + c * rows[j, 2]
