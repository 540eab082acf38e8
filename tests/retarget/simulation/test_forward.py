from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from retarget.anatomy.head import Head, HeadTemplate
from retarget.check import InvalidInput
from retarget.geometry.cholesky import NotPositiveDefinite
from retarget.geometry.triangles import areas
from retarget.simulation.area_terms import area_terms
from retarget.simulation.bones import fit_bones, pivot, size_ratio
from retarget.simulation.characteristics import EYE_OPENINGS, EYE_SOCKETS, Characteristics, FacialCharacteristics
from retarget.simulation.forward import ForwardSettings, ForwardSimulation
from retarget.simulation.gradient_energy import GradientEnergy
from retarget.simulation.materials import region_stiffness, weight_change
from retarget.simulation.projections import closest_area
from retarget.simulation.soft_terms import Handles
from retarget.simulation.state import Bones, RigidMotion
from retarget.simulation.tetrahedra import deformation_gradients, gradient_operator, rest_shape
from retarget.types import Pair, Regions, Status
from tests.retarget.simulation.box import box
from tests.retarget.simulation.box_head import box_head
from tests.retarget.simulation.test_bones import turn
from tests.retarget.simulation.threads import with_one_and_two_threads

CALM = ForwardSettings(collisions=False, area_tolerance=1e-11, area_iterations=3000)


@pytest.fixture(scope="module")
def head():
    return box_head()


@pytest.fixture(scope="module")
def forward(head):
    return ForwardSimulation(head, CALM)


def still(head):
    rest = RigidMotion(np.eye(3), np.zeros(3), pivot(head))
    return Bones(rest, rest)


def moved(head, amplitude=1.0):
    """A smooth deformation of the tissue with an open jaw; bone vertices move with their bone."""
    bones = Bones(
        still(head).cranium, RigidMotion(turn("x", 6.0 * amplitude), amplitude * np.array([0, -1, 1.0]), pivot(head))
    )
    x, y, _ = head.vertices.T / 20.0
    depth = head.vertices[:, 2:] / 20.0
    vertices = head.vertices + amplitude * depth * np.c_[np.sin(2 * y), np.cos(x + y), 2 * np.sin(x) * np.cos(y)]
    below = 1 / (1 + np.exp((head.vertices[:, 1:2] - 28) / 2))
    vertices += below * (bones.jaw(head.vertices) - head.vertices)
    vertices[head.template.cranium] = bones.cranium(head.vertices[head.template.cranium])
    vertices[head.template.jaw] = bones.jaw(head.vertices[head.template.jaw])
    return vertices, bones


def wanted(head, seed=0):
    """Characteristics that no deformation at hand fulfils."""
    rng = np.random.default_rng(seed)
    regions = head.template.regions
    contour = head.skin[regions.loops["lip_contour"]]
    eyes, sockets = (sum(len(regions.patches[n]) for n in names) for names in (EYE_OPENINGS, EYE_SOCKETS))
    bump = np.c_[np.zeros((len(contour), 2)), rng.uniform(0, 2, len(contour))]
    return Characteristics(rng.uniform(0.3, 1.3, eyes), rng.uniform(0.8, 1.2, sockets), contour + bump)


def test_the_gradients_of_a_deformation_give_the_deformation(head, forward):
    vertices, bones = moved(head)
    gradients = deformation_gradients(forward.shape, vertices)
    state = forward(gradients, bones)
    np.testing.assert_allclose(state.vertices, vertices, atol=1e-9)
    np.testing.assert_allclose(state.skin, head.template.embedding @ vertices + head.residual, atol=1e-9)
    np.testing.assert_allclose(state.gradients, gradients, atol=1e-9)
    assert state.info.status is Status.CONVERGED
    assert state.info.energy[-1] < 1e-18


def test_a_larger_copy_gets_the_larger_picture(head, forward):
    vertices, bones = moved(head)
    large = box_head(shape=1.7 * np.eye(3))
    gradients = deformation_gradients(forward.shape, vertices)
    state = ForwardSimulation(large, CALM)(gradients, bones, size_ratio(head.skin, large.skin))
    np.testing.assert_allclose(state.vertices, 1.7 * vertices, atol=1e-9)


