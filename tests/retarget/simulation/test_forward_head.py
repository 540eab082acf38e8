"""The forward simulation on MakeHuman's head."""

import numpy as np
import pytest
import pyvista as pv

from retarget.anatomy.closed import cap
from retarget.anatomy.head import Head
from retarget.anatomy.store import load_template
from retarget.simulation.bones import carry_bones, fit_bones, pivot, rotation_angle
from retarget.simulation.characteristics import Characteristics, FacialCharacteristics
from retarget.simulation.collisions import Lips
from retarget.simulation.forward import ForwardSettings, ForwardSimulation
from retarget.simulation.inverse import InverseSimulation
from retarget.simulation.projective_dynamics import ProjectiveDynamics, SolverSettings, tissue_weights
from retarget.simulation.soft_terms import Handles
from retarget.simulation.state import Bones, RigidMotion
from retarget.simulation.tetrahedra import deformation_gradients
from retarget.types import Pair, Status
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.targets import load_head
from tests.retarget.simulation.test_bones import turn
from tests.retarget.simulation.test_collisions import depth, winding

UNITS = {
    "smile": {"mouthSmileLeft": 1, "mouthSmileRight": 1},
    "press": {"mouthPressLeft": 1, "mouthPressRight": 1},
    "shrug": {"mouthShrugLower": 1},
    "funnel": {"mouthFunnel": 1},
    "bite": {"jawOpen": -0.2},
    "roll": {"mouthRollLower": 1, "mouthRollUpper": 1},
    "purse": {"mouthPressLeft": 1, "mouthPressRight": 1, "mouthShrugLower": 1},
    "kiss": {"mouthSmileLeft": 1, "mouthSmileRight": 1, "mouthPucker": 1},
    "drop": {"jawOpen": 1},
    "blink": {"eyeBlinkLeft": 0.68, "eyeBlinkRight": 0.68},
}
FAR = {  # lips that pass far into each other, the inner sides too
    "close": {"mouthClose": 1},
    "clench": {"jawOpen": -0.6},
    "suck": {"mouthFunnel": 1, "mouthClose": 0.4},
    "chew": {"mouthLeft": 1, "mouthShrugLower": 1},
    "pucker": {"mouthPucker": 1},
    "shrug": UNITS["shrug"],
}
CROSSED = {"smile", "press", "shrug", "funnel", "bite", "roll", "purse", "kiss"}


@pytest.fixture(scope="module")
def faces_and_units():
    return load_head()


@pytest.fixture(scope="module")
def head(faces_and_units):
    regions = load_regions()
    template = load_template(faces_and_units[0].faces, regions, "coarse")
    condyles = np.stack([regions.points[f"condyle_{side}"](template.skin) for side in ("left", "right")])
    return Head(template, template.skin, template.vertices, condyles, {})


@pytest.fixture(scope="module")
def forward(head):
    return ForwardSimulation(head)


@pytest.fixture(scope="module")
def inverse(head):
    return InverseSimulation(head)


@pytest.fixture(scope="module")
def formed(head, forward, faces_and_units):
    """Expression, bones, tet vertices and gradients by name, from a short inverse simulation."""
    settings = SolverSettings(max_iterations=8, repair_inverted_start=True)
    weights, template = tissue_weights(forward.shape, head.template.muscle), head.template
    solver = ProjectiveDynamics(forward.shape, weights, template.fixed, template.embedding, 100.0, settings)

    def form(name):
        skin = head.skin + sum(w * faces_and_units[1][f"units/{unit}"] for unit, w in UNITS[name].items())
        bones = fit_bones(head, skin)
        start = head.vertices.copy()
        for part, motion in ((template.cranium, bones.cranium), (template.jaw, bones.jaw)):
            start[part] = motion(start[part])
        vertices = solver.solve(skin - head.residual, start[template.fixed]).vertices
        return skin, bones, vertices, deformation_gradients(forward.shape, vertices)

    return {name: form(name) for name in UNITS}


@pytest.mark.parametrize("name", UNITS)
def test_expressions_come_back_and_lips_are_apart(head, forward, formed, name):
    skin, bones, vertices, gradients = formed[name]
    plain = ForwardSimulation(head, ForwardSettings(collisions=False))(gradients, bones)
    np.testing.assert_allclose(plain.vertices, vertices, atol=1e-8)
    pair = Pair(head.template.faces, head.skin, head.skin, head.template.regions)
    state = forward(gradients, bones, characteristics=FacialCharacteristics(pair)(skin))
    assert state.info.status is Status.CONVERGED
    assert (np.diff(state.info.energy) <= 1e-9 * state.info.energy[0]).all()
    assert (state.lips.before > 0.3) == (name in CROSSED)
    assert (depth(head, plain.skin) > 0.3) == (name in CROSSED)
    assert depth(head, state.skin) < 0.1
    visible = head.template.regions.vertices["head"]
    error = np.linalg.norm(state.skin - skin, axis=1)[visible]
    assert error.mean() < 0.1


