"""The coupled fit against its energy, written out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from retarget.check import InvalidInput
from retarget.rig.blendshapes import BlendshapeTransfer, Ridge
from retarget.rig.local_model.calibration import calibrated_strengths
from retarget.rig.local_model.layout import OverlappingPatches
from retarget.rig.local_model.patch_fit import PatchBlendshapes, PatchFit, PatchFitSettings
from retarget.types import FloatArray
from tests.synthetic import problem

PROBLEM = problem()
N = len(PROBLEM.source_neutral)
LAYOUT = OverlappingPatches.of(PROBLEM.faces, N, 20, 2)
SOURCE = PatchBlendshapes(PROBLEM.source_neutral, PROBLEM.source_examples, LAYOUT)
MEAN = PatchFitSettings(lambda_reg=1e-3, lambda_overlap=0.1)
SUM = PatchFitSettings(lambda_reg=35.0, lambda_overlap=100.0, residual="sum", length_mm=2.0)
FRAME = PROBLEM.source_animation[7]


def energy(alpha: FloatArray, frame: FloatArray, settings: PatchFitSettings, gamma: FloatArray) -> float:
    """Eq. (10) with squares, summed as printed. alpha is that of eq. (11), before it is multiplied by gamma."""
    unit = settings.length_mm**2
    total = settings.lambda_reg * unit * (alpha**2).sum()
    for p, members in enumerate(LAYOUT.members):
        shown = np.einsum(
            "k,kvc->vc", alpha[p] * gamma[p], (PROBLEM.source_examples - PROBLEM.source_neutral)[:, members]
        )
        squared = ((frame - PROBLEM.source_neutral)[members] - shown) ** 2
        total += squared.sum() / (len(members) if settings.residual == "mean" else 1)
        for q in {b if a == p else a for a, b in LAYOUT.neighbours if p in (a, b)}:
            total += settings.lambda_overlap * unit * ((alpha[p] - alpha[q]) ** 2).sum()
    return float(total)


def least(frame: FloatArray, settings: PatchFitSettings, gamma: FloatArray) -> FloatArray:
    """The minimum of `energy`, a quadratic whose matrix is read off its values."""
    size = len(LAYOUT.members) * SOURCE.count
    shape = (len(LAYOUT.members), SOURCE.count)
    start = energy(np.zeros(shape), frame, settings, gamma)
    units = np.eye(size).reshape(size, *shape)
    up = np.array([energy(u, frame, settings, gamma) for u in units])
    down = np.array([energy(-u, frame, settings, gamma) for u in units])
    gradient, diagonal = (up - down) / 2, (up + down) / 2 - start
    matrix = np.diag(2 * diagonal)
    for i in range(size):
        for j in range(i):
            if i // shape[1] == j // shape[1] or (i % shape[1] == j % shape[1]):
                both = energy(units[i] + units[j], frame, settings, gamma)
                matrix[i, j] = matrix[j, i] = both - up[i] - up[j] + start
    return np.linalg.solve(matrix, -gradient).reshape(shape)


@pytest.mark.parametrize("settings", [MEAN, SUM], ids=["mean", "sum"])
def test_coefficients_minimise_the_energy(settings: PatchFitSettings) -> None:
    gamma = np.ones((len(LAYOUT.members), SOURCE.count))
    gamma[:, 1], gamma[3, 2] = 0.5, 0.1
    fixed = PatchFitSettings(**{**vars(settings), "rigid": False})
    found = PatchFit(SOURCE, fixed, gamma)(FRAME[None]).alpha[0]
    np.testing.assert_allclose(found, gamma * least(FRAME, fixed, gamma), atol=1e-6)


def test_without_overlap_and_coupling_it_is_plbs() -> None:
    alone = OverlappingPatches.of(PROBLEM.faces, N, 20, 0)
    source, target = (
        PatchBlendshapes(neutral, examples, alone)
        for neutral, examples in (
            (PROBLEM.source_neutral, PROBLEM.source_examples),
            (PROBLEM.target_neutral, PROBLEM.target_examples),
        )
    )
    fit = PatchFit(source, PatchFitSettings(1e-3, 0.0, rigid=False))
    plbs = BlendshapeTransfer(
        PROBLEM.source_neutral, PROBLEM.source_examples, PROBLEM.target_neutral, PROBLEM.target_examples,
        alone.cores, Ridge(1e-3),
    )  # fmt: skip
    frames = PROBLEM.source_animation[5:]
    np.testing.assert_allclose(target.blend(fit(frames).alpha), plbs(frames).target, atol=1e-9)


def test_strong_coupling_gives_all_patches_the_same_coefficients() -> None:
    """Then they are those of global blendshapes with the same weights of vertices."""
    found = PatchFit(SOURCE, PatchFitSettings(1e-3, 1e6, rigid=False))(FRAME[None]).alpha[0]
    assert np.ptp(found, axis=0).max() < 1e-4 * np.abs(found).max()


@pytest.mark.parametrize("settings", [MEAN, SUM], ids=["mean", "sum"])
def test_a_rigid_motion_of_the_frame_is_found_and_changes_nothing(settings: PatchFitSettings) -> None:
    turn, shift = Rotation.from_rotvec([0.2, -0.1, 0.3]).as_matrix(), np.array([4.0, -7.0, 2.0])
    fit = PatchFit(SOURCE, settings)
    still, moved = fit(np.array([FRAME, FRAME @ turn.T + shift])).alpha
    np.testing.assert_allclose(moved, still, atol=1e-7)


def test_the_rigid_motion_is_at_a_minimum() -> None:
    """Any small turn or shift, with the best coefficients for it, raises the energy."""
    found = PatchFit(SOURCE, MEAN)(FRAME[None])
    fixed = PatchFitSettings(**{**vars(MEAN), "rigid": False})
    alone, ones = PatchFit(SOURCE, fixed), np.ones((len(LAYOUT.members), SOURCE.count))
    placed = FRAME @ found.rotation[0].T + found.shift[0]

    def reduced(turn: FloatArray, shift: FloatArray) -> float:
        frame = placed @ Rotation.from_rotvec(turn).as_matrix().T + shift
        return energy(alone(frame[None]).alpha[0], frame, fixed, ones)

    best = reduced(np.zeros(3), np.zeros(3))
    for axis in np.eye(3):
        for sign in (-1e-4, 1e-4):
            assert reduced(sign * axis, np.zeros(3)) > best
            assert reduced(np.zeros(3), 100 * sign * axis) > best


def test_examples_that_equal_the_neutral_or_each_other_leave_one_solution() -> None:
    examples = PROBLEM.source_examples
    doubled = np.concatenate([examples, examples[:1], PROBLEM.source_neutral[None]])
    once, twice = (
        PatchBlendshapes(PROBLEM.source_neutral, shapes, LAYOUT).blend(
            PatchFit(PatchBlendshapes(PROBLEM.source_neutral, shapes, LAYOUT), PatchFitSettings(1e-8, 1e-8))(
                FRAME[None]
            ).alpha
        )
        for shapes in (examples, doubled)
    )
    np.testing.assert_allclose(twice, once, atol=0.02)


def test_calibration_finds_the_strength_that_the_target_lacks() -> None:
    """A target whose examples are half of what they were needs twice the coefficients."""
    half = PatchBlendshapes(PROBLEM.source_neutral, 0.5 * (PROBLEM.source_examples + PROBLEM.source_neutral), LAYOUT)
    alpha = PatchFit(SOURCE, MEAN)(PROBLEM.source_examples).alpha
    shown = np.array([LAYOUT.blend(SOURCE.at_places(a)) for a in alpha])
    strengths = calibrated_strengths(half, alpha, shown)
    moving = [p for p, d in enumerate(SOURCE.deltas) if np.abs(d).max() > 1]
    np.testing.assert_allclose(strengths[moving], 2.0, atol=0.2)
    np.testing.assert_array_equal(calibrated_strengths(half, alpha[:0], shown[:0]), 1.0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lambda_reg": 0.0, "lambda_overlap": 1.0}, "lambda_reg: expected a positive"),
        ({"lambda_reg": 1.0, "lambda_overlap": -1.0}, "lambda_overlap: expected 0 or"),
        ({"lambda_reg": 1.0, "lambda_overlap": 1.0, "length_mm": np.nan}, "length_mm"),
        ({"lambda_reg": 1.0, "lambda_overlap": 1.0, "residual": "median"}, "residual"),
    ],
)
def test_settings_out_of_range_are_refused(settings: dict[str, float], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        PatchFitSettings(**settings)
