"""Forces that keep two surfaces apart, without friction, on a condensed system.

With the gaps g_k of sample k at the points q, their directions n_k and the rows J_k = sample - nearest point, forces
f = J^T (n lambda) at the points move them by K f. Wanted are lambda >= 0 such that every gap is at least what it may
be, and lambda_k = 0 where it is more: a linear complementarity problem, one of a convex quadratic programme. Both sides
of a contact get opposite forces, so they meet where these balance: half-way if they are equally soft.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from retarget.simulation.condensed import moves
from retarget.simulation.facing import Gaps, Samples
from retarget.types import FloatArray

TOLERANCE = 0.03  # mm: a sample that is less too deep is no new contact
PARTED = 0.05  # mm: surfaces are apart if no sample is more too deep
PASSABLE = 0.1  # mm: the same, on the way
OPEN = 0.6  # mm: a sample without a force that is further outside is left out of a round
STRIDE = 1.5  # mm: how far points move at most, relative to their mean, before contacts are looked for again
SHORTEST = 0.1  # of the longest step: the last one before the way ends
LONGEST = 40  # rounds on the way
LOOSE = 1e-4  # of a point's mean compliance, where points are held

Detect = Callable[[FloatArray], Gaps]


def complementary(matrix: FloatArray, wanted: FloatArray, guess: NDArray[np.bool_]) -> FloatArray:
    """lambda (k,) >= 0 with y = matrix lambda - wanted >= 0 and lambda y = 0, for a positive definite matrix (k, k).

    Block principal pivoting (Portugal, Judice, Vicente 1994), from a guess (k,) of where lambda > 0. It ends for any
    such matrix; the limit on the number of turns is one against rounding.
    """
    held, fewest, patience = guess.copy(), len(wanted) + 1, 3
    forces = np.zeros(len(wanted))
    for _ in range(20 + 3 * len(wanted)):
        forces = np.zeros(len(wanted))
        if held.any():
            factor = cho_factor(matrix[np.ix_(held, held)], check_finite=False)
            forces[held] = cho_solve(factor, wanted[held], check_finite=False)
        wrong = np.where(held, forces < 0, matrix @ forces - wanted < -1e-9)
        count = int(wrong.sum())
        if count == 0:
            break
        if count < fewest:
            fewest, patience = count, 3
        elif patience > 0:
            patience -= 1
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False  # Murty's rule: the last one alone
        held ^= wrong
    return np.maximum(forces, 0.0)


@dataclass(frozen=True)
class Apart:
    """Forces (p, 3) at the points, what is left, and what it took."""

    forces: FloatArray
    touching: NDArray[np.bool_]  # (s,) samples with a force
    left: float  # mm, how much deeper any sample is than it may be
    rounds: int
    way: float = 1.0  # of the way from rest that the points have gone


class Parting:
    """Keeps samples of surfaces on points at rest (p, 3) mm apart, where forces move points by `compliance` (p, p)."""

    def __init__(
        self,
        detect: Detect,
        samples: Samples,
        floor: FloatArray,
        rest: FloatArray,
        compliance: FloatArray,
        stiffness: float,
    ) -> None:
        """floor: (s,) mm <= 0, how negative each gap may be. stiffness: of a contact, relative to a point's."""
        self._detect, self._samples, self._floor = detect, samples, floor
        self._rest, self._compliance, self._give = rest, compliance, 1 / stiffness

    def directly(self, free: FloatArray, rounds: int) -> Apart:
        """From points `free` (p, 3) mm, where they are without contacts. For surfaces that cross a little."""
        nothing = Apart(np.zeros_like(free), np.zeros(self._samples.count, dtype=bool), np.inf, 0)
        return self._keep(free, nothing, rounds, PARTED)

    def along(self, free: FloatArray, rounds: int, each: int = 5) -> Iterator[Apart]:
        """The same on the straight way from rest, where they do not cross, so that each contact is found when it is
        shallow and on the side that it came from.

        The way ends where its steps become shorter than SHORTEST without parting the surfaces, and after LONGEST
        rounds. First comes the state at its end, then those 1, 2, 4... steps before it, and rest: states with a `way`
        below 1 hold all points where they were.
        """
        now = Apart(np.zeros_like(free), np.zeros(self._samples.count, dtype=bool), 0.0, 0, way=0.0)
        moves = free - self._rest
        longest = min(0.25, STRIDE / max(float(np.linalg.norm(moves - moves.mean(axis=0), axis=1).max()), STRIDE))
        step, shortest, spent, trail = longest, SHORTEST * longest, 0, [now]
        while now.way < 1.0 and step >= shortest and spent < LONGEST:
            end = min(1.0, now.way + step)
            goal = PARTED if end == 1.0 else PASSABLE
            tried = self._keep(self._rest + end * (free - self._rest), now, rounds if end == 1.0 else each, goal)
            spent += tried.rounds
            if tried.left > goal:
                step *= 0.5
                continue
            now, step = replace(tried, way=end), min(1.5 * step, longest)
            trail.append(now)
        back = [1 << n for n in range(len(trail).bit_length()) if 1 << n < len(trail)]
        for state in [now, *(trail[-1 - steps] for steps in back), trail[0]]:
            held = state.forces + self._held(free, state.way) if state.way < 1.0 else state.forces
            yield replace(state, forces=held, rounds=spent)

    def _keep(self, free: FloatArray, start: Apart, rounds: int, goal: float) -> Apart:
        """Contacts are found and solved for in turns; all that were found count until the end."""
        forces, touching, known, worst = start.forces, start.touching, start.touching.copy(), np.inf
        for turn in range(rounds + 1):
            points = free + moves(self._compliance, forces)
            found = self._detect(points)
            deeper = self._floor - found.gap
            before, worst = worst, float(deeper.max(initial=0.0))
            new = deeper > TOLERANCE
            hopeless = turn > 6 and worst > goal and worst > 0.9 * before
            if turn == rounds or hopeless or (not new.any() and (turn > 0 or not touching.any())):
                break
            known |= new
            use = np.flatnonzero(known & np.isfinite(found.gap) & (touching | (deeper > -OPEN)))
            rows, normal = self._rows(found, use), found.normal[use]
            pulled = np.unique(rows.indices)
            some = rows[:, pulled]
            half = some @ self._compliance[np.ix_(pulled, pulled)]
            matrix = (some @ np.ascontiguousarray(half.T)) * (normal @ normal.T)
            matrix[np.diag_indices_from(matrix)] += self._give * np.diag(self._compliance).mean()
            wanted = deeper[use] - np.einsum("ki,ki->k", normal, rows @ (free - points))
            pushed = complementary(matrix, wanted, touching[use])
            forces = rows.T @ (pushed[:, None] * normal)
            touching = np.zeros(self._samples.count, dtype=bool)
            touching[use] = pushed > 0
        return Apart(forces, touching, worst, turn)

    def _rows(self, found: Gaps, use: NDArray[np.int64]) -> sp.csr_array:
        """J (k, p)."""
        columns = np.hstack([self._samples.corners[use], found.corners[use]])
        values = np.hstack([self._samples.weights[use], -found.weights[use]])
        ends = 6 * np.arange(len(use) + 1)
        return sp.csr_array((values.ravel(), columns.ravel(), ends), shape=(len(use), len(self._rest)))

    def _held(self, free: FloatArray, way: float) -> FloatArray:
        """Forces (p, 3) that take all points back to this part of their way. Embedded points do not move
        independently of each other, so it is a regularised problem, refined."""
        matrix = self._compliance.copy()
        matrix[np.diag_indices_from(matrix)] += LOOSE * np.diag(matrix).mean()
        factor, wanted = cho_factor(matrix, check_finite=False), (way - 1) * (free - self._rest)
        forces = np.zeros_like(free)
        for _ in range(4):
            forces += cho_solve(factor, wanted - self._compliance @ forces, check_finite=False)
        return forces
