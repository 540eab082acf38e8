"""The anatomical local model against its energy, written out and minimised by SciPy."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from retarget.check import InvalidInput
from retarget.rig.local_model.anatomical import AnatomicalLocalModel, ReconstructionSettings
from retarget.rig.local_model.layout import OverlappingPatches
from retarget.rig.local_model.patch_fit import PatchBlendshapes
from retarget.rig.local_model.skin_over_bone import LOOSE, SkinOverBone, cranial_bone, vertices_over_cranium
from retarget.types import FloatArray, Status
from tests.retarget.simulation.box_head import box_head
from tests.synthetic import ball, expressions, head

SUBDIVISIONS = 2
DIRECTIONS, FACES = ball(SUBDIVISIONS)
NEUTRAL = head(2, SUBDIVISIONS)
SHAPES = expressions(2, 3, SUBDIVISIONS)
LAYOUT = OverlappingPatches.of(FACES, len(NEUTRAL), 6, 1)
OVER = np.flatnonzero(DIRECTIONS[:, 1] > -0.2)
BONE = SkinOverBone.of(np.concatenate([NEUTRAL[None], SHAPES]), OVER, (0.9 * NEUTRAL, FACES))
SETTINGS = ReconstructionSettings()


@cache
def model(settings: ReconstructionSettings = SETTINGS) -> AnatomicalLocalModel:
    return AnatomicalLocalModel(NEUTRAL, SHAPES, LAYOUT, BONE, settings)


def residuals(state: FloatArray, wanted: FloatArray, settings: ReconstructionSettings) -> FloatArray:
    """Square roots of the terms of the energy; state (P, 6 + k): turn, shift and weights of shapes, of each patch."""
    state = state.reshape(len(LAYOUT.members), -1)
    x = np.empty_like(wanted)
    terms = []
    place = {v: i for i, v in enumerate(BONE.vertices)}
    for p, (members, at) in enumerate(zip(LAYOUT.members, LAYOUT.places, strict=True)):
        turn, shift, weights = Rotation.from_rotvec(state[p, :3]), state[p, 3:6], state[p, 6:]
        rest = NEUTRAL[members] - NEUTRAL[members].mean(axis=0)
        shape = rest.copy()
        for w, other in zip(weights, SHAPES[:, members], strict=True):
            centred = other - other.mean(axis=0)
            aligned, _ = Rotation.align_vectors(rest, centred)
            shape += w * (aligned.apply(centred) - rest)
        x[at] = turn.apply(shape) + shift
        over = [i for i, v in enumerate(members) if v in place]
        known = [place[members[i]] for i in over]
        bone, normal, thickness = (
            a[0, known] + np.tensordot(weights, a[1:, known] - a[0, known], 1)
            for a in (BONE.bone, BONE.normals, BONE.thickness)
        )
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        terms.append(np.sqrt(settings.lambda_anatomy) * (x[at][over] - bone - thickness[:, None] * normal))
    terms.append(np.sqrt(settings.lambda_data) * (x - wanted))
    for v in range(len(NEUTRAL)):
        here = np.flatnonzero(LAYOUT.vertices == v)
        terms += [
            np.sqrt(settings.lambda_stitch) * (x[a] - x[b])[None] for i, a in enumerate(here) for b in here[i + 1 :]
        ]
    return np.concatenate(terms).ravel()


def test_the_minimum_is_that_of_scipy() -> None:
    blendshapes = PatchBlendshapes(NEUTRAL, SHAPES, LAYOUT)
    rng = np.random.default_rng(0)
    alpha = rng.uniform(-0.1, 0.6, (len(LAYOUT.members), len(SHAPES)))
    wanted = blendshapes.at_places(alpha) + rng.normal(0, 0.3, (len(LAYOUT.vertices), 3))
    surface, info = model()(wanted, alpha)
    start = np.zeros((len(LAYOUT.members), 6 + len(SHAPES)))
    start[:, 3:6] = [wanted[at].mean(axis=0) for at in LAYOUT.places]
    start[:, 6:] = alpha
    least = least_squares(residuals, start.ravel(), args=(wanted, SETTINGS), x_scale="jac", max_nfev=200)
    assert info.status is Status.CONVERGED
    assert info.energy[-1] == pytest.approx(2 * least.cost, rel=2e-3)
    assert info.energy[-1] < info.energy[0]
    assert np.isfinite(surface).all()


def test_known_shapes_and_the_neutral_are_reproduced() -> None:
    blendshapes = PatchBlendshapes(NEUTRAL, SHAPES, LAYOUT)
    none = np.zeros((len(LAYOUT.members), len(SHAPES)))
    for alpha, known in [(none, NEUTRAL), *((none + unit, s) for unit, s in zip(np.eye(3), SHAPES, strict=True))]:
        surface, info = model()(blendshapes.at_places(alpha), alpha)
        np.testing.assert_allclose(surface, known, atol=1e-9 if known is NEUTRAL else 0.02)
        assert info.energy[-1] < 1.0


def test_stitching_brings_patches_together() -> None:
    blendshapes = PatchBlendshapes(NEUTRAL, SHAPES, LAYOUT)
    alpha = np.zeros((len(LAYOUT.members), len(SHAPES)))
    alpha[0] = 0.5
    wanted = blendshapes.at_places(alpha)
    far = []
    for weight in (1e-6, 0.85, 100.0):
        surface, _ = model(ReconstructionSettings(10.0, 0.0, weight))(wanted, alpha)
        far.append(np.abs(surface - LAYOUT.blend(wanted)).mean())
    assert far[0] < far[1] < far[2]


def test_skin_is_bone_plus_thickness_along_the_normal() -> None:
    shapes = np.concatenate([NEUTRAL[None], SHAPES])
    rebuilt = BONE.bone + BONE.thickness[..., None] * BONE.normals
    np.testing.assert_allclose(rebuilt, shapes[:, OVER], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(BONE.normals, axis=2), 1.0)


def test_thickness_over_a_concentric_ball_is_the_difference_of_radii() -> None:
    directions, faces = ball(4)
    found = SkinOverBone.of(100 * directions[None], np.arange(0, len(directions), 50), (90 * directions, faces))
    np.testing.assert_allclose(found.thickness, 10.0, atol=0.1)
    np.testing.assert_allclose(found.normals[0], directions[::50], atol=0.02)


def test_skin_on_the_bone_keeps_the_normal_of_the_neutral() -> None:
    directions, faces = ball()
    touching = SkinOverBone.of(np.array([100 * directions, 90 * directions]), np.arange(5), (90 * directions, faces))
    np.testing.assert_array_equal(touching.normals[1], touching.normals[0])
    np.testing.assert_allclose(touching.thickness[1], 0.0, atol=1e-6)


def test_only_visible_skin_over_the_cranium_is_constrained() -> None:
    fitted = box_head()
    over = vertices_over_cranium(fitted)
    corners, faces = cranial_bone(fitted)
    assert len(over) > 0
    assert faces.max() < len(corners)
    cranium = fitted.vertices[fitted.template.cranium]
    assert (fitted.skin[over, 1] > cranium[:, 1].min() - 1e-9).all()
    for name in LOOSE:
        assert not np.isin(over, fitted.template.regions.vertices.get(name, [])).any()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lambda_data": 0.0}, "lambda_data: expected a positive"),
        ({"lambda_stitch": -1.0}, "lambda_stitch: expected 0"),
    ],
)
def test_settings_out_of_range_are_refused(settings: dict[str, float], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        ReconstructionSettings(**settings)
