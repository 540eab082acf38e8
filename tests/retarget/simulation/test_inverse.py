from dataclasses import replace

import numpy as np
import pytest

from retarget.anatomy.head import Head
from retarget.check import InvalidInput
from retarget.simulation.forward import ForwardSettings, ForwardSimulation
from retarget.simulation.inverse import InverseSettings, InverseSimulation
from retarget.simulation.materials import region_stiffness, weight_change
from retarget.simulation.projections import closest_rotation, closest_unit_determinant
from retarget.simulation.projective_dynamics import Equilibrium, SolverSettings
from retarget.simulation.soft_terms import Handles
from retarget.simulation.surface import carried_by_skin, vertex_areas
from retarget.simulation.tetrahedra import deformation_gradients
from retarget.types import SolveInfo, Status
from tests.retarget.simulation.box_head import box_head, box_template
from tests.retarget.simulation.threads import with_one_and_two_threads

EXACT = SolverSettings(max_iterations=500, energy_tolerance=1e-12, step_tolerance=1e-8, single_precision=False)


@pytest.fixture(scope="module")
def head() -> Head:
    return box_head()


@pytest.fixture(scope="module")
def simulation(head):
    return InverseSimulation(head)


@pytest.fixture(scope="module")
def exact(head):
    return InverseSimulation(head, InverseSettings(solver=EXACT))


def jaw_drop(head, degrees=12.0):
    """The lower half of the skin turns about the jaw joints; what is above the mouth stays."""
    angle = np.radians(degrees)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    pivot = head.condyles.mean(axis=0)
    lower = head.skin[:, 1] < 28 - 0.1
    return np.where(lower[:, None], (head.skin - pivot) @ turn.T + pivot, head.skin)


def cheek(head, height=3.0):
    distance = ((head.skin - [18.0, 30.0, 20.0]) ** 2).sum(axis=1)
    return head.skin + height * np.exp(-distance / 80)[:, None] * [0.3, 0.1, 1.0]


def expressions(head, count=6):
    return np.stack([head.skin + t * (cheek(head) - head.skin) for t in np.linspace(0.2, 1.0, count)])


def test_the_neutral_gives_the_neutral(head, simulation):
    state = simulation(head.skin)
    assert state.info.status is Status.CONVERGED
    np.testing.assert_allclose(state.vertices, head.vertices, atol=1e-5)
    np.testing.assert_allclose(state.skin, head.skin, atol=1e-5)
    np.testing.assert_allclose(state.gradients, np.broadcast_to(np.eye(3), state.gradients.shape), atol=1e-5)
    assert simulation.paper_energy(state) < 1e-8


def test_a_state_is_of_one_piece(head, simulation):
    state = simulation(cheek(head))
    template = head.template
    np.testing.assert_allclose(state.skin, template.embedding @ state.vertices + head.residual, atol=1e-12)
    np.testing.assert_array_equal(state.gradients, deformation_gradients(simulation.shape, state.vertices))
    np.testing.assert_allclose(
        state.vertices[template.cranium], state.bones.cranium(head.vertices[template.cranium]), atol=1e-9
    )
    assert np.abs(state.skin - cheek(head)).max() < 1.0


def test_a_full_jaw_drop_from_rest_converges(head, simulation):
    state = simulation(jaw_drop(head))
    assert state.info.status is Status.CONVERGED
    energy = np.array(state.info.energy)
    assert (np.diff(energy) <= 0).all()
    jaw = head.template.jaw
    moved = np.linalg.norm(state.vertices[jaw] - head.vertices[jaw], axis=1)
    assert moved.min() > 2.0
    assert np.isfinite(state.gradients).all()


def test_a_stiffer_target_comes_closer(head):
    wanted = cheek(head)
    misses = []
    for weight in (10.0, 100.0, 1000.0):
        state = InverseSimulation(head, InverseSettings(w_target=weight))(wanted)
        misses.append(np.sqrt(((state.skin - wanted) ** 2).mean()))
    assert misses[0] > 2 * misses[1] > 4 * misses[2]