def test_the_neutral_with_its_relative_characteristics_is_the_neutral(head):
    """adt(S, S, T) = T, with another head as the source."""
    source = box_head(shape=np.diag([1.1, 0.95, 1.0]) + 0.05)
    characteristics = FacialCharacteristics(Pair(head.template.faces, source.skin, head.skin, head.template.regions))
    gradients = np.broadcast_to(np.eye(3), (len(head.template.tets), 3, 3))
    state = ForwardSimulation(head)(gradients, fit_bones(source, source.skin), 1.1, characteristics(source.skin))
    np.testing.assert_allclose(state.skin, head.skin, atol=1e-9)
    assert state.lips.contacts == 0


def full_step(forward, x, gradients, characteristics, handles=None):
    """One projective step by a full sparse solution with all terms in the matrix, from projections at x."""
    head, rules, shape = forward.head, forward.settings, forward.shape
    regions, embedding = head.template.regions, head.template.embedding
    operator = gradient_operator(shape)
    weights = sp.diags_array(np.repeat(forward._tissue.weights, 3))
    matrix = operator.T @ weights @ operator
    load = operator.T @ (weights @ np.swapaxes(gradients, 1, 2).reshape(-1, 3))
    contour, unit = regions.loops["lip_contour"], shape.volumes.sum() / 234_049
    terms = [
        (embedding[contour], unit * rules.w_lip_contour / 100, characteristics.lip_contour - head.residual[contour])
    ]
    skin = embedding @ x + head.residual
    for names, ratios, weight in (
        (EYE_OPENINGS, characteristics.eye_opening, rules.w_eye_opening),
        (EYE_SOCKETS, characteristics.eye_socket, rules.w_eye_socket),
    ):
        eyes = area_terms(head.skin, np.concatenate([regions.patches[n] for n in names]))
        f = np.swapaxes((eyes.operator @ skin).reshape(-1, 2, 3), 1, 2)
        closest = np.swapaxes(closest_area(f, ratios), 1, 2).reshape(-1, 3)
        rows = eyes.operator @ embedding
        terms.append((rows, unit * weight * np.repeat(eyes.weights, 2), closest - eyes.operator @ head.residual))
    if handles is not None:
        terms.append(handles)
    for rows, weight, goal in terms:
        weight = np.broadcast_to(weight, rows.shape[:1])
        matrix = matrix + rows.T @ sp.diags_array(weight) @ rows
        load = load + rows.T @ (weight[:, None] * goal)
    matrix, free, fixed = sp.csr_array(matrix), forward._free, forward._fixed
    solved = x.copy()
    solved[free] = spsolve(sp.csc_array(matrix[free][:, free]), load[free] - matrix[free][:, fixed] @ x[fixed])
    return solved


def test_condensed_against_refactorised(head, forward):
    """At the minimum a step of the full system, matrix assembled anew with all soft terms, changes nothing."""
    vertices, bones = moved(head)
    gradients = deformation_gradients(forward.shape, vertices)
    characteristics = wanted(head)
    state = forward(gradients, bones, characteristics=characteristics)
    assert state.info.status is Status.CONVERGED
    assert np.abs(state.vertices - vertices).max() > 0.5
    np.testing.assert_allclose(
        full_step(forward, state.vertices, gradients, characteristics), state.vertices, atol=1e-8
    )


def test_handles_against_refactorised(head, forward):
    vertices, bones = moved(head)
    gradients = deformation_gradients(forward.shape, vertices)
    characteristics = wanted(head)
    handles = Handles(skin=np.array([3, 100]), vertices=np.array([700]), weights=np.array([5.0, 50.0, 20.0]))
    held = forward.with_handles(handles)
    goal = np.vstack([head.skin[handles.skin], head.vertices[handles.vertices]]) + np.array([0, 1, 2])
    pick = sp.eye_array(len(head.vertices), format="csr")[handles.vertices]
    rows = sp.csr_array(sp.vstack([head.template.embedding[handles.skin], pick]))
    offset = np.vstack([head.residual[handles.skin], np.zeros((1, 3))])
    state = held(gradients, bones, characteristics=characteristics, handles=goal)
    springs = rows, forward.shape.volumes.sum() / 234_049 * handles.weights / 100, goal - offset
    stepped = full_step(forward, state.vertices, gradients, characteristics, springs)
    np.testing.assert_allclose(stepped, state.vertices, atol=1e-8)
    loose, before = (f(gradients, bones, characteristics=characteristics).vertices for f in (held, forward))
    np.testing.assert_allclose(loose, before, atol=1e-9)


