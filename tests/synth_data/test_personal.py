"""Personal expressions: what any face must keep, and what the mechanism promises."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.sparse as sp

from retarget.anatomy.closed import self_intersections
from retarget.check import InvalidInput
from retarget.types import FloatArray, Regions
from synth_data.arkit import MIRRORED, SKIN_NAMES
from synth_data.lip_contact import least, missing_gaps
from synth_data.makehuman.anthropometry import personalisation
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.targets import Targets
from synth_data.personal.contact import overlaps, rest
from synth_data.personal.face import PersonalFace, personal_face
from synth_data.personal.jaw import Excursion
from synth_data.personal.lids import LidAction, fit_sphere
from synth_data.personal.measure import magnitudes, span_residual
from synth_data.personal.relaxation import relaxation_of
from synth_data.personal.scans import SCANS, personal_scans, unit_weights
from synth_data.personal.traits import ASYMMETRY, GAIN_DEVIATION, draw_traits

Base = tuple[BaseHead, Targets, Regions]
FREE = 4, 5, 7  # seeds whose lips are apart at rest
FLIP = np.array([-1.0, 1.0, 1.0])


def face_of(base: Base, sampler: IdentitySampler, seed: int, traits_of: int | None = None) -> PersonalFace:
    person = sampler(seed)
    traits = draw_traits(seed if traits_of is None else traits_of, person.age)
    return personal_face(person.vertices, base[0].faces, base[2], traits)


@pytest.fixture(scope="module")
def people(base: Base, sampler: IdentitySampler) -> list[PersonalFace]:
    return [face_of(base, sampler, seed) for seed in FREE]


@pytest.fixture(scope="module")
def motions(people: list[PersonalFace]) -> list[FloatArray]:
    return [np.stack([scan.vertices for scan in personal_scans(face)]) - face.neutral for face in people]


def test_zero_weights_give_the_neutral(people: list[PersonalFace]) -> None:
    np.testing.assert_array_equal(people[0](np.zeros((1, 51)))[0], people[0].neutral)


def test_same_weights_and_identity_same_bits(base: Base, sampler: IdentitySampler, people: list[PersonalFace]) -> None:
    again = face_of(base, sampler, FREE[0])
    weights = np.stack([unit_weights(SCANS[name]) for name in ("laugh", "anger")])
    np.testing.assert_array_equal(again(weights), people[0](weights))
    np.testing.assert_array_equal(again(weights[1:]), people[0](weights)[1:])


def test_mirrored_weights_on_a_mirrored_person_give_the_mirrored_mesh(base: Base, people: list[PersonalFace]) -> None:
    regions, face = base[2], people[0]
    assert regions.mirror is not None
    image = personal_face((face.neutral * FLIP)[regions.mirror], face.faces, regions, face.traits.mirrored())
    swap = [SKIN_NAMES.index(MIRRORED[name]) for name in SKIN_NAMES]
    names = ("smile_left", "mouth_right", "jaw_left", "anger", "eyes_squeezed", "sadness")
    weights = np.stack([unit_weights(SCANS[name]) for name in names])
    expected = (face(weights) * FLIP)[:, regions.mirror]
    np.testing.assert_allclose(image(weights[:, swap]), expected, atol=0.02)
    plain = personal_face(image.neutral, face.faces, regions, face.traits)
    assert np.abs(plain(weights[:, swap]) - expected).max() > 0.5  # the asymmetry is the person's own


def test_scans_of_people_whose_lips_are_apart_cross_nowhere(people: list[PersonalFace]) -> None:
    for face in people:
        assert len(self_intersections(face.neutral, face.faces)) == 0
        for name in ("smile", "anger", "eyes_shut", "lips_shut_jaw_open"):
            assert len(self_intersections(face(unit_weights(SCANS[name]))[0], face.faces)) == 0, name


@pytest.mark.parametrize(
    ("seed", "names"),
    [(0, ["jaw_drop"]), (2, ["pucker", "jaw_drop", "mouth_left", "mouth_right"]), (6, ["pucker", "eyes_squeezed"])],
)
def test_creases_of_lips_lids_and_throat_cross_nowhere(
    base: Base, sampler: IdentitySampler, seed: int, names: list[str]
) -> None:
    face = face_of(base, sampler, seed)
    assert len(self_intersections(face.neutral, face.faces)) == 0
    for name in names:
        assert len(self_intersections(face(unit_weights(SCANS[name]))[0], face.faces)) == 0, name


def test_sheets_that_pass_each_other_give_way_and_nothing_else_moves() -> None:
    sheet = np.stack(np.meshgrid(np.arange(0.0, 41.0, 2.0), np.arange(0.0, 21.0, 2.0), [0.0]), axis=-1).reshape(-1, 3)
    corner = np.flatnonzero((sheet[:, 0] < 40) & (sheet[:, 1] < 20))
    square = np.column_stack([corner, corner + 1, corner + 22, corner, corner + 22, corner + 21])
    faces = np.concatenate([part + shift for part in (square[:, :3], square[:, 3:]) for shift in (0, len(sheet))])
    above = np.array([0.3, 0.4, 0.5])
    rest_ = np.concatenate([sheet, sheet + above])
    relaxation = relaxation_of(rest_, faces, np.full(len(rest_), 4.0), np.arange(len(rest_)))
    slid = rest_ + np.column_stack([0.2 * np.sin(rest_[:, 1]), np.zeros((len(rest_), 2))])
    assert relaxation(slid) is slid  # nothing crosses
    pressed = rest_.copy()
    pressed[: len(sheet), 2] += 1.5 * np.exp(-0.5 * np.sum((sheet - (10, 10, 0)) ** 2, axis=1) / 3.0**2)
    assert len(self_intersections(pressed, faces)) > 0
    mended = relaxation(pressed)
    assert len(self_intersections(mended, faces)) == 0
    moved = np.linalg.norm(mended - pressed, axis=1)
    assert 0.2 < moved.max() < 1.5  # mm
    assert (moved[rest_[:, 0] > 30] == 0).all()


def test_magnitudes_are_those_of_people(base: Base, people: list[PersonalFace]) -> None:
    for face in people:
        found = magnitudes(face, base[2])
        assert 25 < found["lip opening under jawOpen (mm)"] < 50
        assert 18 < found["smile: mouth wider (%)"] < 46
        assert 35 < found["smile: corner's direction (degrees)"] < 60
        assert 3 < found["jaw to the left (mm)"] < 14
        assert 20 < found["pucker: mouth narrower (%)"] < 45
        assert 4 < found["protrusion (mm)"] < 12


def test_people_differ_beyond_the_repeatability_of_a_posed_smile(
    base: Base, people: list[PersonalFace], motions: list[FloatArray]
) -> None:
    head, lips = base[2].vertices["head"], base[2].vertices["lips"]
    for a, b in itertools.combinations(motions, 2):
        assert personalisation(a, b, head) > 0.15
    smiles = [m[list(SCANS).index("smile")][lips] for m in motions]
    apart = [np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))) for a, b in itertools.combinations(smiles, 2)]
    assert np.mean(apart) > 1.5  # mm


def test_scans_are_not_in_the_span_of_the_generic_rig(base: Base, people: list[PersonalFace]) -> None:
    rig = np.stack([base[1][f"units/{name}"] for name in SKIN_NAMES])
    scans = list(personal_scans(people[0]))
    residual, share = span_residual(scans, people[0].neutral, rig, base[2].vertices["head"])
    assert residual > 0.5
    assert share > 0.15
    inside = [type(scan)(scan.name, scan.weights, people[0].neutral + 3 * rig[4]) for scan in scans[:2]]
    assert span_residual(inside, people[0].neutral, rig, base[2].vertices["head"])[1] < 1e-6


def test_the_jaw_carries_the_chin_rigidly_about_the_condyles(people: list[PersonalFace]) -> None:
    for face in people:
        bone = np.flatnonzero(face.jaw.share > 0.985)
        at = face.neutral[bone]
        moved = face.jaw(face.neutral, Excursion(opening=1.0))[bone]
        before, after = (np.linalg.norm(v[1:] - v[:-1], axis=1) for v in (at, moved))
        np.testing.assert_allclose(after, before, rtol=0.06, atol=0.2)
        glide = face.jaw.share[bone, None] * face.jaw.glide * face.frame.forward
        radius = [np.linalg.norm(v - face.jaw.centre, axis=1) for v in (at, moved - glide)]
        np.testing.assert_allclose(*radius, atol=1e-9)


def test_the_excursion_grows_with_the_mandible(base: Base, people: list[PersonalFace]) -> None:
    face = people[0]
    large = personal_face(1.2 * face.neutral, face.faces, base[2], face.traits)
    assert large.jaw.length == pytest.approx(1.2 * face.jaw.length, rel=0.03)
    assert large.jaw.protrusion == pytest.approx(face.jaw.protrusion * large.jaw.length / face.jaw.length)


def test_lids_shut_on_the_eyeball(base: Base, people: list[PersonalFace]) -> None:
    regions = base[2]
    for face in people:
        for side, lids in zip(("left", "right"), face.lids, strict=True):
            shut = face.neutral.copy()
            shut[lids.vertices] += lids(face.neutral, LidAction(shut=1.0))
            margins = [regions.vertices[f"lid_margin_{lid}_{side}"] for lid in ("upper", "lower")]

            def aperture(v: FloatArray, margins: list, up: FloatArray) -> float:
                above, below = (v[m] @ up for m in margins)
                return float(np.median(above) - np.median(below))

            rest_, closed = (aperture(v, margins, lids.axes[1]) for v in (face.neutral, shut))
            assert closed < 0.5 * rest_  # the rims touch behind the margins
            away = [np.linalg.norm(v[margins[0]] - lids.centre, axis=1) for v in (face.neutral, shut)]
            np.testing.assert_allclose(*away, atol=1e-6)  # the margin slides on its sphere


def test_lids_ride_on_the_cornea_that_looks_aside(people: list[PersonalFace]) -> None:
    face = people[0]
    moved = face(unit_weights({"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0}))[0] - face.neutral
    assert 0.3 < np.linalg.norm(moved, axis=1).max() < 2.5  # mm
    for lids in face.lids:
        middle = lids.vertices[(lids.upper > 0.9) & (lids.opening > 0.3)]
        assert (moved[middle] @ face.frame.left).mean() > 0  # towards the person's left, both


def test_lips_stay_shut_while_the_chin_is_raised(base: Base, people: list[PersonalFace]) -> None:
    marks = [base[2].landmarks[f"stomion_{lip}"] for lip in ("upper", "lower")]
    for face in people:
        raised = face(unit_weights(SCANS["chin_raised"]))[0]
        apart = [np.linalg.norm(v[marks[0]] - v[marks[1]]) for v in (face.neutral, raised)]
        assert apart[1] < apart[0] + 1.0  # mm


def test_folds_deepen_with_age(base: Base, sampler: IdentitySampler) -> None:
    person = sampler(FREE[0])
    weights = unit_weights({"browInnerUp": 1.0, "browOuterUp": 1.0})
    young, old = (
        personal_face(person.vertices, base[0].faces, base[2], draw_traits(4, age))(weights)[0] for age in (25.0, 80.0)
    )
    assert 0.2 < np.abs(old - young).max() < 3.0


def test_motion_is_not_additive(people: list[PersonalFace]) -> None:
    smile, jaw = unit_weights({"mouthSmile": 1.0}), unit_weights({"jawOpen": 1.0})
    one, other, both = people[0](np.stack([smile, jaw, smile + jaw])) - people[0].neutral
    assert np.linalg.norm(both - one - other, axis=1).max() > 2  # mm


def test_frames_change_without_jumps(people: list[PersonalFace]) -> None:
    units = {"mouthSmile": 1.0, "jawOpen": 0.6, "eyeBlink": 1.0, "browDown": 0.8}
    weights = np.linspace(0.3, 0.32, 5)[:, None] * unit_weights(units)
    steps = np.abs(np.diff(people[0](weights), axis=0)).max(axis=(1, 2))
    assert steps.max() < 1.0  # mm for half a percent of weight; no vertex leaps
    assert steps.max() < 2.5 * steps.min()


def test_noise_has_its_length_and_is_repeated(people: list[PersonalFace], motions: list[FloatArray]) -> None:
    noisy = personal_scans(people[0], noise=0.3)
    added = np.stack([scan.vertices for scan in noisy]) - people[0].neutral - motions[0]
    assert np.sqrt(np.mean(np.sum(added**2, axis=2))) == pytest.approx(0.3, rel=0.1)
    np.testing.assert_array_equal(noisy[0].vertices, personal_scans(people[0], noise=0.3)[0].vertices)
    assert not np.allclose(added[0], added[1])
    with pytest.raises(InvalidInput, match="noise"):
        personal_scans(people[0], noise=-0.1)


def test_names_of_units_are_checked() -> None:
    with pytest.raises(InvalidInput, match="mouthSmirk"):
        unit_weights({"mouthSmirk": 1.0})
    assert unit_weights({"mouthSmile": 0.5}).sum() == 1.0


def test_gains_vary_as_stated() -> None:
    gains = np.log([draw_traits(seed, 30.0).gain("zygomaticus") for seed in range(300)])
    assert gains.mean(axis=1).std() == pytest.approx(GAIN_DEVIATION, rel=0.12)
    assert np.diff(gains, axis=1).std() == pytest.approx(ASYMMETRY, rel=0.12)
    traits = draw_traits(3, 30.0)
    assert traits.mirrored().gain("risorius") == traits.gain("risorius")[::-1]
    assert traits.mirrored().mirrored() == traits


def test_response_is_concave_from_zero_to_one() -> None:
    answer = draw_traits(0, 30.0).response(np.linspace(0, 1, 11))
    assert answer[0] == 0
    assert answer[-1] == pytest.approx(1)
    assert (np.diff(answer) > 0).all()
    assert (np.diff(answer, 2) < 0).all()


def test_sphere_through_points_of_a_sphere() -> None:
    directions = np.random.default_rng(0).standard_normal((30, 3))
    points = (3, -2, 7) + 15.5 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    centre, radius = fit_sphere(points)
    np.testing.assert_allclose(centre, (3, -2, 7), atol=1e-9)
    assert radius == pytest.approx(15.5)


def test_gaps_between_two_triangles_by_hand_and_their_least_parting() -> None:
    at = np.array([[0, 0, 0], [4, 0, 0], [0, 0, 4], [1, 0.3, 1], [5, 0.3, 1], [1, 0.3, 5]], dtype=np.float64)
    rows, missing = missing_gaps(at, np.array([[0, 1, 2]]), np.array([[3, 4, 5]]), gap=0.1)
    np.testing.assert_allclose(missing, 0.4)  # the upper one lies 0.3 mm below the lower one
    np.testing.assert_allclose(rows @ np.ones(6), 0, atol=1e-12)  # nothing changes where both rise
    u = least(np.eye(6), rows, missing)
    assert (rows @ u > 0.399).all()
    assert (u[:3] >= 0).all()
    assert (u[3:] <= 0).all()
    many = least(np.eye(6), sp.csr_array(sp.vstack([rows] * 9)), np.tile(missing, 9))  # more contacts than vertices
    np.testing.assert_allclose(many, u, atol=1e-3)
    aside = at + np.repeat([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]], 3, axis=0)
    assert len(missing_gaps(aside, np.array([[0, 1, 2]]), np.array([[3, 4, 5]]), gap=0.1)[1]) == 0


def test_contact_parts_two_sheets_that_overlap_and_leaves_others() -> None:
    plane = np.stack(np.meshgrid(np.arange(6.0), np.arange(4.0)), axis=-1).reshape(-1, 2)
    flat = np.zeros(len(plane))
    touch = rest((plane, flat + 1.0), (plane, flat), gap=0.2)
    lift, sink = touch((plane, flat + 0.5), (plane, flat))
    assert not lift.any()
    assert not sink.any()
    lift, sink = touch((plane, flat - 0.6), (plane, flat))
    over = overlaps((plane, flat - 0.6 + lift), (plane, flat + sink))
    assert max(side.max() for side in over) < -0.1
    np.testing.assert_allclose(lift, -sink)