def deepest_inside(head, skin):
    """mm: how far any vertex of a lip, or centre of its triangles, that is inside of the skin is from the other lip, by
    solid angles and vtk; but for what is nearest to the seam between the lips."""
    lips, faces = Lips(head.skin, head.template.faces, head.template.regions), head.template.faces
    closed_skin, closed_faces = cap("skin", skin, faces)
    normals = np.zeros_like(skin)
    for i in range(3):
        corner, after, before = (skin[faces[:, (i + j) % 3]] for j in range(3))
        u, v = (e / np.linalg.norm(e, axis=1, keepdims=True) for e in (after - corner, before - corner))
        cross = np.cross(u, v)
        sine, cosine = np.linalg.norm(cross, axis=1), np.einsum("fi,fi->f", u, v)
        np.add.at(normals, faces[:, i], (np.arctan2(sine, cosine) / sine)[:, None] * cross)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shared = np.intersect1d(*(head.template.regions.vertices[f"{lip}_lip"] for lip in ("upper", "lower")))
    deepest = 0.0
    for own, other in ((lips.upper_faces, lips.lower_faces), (lips.lower_faces, lips.upper_faces)):
        points, triangles = np.setdiff1d(own, shared), own[~np.isin(own, shared).any(axis=1)]
        flat = np.cross(*(skin[triangles[:, i]] - skin[triangles[:, 0]] for i in (1, 2)))
        flat /= np.linalg.norm(flat, axis=1, keepdims=True)
        starts = np.vstack([skin[points] + 0.02 * normals[points], skin[triangles].mean(axis=1) + 0.02 * flat])
        samples = np.vstack([skin[points], starts[len(points) :]])
        numbers = np.concatenate([winding(closed_skin, closed_faces, part) for part in np.array_split(starts, 16)])
        within = samples[numbers > 0.5]
        if len(within):
            mesh = pv.PolyData.from_regular_faces(skin, other)
            cells, nearest = mesh.find_closest_cell(within, return_closest_point=True)
            on_seam = np.linalg.norm(skin[other[cells]] - nearest[:, None], axis=2).min(axis=1) < 1e-9
            on_seam &= np.isin(other[cells], lips._seam).any(axis=1)
            on_seam |= np.isin(other[cells], lips._seam).all(axis=1)
            deepest = max(deepest, np.linalg.norm(nearest - within, axis=1)[~on_seam].max(initial=0.0))
    return deepest


@pytest.mark.parametrize("name", FAR)
def test_what_is_left_is_measured_on_all_sides(head, forward, inverse, faces_and_units, name):
    skin = head.skin + sum(w * faces_and_units[1][f"units/{unit}"] for unit, w in FAR[name].items())
    formed = inverse(skin)
    crossed = ForwardSimulation(head, ForwardSettings(collisions=False))(formed.gradients, formed.bones)
    parted = forward(formed.gradients, formed.bones)
    before, after = (deepest_inside(head, state.skin) for state in (crossed, parted))
    assert parted.lips.before == pytest.approx(min(before, 10.0), abs=1e-4)
    assert parted.lips.after == pytest.approx(min(after, 10.0), abs=1e-4)
    assert before > 0.5
    assert (after < 0.1) == (name != "close")  # a mouth shut over a closed jaw: no lips' place
    if after > 0.1:  # forces that cannot part lips would pull skin apart beside them
        np.testing.assert_array_equal(parted.skin, crossed.skin)
    assert (parted.info.status is Status.CONVERGED) == (after < 0.1 and parted.lips.way == 1.0)


def test_the_neutral_of_another_head(head, forward):
    """adt(S, S, T) = T to less than 0.001 mm."""
    shape = np.array([1.06, 0.94, 1.02])
    pair = Pair(head.template.faces, shape * head.skin, head.skin, head.template.regions)
    identity = np.broadcast_to(np.eye(3), (len(head.template.tets), 3, 3))
    still = RigidMotion(np.eye(3), np.zeros(3), pivot(head))
    characteristics = FacialCharacteristics(pair)(pair.source_neutral)
    state = forward(identity, Bones(still, still), 1.02, characteristics)
    assert np.abs(state.skin - head.skin).max() < 1e-3
    assert state.lips.contacts == 0


def test_an_open_jaw_takes_the_chin_along(head, forward):
    bones = carry_bones(head, Bones(*(RigidMotion(turn("x", d), np.zeros(3), pivot(head)) for d in (0.0, 15.0))))
    identity = np.broadcast_to(np.eye(3), (len(head.template.tets), 3, 3))
    state = forward(identity, bones)
    found = fit_bones(head, state.skin)
    assert rotation_angle(found.cranium.rotation) < 0.5
    assert 8 < rotation_angle(found.jaw.rotation) < 16
    regions = head.template.regions
    gap = [
        s[regions.landmarks["stomion_upper"], 1] - s[regions.landmarks["stomion_lower"], 1]
        for s in (head.skin, state.skin)
    ]
    assert gap[1] > gap[0] + 8


def test_a_detail_is_skin_on_top_of_tissue(head, inverse):
    """Where nothing pulls it is added; the lip contour and handles end where they should with it on."""
    skin = head.skin + 0
    state = inverse(skin)
    plain = ForwardSimulation(head, ForwardSettings(collisions=False))
    rng = np.random.default_rng(0)
    detail = 0.2 * rng.normal(size=skin.shape)
    found = plain.with_detail(detail)(state.gradients, state.bones)
    np.testing.assert_allclose(found.skin - plain(state.gradients, state.bones).skin, detail, atol=1e-9)
    contour = head.template.regions.loops["lip_contour"]
    wanted = Characteristics(lip_contour=skin[contour] + [0, 0.5, 0])
    held = plain.with_detail(detail)(state.gradients, state.bones, characteristics=wanted)
    assert np.linalg.norm(held.skin[contour] - wanted.lip_contour, axis=1).mean() < 0.1
    np.testing.assert_array_equal(
        plain.with_detail(detail).with_detail(0.0)(state.gradients, state.bones).skin,
        plain(state.gradients, state.bones).skin,
    )
    handles = Handles(skin=contour[:3], weights=1e5)
    for order in (plain.with_handles(handles).with_detail(detail), plain.with_detail(detail).with_handles(handles)):
        pulled = order(state.gradients, state.bones, handles=skin[contour[:3]] + [0, 0, 1.0])
        np.testing.assert_allclose(pulled.skin[contour[:3]], skin[contour[:3]] + [0, 0, 1.0], atol=0.02)