def test_contacts_against_refactorised(head):
    """The result with contacts is the minimum of the tissue's energy under opposite forces at the lips."""
    forward = ForwardSimulation(head)
    lifted = Bones(still(head).cranium, RigidMotion(np.eye(3), np.array([0, 4.0, 0]), pivot(head)))
    gradients = np.broadcast_to(np.eye(3), (len(head.template.tets), 3, 3))
    state = forward(gradients, lifted)
    assert state.lips.contacts > 10
    operator = gradient_operator(forward.shape)
    weights = sp.diags_array(np.repeat(forward._tissue.weights, 3))
    matrix = sp.csr_array(operator.T @ weights @ operator)
    load = operator.T @ (weights @ np.tile(np.eye(3), (len(gradients), 1)))
    left = (matrix @ state.vertices - load)[forward._free]  # what holds the tissue where it is
    lips = forward._lips.vertices
    embedding = head.template.embedding[lips][:, forward._free]
    forces, *_ = np.linalg.lstsq(embedding.toarray().T, left)
    np.testing.assert_allclose(embedding.T @ forces, left, atol=1e-8)
    skin = np.cross(state.skin[lips], forces)
    np.testing.assert_allclose(forces.sum(axis=0), 0.0, atol=1e-6)
    assert np.abs(skin.sum(axis=0)).max() < 0.02 * np.abs(skin).sum()
    pushed = np.linalg.norm(forces, axis=1) > 1e-6 * np.abs(forces).max()
    assert forces[pushed & np.isin(lips, head.template.regions.vertices["upper_lip"]), 1].sum() > 0
    inner = forward._free
    x = state.vertices.copy()
    right = load[inner] + embedding.T @ forces - matrix[inner][:, forward._fixed] @ x[forward._fixed]
    x[inner] = spsolve(sp.csc_array(matrix[inner][:, inner]), right)
    np.testing.assert_allclose(state.vertices, x, atol=1e-8)


def total_energy(forward, x, gradients, characteristics):
    head, rules, regions = forward.head, forward.settings, forward.head.template.regions
    skin = head.template.embedding @ x + head.residual
    f = deformation_gradients(forward.shape, x)
    energy = forward._tissue.weights @ ((f - gradients) ** 2).sum(axis=(1, 2))
    miss = skin[regions.loops["lip_contour"]] - characteristics.lip_contour
    unit = forward.shape.volumes.sum() / 234_049
    energy += unit * rules.w_lip_contour / 100 * (miss**2).sum()
    for names, ratios, weight in (
        (EYE_OPENINGS, characteristics.eye_opening, rules.w_eye_opening),
        (EYE_SOCKETS, characteristics.eye_socket, rules.w_eye_socket),
    ):
        eyes = area_terms(head.skin, np.concatenate([regions.patches[n] for n in names]))
        g = np.swapaxes((eyes.operator @ skin).reshape(-1, 2, 3), 1, 2)
        energy += unit * weight * (eyes.weights @ ((g - closest_area(g, ratios)) ** 2).sum(axis=(1, 2)))
    return energy


def test_the_energy_is_the_one_documented_never_rises_and_is_stationary(head):
    forward = ForwardSimulation(head, CALM)
    vertices, bones = moved(head)
    gradients = deformation_gradients(forward.shape, vertices)
    characteristics = wanted(head)
    state = forward(gradients, bones, characteristics=characteristics)
    energy = np.array(state.info.energy)
    assert len(energy) > 5
    assert (np.diff(energy) <= 1e-12 * energy[0]).all()
    assert energy[-1] == pytest.approx(total_energy(forward, state.vertices, gradients, characteristics), rel=1e-9)
    direction = np.zeros_like(state.vertices)
    direction[forward._free] = np.random.default_rng(0).normal(size=(len(forward._free), 3))
    nearby = [total_energy(forward, state.vertices + h * direction, gradients, characteristics) for h in (-1e-4, 1e-4)]
    assert abs(nearby[1] - nearby[0]) < 1e-4 * (sum(nearby) - 2 * energy[-1])


def test_the_energy_of_parted_lips_is_the_same_one(head):
    """What contacts do against the tissue and the other terms counts; they themselves have none."""
    forward, characteristics = ForwardSimulation(head), wanted(head)
    lifted = Bones(still(head).cranium, RigidMotion(np.eye(3), np.array([0, 4.0, 0]), pivot(head)))
    gradients = np.broadcast_to(np.eye(3), (len(head.template.tets), 3, 3))
    state = forward(gradients, lifted, characteristics=characteristics)
    assert state.lips.contacts > 3
    energy = total_energy(forward, state.vertices, gradients, characteristics)
    assert state.info.energy[-1] == pytest.approx(energy, rel=1e-9)
    free = forward(gradients, lifted, characteristics=characteristics, collisions=False)
    assert free.info.energy[-1] < energy


