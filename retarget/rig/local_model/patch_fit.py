"""Patch blendshapes whose coefficients are coupled between neighbours: Chandran et al. 2022, eqs (1), (7) to (11).

The printed energies lack squares. With them, over the coefficients alpha_p of all patches and a rigid motion,

    lambda_Fit sum_p |Y_p - p_0 - B_p alpha_p|^2 + lambda_Reg sum_p |alpha_p|^2
        + lambda_O sum_p sum_{q in N(p)} |alpha_p - alpha_q|^2,            Y = Q X + s, the frame in the model's place

where Q X + s is the inverse of the paper's R. A rotation does not change the length of a residual, so the matrix of
the coefficients depends on the examples alone and is factorised once. Frames enter by their moments with the
blendshapes only, so that an iteration over the rigid motion costs one back-substitution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from retarget.check import InvalidInput
from retarget.geometry.cholesky import CholeskyFactor
from retarget.rig.blendshapes import Residual
from retarget.rig.local_model.layout import OverlappingPatches
from retarget.suggest import choose
from retarget.types import FloatArray, SolveInfo, Status

LEAST_STEP = 1e-7  # mm that the rigid motion may still move a head
HEAD = 100.0  # mm from the middle of a head to its skin, for angles
ITERATIONS = 60
_CROSS = np.zeros((3, 3, 3))  # (a x b)_e = sum_cd _CROSS[e, c, d] a_c b_d
_CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
_CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


@dataclass(frozen=True)
class PatchFitSettings:
    """Weights of eq. (10), with lambda_Fit = 1.

    lambda_reg and lambda_overlap are in squared units of `length_mm` millimetres, and the squared distances of a patch
    are a mean or a sum over its vertices: see `retarget.rig.blendshapes.Ridge`. lambda_overlap may be 0.
    rigid: remove one rigid motion per frame, R of eq. (7).
    Raises InvalidInput for settings out of range.
    """

    lambda_reg: float
    lambda_overlap: float
    residual: Residual | str = Residual.MEAN
    length_mm: float = 1.0
    rigid: bool = True

    def __post_init__(self) -> None:
        for name in ("lambda_reg", "length_mm"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise InvalidInput(f"{name}: expected a positive number, got {value}.")
        if not 0 <= self.lambda_overlap < np.inf:
            raise InvalidInput(f"lambda_overlap: expected 0 or a positive number, got {self.lambda_overlap}.")
        choose("residual", self.residual, Residual)

    @property
    def regulariser(self) -> float:
        """mm^2."""
        return self.lambda_reg * self.length_mm**2

    @property
    def coupling(self) -> float:
        """mm^2."""
        return self.lambda_overlap * self.length_mm**2


@dataclass(frozen=True)
class PatchCoefficients:
    """What a fit finds for t frames: alpha (t, P, k), already times gamma, and the motion Y = rotation X + shift."""

    alpha: FloatArray
    rotation: FloatArray  # (t, 3, 3)
    shift: FloatArray  # (t, 3) mm
    info: tuple[SolveInfo, ...] = ()  # of the rigid motion


class PatchBlendshapes:
    """Blendshapes of every patch of one character: eq. (1), or eq. (2)."""

    def __init__(self, neutral: FloatArray, examples: FloatArray, layout: OverlappingPatches) -> None:
        """neutral (n, 3) and examples (k, n, 3) in mm; k may be 0."""
        self.neutral, self.layout, self.count = neutral, layout, len(examples)
        shown = np.ascontiguousarray(np.moveaxis(examples - neutral, 0, 1))  # (n, k, 3)
        self.deltas = tuple(shown[members].transpose(1, 2, 0).copy() for members in layout.members)  # (k, 3, n_p) each

    def at_places(self, alpha: FloatArray) -> FloatArray:
        """(m, 3) mm: every patch with its coefficients (P, k)."""
        moved = np.concatenate(
            [
                (a @ deltas.reshape(self.count, -1)).reshape(3, -1).T
                for a, deltas in zip(alpha, self.deltas, strict=True)
            ]
        )
        return self.neutral[self.layout.vertices] + moved

    def blend(self, alpha: FloatArray) -> FloatArray:
        """(t, n, 3) mm: the patches put together, for coefficients (t, P, k)."""
        frames = [self.layout.blend(self.at_places(a)) for a in alpha]
        return np.array(frames).reshape(len(alpha), *self.neutral.shape)


class PatchFit:
    """The coefficients of patch blendshapes that rebuild frames; factorised once.

    preferences: gamma of eq. (11), (P, k) in [0, 1], by default 1.
    """

    def __init__(
        self, shapes: PatchBlendshapes, settings: PatchFitSettings, preferences: FloatArray | None = None
    ) -> None:
        self.shapes, self.settings = shapes, settings
        layout, count = shapes.layout, shapes.count
        sizes = np.array([len(members) for members in layout.members])
        self._weights = 1 / sizes if settings.residual == Residual.MEAN else np.ones(len(sizes))  # lambda_Fit = 1
        self._gamma = np.ones((len(sizes), count)) if preferences is None else preferences
        products = np.array(
            [w * (flat @ flat.T) for w, flat in zip(self._weights, map(_flat, shapes.deltas), strict=True)]
        )
        self._factor = self._factorised(products.reshape(len(sizes), count, count)) if count else None
        self._at_rest = self._moments(shapes.neutral)  # (P, k, 3, 3)
        self._sums = np.array([w * d.sum(axis=2) for w, d in zip(self._weights, shapes.deltas, strict=True)])
        self._own = self._gamma * np.einsum("pkcc->pk", self._at_rest)
        place_weights = layout.total(np.repeat(self._weights, sizes))
        self._weighted: FloatArray = place_weights[:, None] * shapes.neutral
        self._vertex_weights = place_weights
        self._total = float(place_weights.sum())
        self._middle = self._weighted.sum(axis=0)
        if settings.rigid:
            self._rigid_hessian = self._reduced_hessian()

    def __call__(self, frames: FloatArray) -> PatchCoefficients:
        """Fit frames (t, n, 3) in mm; each as if it were alone."""
        return _joined([self._fitted(frame) for frame in frames], self._gamma.shape)

    def _factorised(self, products: FloatArray) -> CholeskyFactor:
        """The matrix of eq. (10) over all alpha."""
        settings, layout = self.settings, self.shapes.layout
        patches, count = self._gamma.shape
        degree = np.bincount(layout.neighbours.ravel(), minlength=patches)
        coupling = 2 * settings.coupling  # eq. (9) counts a pair of neighbours from both sides
        blocks = self._gamma[:, :, None] * products * self._gamma[:, None, :]  # eqs (7), (11)
        blocks[:, np.arange(count), np.arange(count)] += settings.regulariser + coupling * degree[:, None]  # eq. (8)
        place = np.arange(patches * count).reshape(patches, count)
        rows, columns = (np.broadcast_to(i, blocks.shape).ravel() for i in (place[:, :, None], place[:, None, :]))
        matrix = sp.csc_array((blocks.ravel(), (rows, columns)), shape=(place.size, place.size))
        if coupling > 0:
            p, q = (place[side].ravel() for side in layout.neighbours.T)
            off = sp.csc_array((np.full(len(p), coupling), (p, q)), shape=matrix.shape)
            matrix = sp.csc_array(matrix - off - off.T)  # eq. (9)
        return CholeskyFactor(matrix, "patch fit")

    def _moments(self, frame: FloatArray) -> FloatArray:
        """(P, k, 3, 3): sum over a patch of delta_c x_d, for a frame (n, 3)."""
        parts = [
            w * (deltas.reshape(-1, deltas.shape[2]) @ frame[members])
            for w, deltas, members in zip(self._weights, self.shapes.deltas, self.shapes.layout.members, strict=True)
        ]
        return np.array(parts).reshape(*self._gamma.shape, 3, 3)

    def _solved(self, moments: FloatArray, rotation: FloatArray, shift: FloatArray) -> FloatArray:
        """alpha (P, k) of eq. (10) for a frame with these moments, moved."""
        if self._factor is None:
            return np.zeros(self._gamma.shape)
        right = np.einsum("pkcd,cd->pk", moments, rotation) + self._sums @ shift
        return self._factor.solve((self._gamma * right - self._own).ravel()).reshape(self._gamma.shape)

    def _fitted(self, frame: FloatArray) -> PatchCoefficients:
        moments = self._moments(frame)
        rotation, shift, moved = np.eye(3), np.zeros(3), 0.0
        if not self.settings.rigid:
            return _one(self._gamma * self._solved(moments, rotation, shift), rotation, shift, 1, moved)
        crossed = self._weighted.T @ frame  # sum of S_c x_d
        middle = self._vertex_weights @ frame
        rotation, shift = _aligned(crossed, middle, self._middle, self._total)
        iterations = 0
        while iterations < ITERATIONS:
            iterations += 1
            beta = self._gamma * self._solved(moments, rotation, shift)
            model = crossed + np.einsum("pk,pkcd->cd", beta, moments)  # sum of m_c x_d, m = S + B beta
            model_middle = self._middle + np.einsum("pk,pkc->c", beta, self._sums)
            products = model @ rotation.T + np.outer(model_middle, shift)  # sum of m_c y_d
            gradient = np.concatenate(
                [
                    np.einsum("ecd,cd->e", _CROSS, products),
                    rotation @ middle + self._total * shift - model_middle,
                ]
            )
            step = -np.linalg.solve(self._rigid_hessian, gradient)
            turn = Rotation.from_rotvec(step[:3]).as_matrix()
            rotation, shift = turn @ rotation, turn @ shift + step[3:]
            moved = float(HEAD * np.linalg.norm(step[:3]) + np.linalg.norm(step[3:]))
            if moved < LEAST_STEP:
                break
        return _one(self._gamma * self._solved(moments, rotation, shift), rotation, shift, iterations, moved)

    def _reduced_hessian(self) -> FloatArray:
        """(6, 6) of the energy over turn and shift of the head at rest, with the best alpha for each."""
        products = self._weighted.T @ self.shapes.neutral
        hessian = np.zeros((6, 6))
        hessian[:3, :3] = np.trace(products) * np.eye(3) - products
        hessian[:3, 3:] = np.einsum("ecd,c->ed", _CROSS, self._middle)
        hessian[3:, :3] = hessian[:3, 3:].T
        hessian[3:, 3:] = self._total * np.eye(3)
        if self._factor is not None:
            turning = np.einsum("edc,pkcd->pke", _CROSS, self._at_rest)  # sum of S x delta
            coupled = (self._gamma[:, :, None] * np.concatenate([turning, self._sums], axis=2)).reshape(-1, 6)
            hessian -= coupled.T @ self._factor.solve(coupled)
        return hessian


def _aligned(
    crossed: FloatArray, middle: FloatArray, wanted: FloatArray, total: float
) -> tuple[FloatArray, FloatArray]:
    """The rigid motion (3, 3), (3,) mm of a frame onto the neutral, from their weighted sums."""
    u, _, vt = np.linalg.svd(crossed - np.outer(wanted, middle) / total)
    u[:, 2] *= np.sign(np.linalg.det(u @ vt))
    rotation = u @ vt
    return rotation, (wanted - rotation @ middle) / total


def _one(
    alpha: FloatArray, rotation: FloatArray, shift: FloatArray, iterations: int, moved: float
) -> PatchCoefficients:
    status = Status.CONVERGED if moved < LEAST_STEP else Status.MAX_ITERATIONS
    return PatchCoefficients(alpha[None], rotation[None], shift[None], (SolveInfo(status, iterations),))


def _joined(parts: list[PatchCoefficients], shape: tuple[int, ...]) -> PatchCoefficients:
    if not parts:
        return PatchCoefficients(np.empty((0, *shape)), np.empty((0, 3, 3)), np.empty((0, 3)))
    return PatchCoefficients(
        np.concatenate([part.alpha for part in parts]),
        np.concatenate([part.rotation for part in parts]),
        np.concatenate([part.shift for part in parts]),
        tuple(part.info[0] for part in parts),
    )


def _flat(deltas: FloatArray) -> FloatArray:
    return deltas.reshape(len(deltas), deltas.shape[1] * deltas.shape[2])