def test_the_balance_of_tissue_and_target_does_not_depend_on_the_mesh():
    """Same slab, same bulge, twice the resolution: the miss stays, where weights per vertex would divide it by four."""
    misses = []
    for cells in ((16, 14, 5), (32, 28, 10)):
        head = box_head(box_template(cells))
        wanted = cheek(head)
        state = InverseSimulation(head)(wanted)
        area = vertex_areas(head.skin, head.template.faces)
        misses.append(np.sqrt(area @ ((state.skin - wanted) ** 2).sum(axis=1) / area.sum()))
    assert misses[1] == pytest.approx(misses[0], rel=0.35)


def test_a_batch_is_the_same_as_one_by_one(head, exact):
    skins = np.stack([*expressions(head, 3), jaw_drop(head, 6.0)])
    together = exact.batch(skins, size=3)
    for skin, state in zip(skins, together, strict=True):
        alone = exact(skin)
        np.testing.assert_allclose(state.vertices, alone.vertices, atol=1e-6)
        assert state.info.status is alone.info.status


def test_a_stream_finds_the_same_states_in_fewer_iterations(head, exact, simulation):
    skins = expressions(head)
    for state, skin in zip(exact.stream(skins), skins, strict=True):
        np.testing.assert_allclose(state.vertices, exact(skin).vertices, atol=1e-4)
    streamed = [state.info.iterations for state in simulation.stream(skins)]
    assert sum(streamed) < sum(simulation(skin).info.iterations for skin in skins)


def test_a_hint_changes_the_iterations_not_the_result(head, exact, simulation):
    """States of almost the same expressions, which jump from frame to frame, as adt's do for anacon."""
    rng = np.random.default_rng(1)
    skins = [head.skin + w * (cheek(head) - head.skin) for w in rng.uniform(-0.5, 1.0, 4)]
    alone = [exact(skin).vertices for skin in skins]
    hints = [simulation(skin + 0.02) for skin in skins]
    for near in (hints, [hints[0], None, None, hints[3]]):
        for state, vertices in zip(exact.stream(skins, near=near), alone, strict=True):
            np.testing.assert_allclose(state.vertices, vertices, atol=1e-4)
    hinted, plain = (
        sum(state.info.iterations for state in simulation.stream(skins, near=near)) for near in (hints, None)
    )
    assert hinted < plain


def test_a_solved_neighbour_is_a_start(head, exact):
    wanted = cheek(head)
    first = exact(wanted)
    again = exact(wanted, near=first)
    np.testing.assert_allclose(again.vertices, first.vertices, atol=1e-5)
    assert again.info.energy[0] < 1.5 * first.info.energy[-1]