def test_areas_and_contour_follow_their_targets(head):
    regions = head.template.regions
    gradients = np.broadcast_to(np.eye(3), (len(head.template.tets), 3, 3))
    characteristics = wanted(head)
    triangles = np.concatenate([regions.patches[n] for n in EYE_OPENINGS])
    missed = []
    for weight in (1e3, 1e5, 1e8):
        settings = ForwardSettings(w_eye_opening=weight, w_lip_contour=weight, w_eye_socket=0.0)
        state = ForwardSimulation(head, settings)(gradients, still(head), characteristics=characteristics)
        ratio = areas(state.skin, triangles) / areas(head.skin, triangles)
        contour = state.skin[regions.loops["lip_contour"]] - characteristics.lip_contour
        missed.append([np.abs(ratio - characteristics.eye_opening).max(), np.abs(contour).max()])
    assert (np.diff(missed, axis=0) < 0).all()
    assert (np.array(missed[-1]) < [1e-3, 0.02]).all()


def test_gravity_stretches_a_hanging_bar_as_computed_by_hand():
    """||F - I||^2 leaves the columns alone: 2 u'' = -g, u(0) = 0, u'(h) = 0, so u(h) = g h^2 / 4."""
    vertices, tets = box((2, 2, 40), (10.0, 10.0, 40.0))
    top = np.flatnonzero(vertices[:, 2] == 0)
    skin = np.flatnonzero(vertices[:, 2] == 40)
    embedding = sp.eye_array(len(vertices), format="csr")[skin]
    faces = np.array([[0, 1, 2]])
    template = HeadTemplate(
        vertices[skin], faces, Regions(), vertices, tets, np.zeros(len(tets), bool), embedding, faces, top, top[:0], {}
    )
    bar = Head(template, vertices[skin], vertices, np.zeros((2, 3)), {})
    gradients = np.broadcast_to(np.eye(3), (len(tets), 3, 3))
    pull = np.array([0, 0, 0.002])
    state = ForwardSimulation(bar, CALM)(gradients, still(bar), gravity=pull)
    drop = (state.skin - bar.skin)[:, 2]
    assert drop.mean() == pytest.approx(0.002 * 40**2 / 4, rel=1e-2)
    np.testing.assert_allclose((state.skin - bar.skin)[:, :2], 0, atol=1e-9)


def test_gravity_upside_down():
    np.testing.assert_allclose(weight_change((0, 9.81, 0)), [0, 2 * 9.81 * 1000 / 5000 / 1000, 0])
    np.testing.assert_allclose(weight_change((0, -9.81, 0)), 0)


def test_stiffer_regions_follow_less(head):
    stiffness = region_stiffness(head, {"upper_lip": 50.0})
    assert np.median(stiffness) == 1
    assert stiffness.max() == 50
    gradients = np.broadcast_to(np.eye(3), (len(head.template.tets), 3, 3))
    characteristics = Characteristics(lip_contour=wanted(head).lip_contour)
    soft, hard = (
        ForwardSimulation(head, CALM, s)(gradients, still(head), characteristics=characteristics).skin
        for s in (1.0, stiffness)
    )
    upper = np.intersect1d(head.template.regions.loops["lip_contour"], head.template.regions.vertices["upper_lip"])
    moved_by = [np.linalg.norm((s - head.skin)[upper], axis=1).mean() for s in (soft, hard)]
    assert moved_by[1] < 0.8 * moved_by[0]


def test_same_result_for_any_number_of_threads(head, forward):
    vertices, bones = moved(head)
    gradients = deformation_gradients(forward.shape, vertices)
    one, two = with_one_and_two_threads(lambda: forward(gradients, bones, characteristics=wanted(head)))
    np.testing.assert_array_equal(one.vertices, two.vertices)


