"""The anatomical local model of one character, fitted to patches: Wu et al. 2016 as Chandran et al. 2022 use it.

    X_p = M_p (U_p + sum_k w_pk D_pk)                                                   eq. (3)

minimises, over the rigid motion M_p and the weights w_p of every patch,

    lambda_D sum_v sum_p |X_p(v) - X'_p(v)|^2                                           eq. (12), squared
        + lambda_A sum_v sum_p |X_p(v) - (b_v + d_v n_v)(w_p)|^2                        eqs (4) to (6)
        + lambda_O sum_v sum_{p < q} |X_p(v) - X_q(v)|^2                                overlap

Nothing holds the weights themselves, so only the shapes that they span matter: here they count from the neutral, and
each patch has the few directions that its shapes span within `SPANNED`.

Given the mean of the patches at every vertex they come apart, as sum_{p < q} |X_p - X_q|^2 = c sum_p |X_p - mean|^2 for
the c patches of a vertex. Each patch takes a step of Gauss and Newton with the mean as it is, and Anderson acceleration
makes up for the mean that moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from retarget.check import InvalidInput
from retarget.rig.local_model.layout import OverlappingPatches
from retarget.rig.local_model.patch_kernels import Patch, Patches, Pulls
from retarget.rig.local_model.skin_over_bone import SkinOverBone
from retarget.simulation.anderson import Anderson
from retarget.types import FloatArray, IntArray, SolveInfo, Status

SPANNED = 5e-3  # mm, root of the mean square over a patch
LEAST_STEP = 2e-3  # mm that the surface may still move in an iteration
ITERATIONS = 100
REFRESHED = 4  # iterations after which matrices are made anew
DEPTH = 6  # of the acceleration


@dataclass(frozen=True)
class ReconstructionSettings:
    """Weights of the three energies; only their ratios matter. Raises InvalidInput for weights out of range."""

    lambda_data: float = 10.0
    lambda_anatomy: float = 10.0  # lambda_A1
    lambda_stitch: float = 0.85  # lambda_O of section 3.3

    def __post_init__(self) -> None:
        if not 0 < self.lambda_data < np.inf:
            raise InvalidInput(f"lambda_data: expected a positive number, got {self.lambda_data}.")
        for name in ("lambda_anatomy", "lambda_stitch"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise InvalidInput(f"{name}: expected 0 or a positive number, got {value}.")


class AnatomicalLocalModel:
    """Built from the neutral (n, 3) and k further shapes (k, n, 3) mm of one character; see the module."""

    def __init__(
        self,
        neutral: FloatArray,
        shapes: FloatArray,
        layout: OverlappingPatches,
        bone: SkinOverBone,
        settings: ReconstructionSettings,
    ) -> None:
        """bone: of the neutral and the shapes, in this order."""
        self.layout, self.settings = layout, settings
        self._stitch = settings.lambda_stitch * layout.multiplicity[layout.vertices]  # (m,)
        place = np.full(len(neutral), -1)
        place[bone.vertices] = np.arange(len(bone.vertices))
        known = bone.stacked
        made = [
            _patch(neutral[v], shapes[:, v], np.flatnonzero(place[v] >= 0), known, place[v]) for v in layout.members
        ]
        self._patches = Patches([patch for patch, _ in made])
        self._products = self._patches.products(settings.lambda_data + self._stitch)
        self._mixing = tuple(mixing for _, mixing in made)  # (k, r_p) each: directions of the shapes

    def __call__(self, wanted: FloatArray, alpha: FloatArray) -> tuple[FloatArray, SolveInfo]:
        """The surface (n, 3) mm for retargeted patches (m, 3) mm at their places, from their coefficients (P, k)."""
        layout, patches = self.layout, self._patches
        weights = np.zeros((len(alpha), patches.width))
        for row, own, mixing in zip(weights, alpha, self._mixing, strict=True):
            row[: mixing.shape[1]] = own @ mixing
        still = np.broadcast_to(np.eye(3), (len(alpha), 3, 3)), np.zeros((len(alpha), 3))
        start, shifts = _placed(patches.shown(weights, *still)[0], wanted, layout)
        state = np.hstack([np.zeros_like(shifts), shifts, weights])  # turn after `start`, shift, weights
        pulls = Pulls(wanted, self.settings.lambda_data, self.settings.lambda_anatomy, self._stitch, self._products)
        accelerate, factors = Anderson(DEPTH), patches.factors()
        before: FloatArray | None = None
        energies: list[float] = []
        moved = np.inf
        while True:
            turns = start @ Rotation.from_rotvec(state[:, :3]).as_matrix()
            local, x = patches.shown(state[:, 6:], turns, state[:, 3:6])
            mean = layout.mean(x)
            moved = np.inf if before is None else float(np.abs(mean - before).max())
            if moved < LEAST_STEP or len(energies) == ITERATIONS:
                break
            before = mean
            refresh = len(energies) % REFRESHED == 0
            steps, energy = patches.steps(turns, state[:, 6:], local, x, mean[layout.vertices], pulls, factors, refresh)
            if energies and energy > energies[-1]:
                accelerate.restart()
            energies.append(energy)
            steps[:, 3:6] = np.einsum("pij,pj->pi", turns, steps[:, 3:6])
            turned = Rotation.from_rotvec(state[:, :3]) * Rotation.from_rotvec(steps[:, :3])
            steps[:, :3] = turned.as_rotvec() - state[:, :3]
            state = state + accelerate(state, steps)
        status = Status.CONVERGED if moved < LEAST_STEP else Status.MAX_ITERATIONS
        return layout.blend(x), SolveInfo(status, len(energies), tuple(energies))


def _patch(
    neutral: FloatArray, shapes: FloatArray, over: IntArray, known: FloatArray, place: IntArray
) -> tuple[Patch, FloatArray]:
    """A patch of members (n_p, 3), (k, n_p, 3) mm; those `over` bone are at place (n_p,) of known (K, 7, a)."""
    rest = neutral - neutral.mean(axis=0)
    change = _without_motion(shapes, rest) - rest
    lying = known[:, :, place[over]].transpose(0, 2, 1)  # (K, a_p, 7)
    slopes = lying[1:] - lying[0]
    scaled = slopes * np.r_[np.ones(3), np.full(3, lying[0, :, 6].max(initial=0.0)), 1.0]  # all in mm
    rows = np.hstack([change.reshape(len(shapes), -1), scaled.reshape(len(shapes), -1)])
    values, mixing = np.linalg.eigh(rows @ rows.T)
    mixing = np.ascontiguousarray(mixing[:, values > SPANNED**2 * (len(rest) + len(over))])
    directions, leaning = np.tensordot(mixing.T, change, 1), np.tensordot(mixing.T, slopes, 1)
    return Patch(rest, directions, over, lying[0], leaning), mixing


def _without_motion(shapes: FloatArray, rest: FloatArray) -> FloatArray:
    """(k, n_p, 3) mm: shapes of a patch, moved rigidly to the patch at rest about its middle."""
    centred = shapes - shapes.mean(axis=1, keepdims=True)
    moved: FloatArray = centred @ _turns(rest.T @ centred).transpose(0, 2, 1)
    return moved


def _placed(local: FloatArray, goals: FloatArray, layout: OverlappingPatches) -> tuple[FloatArray, FloatArray]:
    """Turns (P, 3, 3) and shifts (P, 3) mm of patches (m, 3) mm that bring them closest to goals (m, 3) mm."""
    middles = np.array([(local[at].mean(axis=0), goals[at].mean(axis=0)) for at in layout.places])
    crossed = np.array([goals[at].T @ local[at] for at in layout.places])
    sizes = np.array([len(members) for members in layout.members])[:, None, None]
    turns = _turns(crossed - sizes * middles[:, 1, :, None] * middles[:, 0, None, :])
    return turns, middles[:, 1] - np.einsum("pij,pj->pi", turns, middles[:, 0])


def _turns(crossed: FloatArray) -> FloatArray:
    """The rotations (..., 3, 3) closest to matrices: Kabsch 1976. Points on one line turn as little as they must."""
    u, _, vt = np.linalg.svd(crossed)
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    turns: FloatArray = u @ vt
    return turns