def test_the_result_is_stationary_for_the_equations_written_out():
    """Eqs (11) to (14), handles and weight, all with weights of their own: the gradient at the result vanishes.

    The skin is warped to triangles of many sizes, so that weight by area is not weight by vertex.
    """
    template = box_template()
    warped = template.vertices * [1.0, 1.0, 0.9] + [0, 3.0, 0] * np.sin(template.vertices / 9.0)
    residual = 0.2 * np.cos(template.skin)
    head = Head(template, template.embedding @ warped + residual, warped, box_head().condyles, {})
    stiffness = region_stiffness(head, {"upper_lip": 4.0, "jaw_skin": 0.5})
    settings = InverseSettings(w_soft=2.0, w_muscle=3.0, w_target=20.0, muscle_strain=0.1, solver=EXACT)
    handles = Handles(skin=np.array([5, 90]), vertices=np.array([700]), weights=np.array([3e3, 5e3, 7e3]))
    held = np.vstack([head.skin[handles.skin], head.vertices[handles.vertices]]) + np.array([0.5, -0.3, 1.0])
    gravity = np.array([0.001, -0.002, 0.003])
    simulation = InverseSimulation(head, settings, stiffness, handles)
    wanted = cheek(head)
    state = simulation(wanted, handles=held, gravity=gravity)

    shapes = warped, state.vertices
    rest, now = (np.swapaxes((x[template.tets] - x[template.tets[:, :1]])[:, 1:], 1, 2) for x in shapes)
    volumes, inverse = np.linalg.det(rest) / 6000.0, np.linalg.inv(rest)  # cm^3
    f = now @ inverse
    volume = np.where(template.muscle, 3.0, 2.0) * volumes * stiffness
    strain = np.where(template.muscle, 0.1 * 3.0, 2.0) * volumes * stiffness
    stress = strain[:, None, None] * (f - closest_rotation(f)) + volume[:, None, None] * (
        f - closest_unit_determinant(f)
    )
    hats = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
    gradient = np.zeros_like(head.vertices)
    np.add.at(gradient, template.tets, 2 * hats @ np.swapaxes(stress, 1, 2))

    unit = volumes.sum() / 234_049
    corners = head.skin[template.faces]
    sizes = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    area = np.zeros(len(head.skin))
    np.add.at(area, template.faces, sizes[:, None] / 3)
    pull = 20.0 * 29_826 * unit * area / area.sum() / 100.0
    assert area.max() > 3 * area.min()
    gradient += 2 * template.embedding.T @ (pull[:, None] * (state.skin - wanted))
    there = np.vstack([state.skin[handles.skin], state.vertices[handles.vertices]])
    on_handles = 2 * (handles.weights * unit / 100.0)[:, None] * (there - held)
    gradient += template.embedding[handles.skin].T @ on_handles[:2]
    gradient[handles.vertices] += on_handles[2:]
    weight = np.zeros(len(head.vertices))
    np.add.at(weight, template.tets, volumes[:, None] / 4)
    gradient -= weight[:, None] * gravity

    free = np.setdiff1d(np.arange(len(gradient)), template.fixed)
    assert not np.isin(handles.vertices, template.fixed).any()
    least = min(np.abs(on_handles).min(), np.abs(weight[:, None] * gravity).max())
    assert np.abs(gradient[free]).max() < 1e-4 * least


def test_a_neighbour_is_carried_to_the_new_expression(head, exact):
    """The start extends what changed since the neighbour: its energy is near the minimum, that of staying is not."""
    first, wanted = exact(cheek(head, 2.0)), cheek(head, 3.0)
    found = exact(wanted, near=first)
    stay = exact.solver.energy_and_descent(first.vertices, wanted - head.residual)[0]
    start, end = found.info.energy[0], found.info.energy[-1]
    assert start - end < 0.05 * (stay - end)


def test_a_stream_recognises_what_it_has_seen(head, exact):
    """Expressions that are affine combinations of known ones are predicted exactly where the tissue has solved them."""
    skins = np.stack([cheek(head), jaw_drop(head, 4.0), cheek(head)])
    states = list(exact.stream(skins))
    assert states[2].info.energy[0] == pytest.approx(states[0].info.energy[-1], rel=1e-6)


def test_a_stream_forgets_a_solve_that_failed(head, monkeypatch):
    simulation = InverseSimulation(head)
    skins = expressions(head, 3)
    without = list(simulation.stream(skins[[0, 2]]))
    solve, calls = simulation.solver.solve_many, []

    def second_fails(problems):
        calls.append(len(problems))
        if len(calls) == 2:
            return [Equilibrium(head.vertices.copy(), SolveInfo(Status.FAILED, 0, (), "made up"), (), 0)]
        return solve(problems)

    monkeypatch.setattr(simulation.solver, "solve_many", second_fails)
    states = list(simulation.stream(skins))
    assert states[1].info.status is Status.FAILED
    np.testing.assert_array_equal(states[1].skin, head.skin)
    np.testing.assert_array_equal(states[2].vertices, without[1].vertices)