def test_bad_input_is_refused(head, forward):
    vertices, bones = moved(head)
    gradients = deformation_gradients(forward.shape, vertices)
    with pytest.raises(InvalidInput, match="gradients: expected"):
        forward(gradients[1:], bones)
    with pytest.raises(InvalidInput, match="finite gradients and bones"):
        forward(np.where(np.arange(len(gradients))[:, None, None] == 5, np.nan, gradients), bones)
    with pytest.raises(InvalidInput, match=r"characteristics\.lip_contour: expected"):
        forward(gradients, bones, characteristics=Characteristics(lip_contour=np.zeros((3, 3))))
    contour = np.where(np.arange(len(wanted(head).lip_contour))[:, None] == 2, np.nan, wanted(head).lip_contour)
    with pytest.raises(InvalidInput, match=r"characteristics\.lip_contour: expected finite numbers, but 1 of"):
        forward(gradients, bones, characteristics=Characteristics(lip_contour=contour))
    with pytest.raises(InvalidInput, match=r"characteristics\.eye_opening: expected 8 finite area ratios"):
        forward(gradients, bones, characteristics=Characteristics(eye_opening=np.full(8, np.nan)))
    with pytest.raises(InvalidInput, match=r"handles: expected \(0, 3\), one for each handle"):
        forward(gradients, bones, handles=np.zeros((1, 3)))
    with pytest.raises(InvalidInput, match=r"handles: expected points within 150 mm .* but 0 is 1000\.0 mm"):
        forward.with_handles(Handles(skin=np.array([7])))(gradients, bones, handles=head.skin[[7]] + [0, 0, 1000.0])
    for gravity in (9.81, (0, np.nan, 0), (0, 1.0)):
        with pytest.raises(InvalidInput, match="gravity: expected a vector"):
            forward(gradients, bones, gravity=gravity)
    for scale in (0.0, -1.0, np.nan, np.inf, np.ones(3)):
        with pytest.raises(InvalidInput, match="scale: expected one finite number > 0"):
            forward(gradients, bones, scale)
    with pytest.raises(InvalidInput, match=r"handles\.vertices: expected indices"):
        forward.with_handles(Handles(vertices=np.array([10**6])))
    with pytest.raises(InvalidInput, match=r"handles\.weights"):
        forward.with_handles(Handles(skin=np.array([0]), weights=-1.0))
    with pytest.raises(InvalidInput, match="'lip' is no region"):
        region_stiffness(head, {"lip": 2.0})
    with pytest.raises(InvalidInput, match="stiffness: expected finite"):
        ForwardSimulation(head, CALM, 0.0)
    with pytest.raises(InvalidInput, match="w_soft"):
        ForwardSettings(w_soft=0.0)
    nothing = replace(head.template, cranium=head.template.cranium[:0], jaw=head.template.jaw[:0])
    with pytest.raises(NotPositiveDefinite, match="forward simulation"):
        ForwardSimulation(replace(head, template=nothing), CALM)


def test_what_overflows_fails_without_nan(head, forward):
    state = forward(np.full((len(head.template.tets), 3, 3), 1e200), still(head))
    assert state.info.status is Status.FAILED
    np.testing.assert_array_equal(state.skin, head.skin)
    np.testing.assert_array_equal(state.gradients, np.broadcast_to(np.eye(3), state.gradients.shape))


def test_a_state_that_failed_is_one_of_rest(head, forward):
    _, bones = moved(head)
    state = forward(np.full((len(head.template.tets), 3, 3), 1e200), bones)
    assert state.info.status is Status.FAILED
    np.testing.assert_allclose(forward(state.gradients, state.bones).vertices, head.vertices, atol=1e-9)


def test_the_kernels_are_the_gradient_matrix(head):
    """At every vertex, also those that bones hold."""
    rng = np.random.default_rng(8)
    shape = rest_shape(head.vertices, head.template.tets)
    weights, wanted = rng.uniform(0.5, 2.0, len(shape.tets)), rng.normal(size=(len(shape.tets), 3, 3))
    energy, gradient = GradientEnergy(shape, weights), gradient_operator(shape).toarray()
    rows = wanted.transpose(0, 2, 1).reshape(-1, 3)  # of the transposed gradients
    weighted = np.repeat(weights, 3)[:, None]
    np.testing.assert_allclose(energy.divergence(wanted), gradient.T @ (weighted * rows), atol=1e-10)
    x = head.vertices + rng.normal(size=head.vertices.shape)
    value, found = energy(x, wanted)
    np.testing.assert_allclose(found.transpose(0, 2, 1).reshape(-1, 3), gradient @ x, atol=1e-10)
    assert value == pytest.approx((weighted * (gradient @ x - rows) ** 2).sum())


def test_too_few_iterations_are_reported(head):
    vertices, bones = moved(head)
    forward = ForwardSimulation(head, replace(CALM, area_iterations=2))
    state = forward(deformation_gradients(forward.shape, vertices), bones, characteristics=wanted(head))
    assert state.info.status is Status.MAX_ITERATIONS