def test_a_solve_that_failed_is_at_rest_with_its_bones(head, simulation):
    """So that the forward simulation makes rest of it, not a jaw that opens in tissue that stays."""
    state = simulation(jaw_drop(head), gravity=(0, 1e300, 0))
    assert state.info.status is Status.FAILED
    back = ForwardSimulation(head, ForwardSettings(collisions=False))(state.gradients, state.bones)
    np.testing.assert_allclose(back.vertices, head.vertices, atol=1e-9)


def handled(head):
    """A simulation with two handles, where three frames want them, and the weight on all."""
    points = np.array([5, 90])
    simulation = InverseSimulation(head, InverseSettings(solver=EXACT), handles=Handles(skin=points))
    goals = head.skin[points] + np.array([0, 0, 1.0]) * np.arange(3)[:, None, None]
    return simulation, goals, np.array([0.001, -0.002, 0.0])


@pytest.mark.parametrize("per_frame", [True, False])
def test_handles_and_weight_mean_the_same_in_batch_and_stream(head, per_frame):
    simulation, goals, gravity = handled(head)
    skins = expressions(head, 3)
    given = goals if per_frame else goals[2]
    together = simulation.batch(skins, 2, given, gravity)
    streamed = list(simulation.stream(iter(skins), iter(given) if per_frame else given, gravity))
    for i, skin in enumerate(skins):
        alone = simulation(skin, handles=goals[i] if per_frame else goals[2], gravity=gravity)
        np.testing.assert_allclose(together[i].vertices, alone.vertices, atol=1e-6)
        np.testing.assert_allclose(streamed[i].vertices, alone.vertices, atol=1e-4)
    plain = InverseSimulation(head)(skins[0])
    assert np.abs(plain.vertices - together[0].vertices).max() > 0.01


def test_a_bad_frame_is_named(head, simulation):
    skins = expressions(head, 3)
    skins[1, 7] = np.nan
    stream = simulation.stream(skins)
    next(stream)
    with pytest.raises(InvalidInput, match="frame 1: expression: 1 vertices are NaN"):
        next(stream)
    skins[1] = head.skin + np.array([0, 0, 1.5])
    with pytest.raises(InvalidInput, match="frame 1: expression: expected a head that keeps still"):
        simulation.batch(skins)
    held, goals, _ = handled(head)
    with pytest.raises(InvalidInput, match=r"frame 2: handles: .* got none"):
        list(held.stream(expressions(head, 3), goals[:2]))
    with pytest.raises(InvalidInput, match=r"handles: expected .* or 3 of these, got 2"):
        held.batch(expressions(head, 3), handles=goals[:2])


def test_the_hard_surface_moves_with_the_skin(head):
    outer, carry = carried_by_skin(head)
    assert not np.isin(outer, head.template.skull).any()
    np.testing.assert_allclose(np.asarray(carry.sum(axis=1)).ravel(), 1)
    np.testing.assert_allclose(carry @ head.skin, head.vertices[outer], atol=1e-9)  # outer vertices lie on this skin
    wanted = cheek(head)
    hard = InverseSimulation(head, InverseSettings(surface="hard"))(wanted)
    assert hard.info.status is Status.CONVERGED
    np.testing.assert_allclose(hard.vertices[outer] - head.vertices[outer], carry @ (wanted - head.skin), atol=1e-9)
    streamed = list(InverseSimulation(head, InverseSettings(surface="hard")).stream(expressions(head)))
    np.testing.assert_allclose(streamed[-1].vertices, hard.vertices, atol=0.1)
    soft = InverseSimulation(head, InverseSettings(w_target=1e5))(wanted)
    np.testing.assert_allclose(soft.vertices, hard.vertices, atol=0.35)


def test_artistic_control(head, simulation):
    """A pulled point follows, stiff regions deform less, and weight lowers what no bone holds."""
    tip = int(np.argmin(((head.skin - [18.0, 30.0, 20.0]) ** 2).sum(axis=1)))
    handled = InverseSimulation(head, handles=Handles(skin=np.array([tip]), weights=1e5))
    state = handled(head.skin, handles=head.skin[[tip]] + [0, 0, 2.0])
    assert state.skin[tip, 2] - head.skin[tip, 2] > 0.3
    with pytest.raises(InvalidInput, match="made with 1, expected a target"):
        handled(head.skin)
    with pytest.raises(InvalidInput, match="made with 0"):
        simulation(head.skin, handles=head.skin[[tip]])

    loose = InverseSettings(w_target=1.0)
    stiffness = region_stiffness(head, {"upper_lip": 20.0})
    members = head.template.regions.vertices["upper_lip"]
    pulled = np.where(
        np.isin(np.arange(len(head.skin)), members)[:, None], head.skin + np.array([0, 0, 2.0]), head.skin
    )
    lifts = [
        (InverseSimulation(head, loose, stiffness=s)(pulled).skin - head.skin)[members, 2].mean()
        for s in (1.0, stiffness)
    ]
    assert lifts[1] < 0.8 * lifts[0]

    heavy = simulation(head.skin, gravity=weight_change((0, -98.1, 0), (0, 0, 0)))
    assert (heavy.skin - head.skin)[:, 1].mean() < -1e-3


def test_one_thread_and_two_give_the_same(head, simulation):
    one, two = with_one_and_two_threads(lambda: simulation(cheek(head)))
    np.testing.assert_array_equal(one.vertices, two.vertices)


def test_double_precision_changes_nothing_that_counts(head, simulation):
    settings = InverseSettings()
    double = InverseSimulation(head, replace(settings, solver=replace(settings.solver, single_precision=False)))
    for skin in (cheek(head), jaw_drop(head, 8.0)):
        np.testing.assert_allclose(double(skin).vertices, simulation(skin).vertices, atol=1e-3)


def test_bad_input_is_refused(head, simulation):
    with pytest.raises(InvalidInput, match="expression: 1 vertices are NaN"):
        simulation(np.where(np.arange(len(head.skin))[:, None] == 3, np.nan, head.skin))
    with pytest.raises(InvalidInput, match="expression: expected"):
        simulation(head.skin[1:])
    with pytest.raises(InvalidInput, match="keeps still"):
        simulation(head.skin + np.array([0, 0, 1.5]))
    with pytest.raises(InvalidInput, match="opens as jaws can"):
        simulation(jaw_drop(head, 60.0))
    far = head.skin + np.where(np.arange(len(head.skin))[:, None] == 90, [0, 0, 1e6], 0)
    with pytest.raises(
        InvalidInput, match=r"expression: expected points within 150 mm .* but 90 is 1000000\.0 mm away"
    ):
        simulation(far)
    for gravity in (9.81, (0, np.nan, 0), (0, 1.0)):
        with pytest.raises(InvalidInput, match="gravity: expected a vector"):
            simulation(head.skin, gravity=gravity)
    held, goals, _ = handled(head)
    with pytest.raises(InvalidInput, match=r"handles: expected points within 150 mm .* but 1 is 1000\.0 mm"):
        held(head.skin, handles=goals[0] + [[0, 0, 0], [0, 0, 1000.0]])
    with pytest.raises(InvalidInput, match=r"handles: expected \(2, 3\), one for each handle, got \(2, 2\)"):
        held(head.skin, handles=goals[0, :, :2])
    with pytest.raises(InvalidInput, match="surface"):
        InverseSettings(surface="firm")
    with pytest.raises(InvalidInput, match="w_target > 0"):
        InverseSettings(w_target=0.0)
    with pytest.raises(InvalidInput, match="stiffness: expected"):
        InverseSimulation(head, stiffness=-1.0)
