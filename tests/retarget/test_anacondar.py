"""AnaConDaR, adt and anacon on two people."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.catalogue import make_method
from retarget.anatomical_transfer import AnatomicalTransfer, AnatomySettings, Carrier, joined
from retarget.anatomy.distance import distance_to
from retarget.character import characters
from retarget.check import InvalidInput, UnsupportedProblem
from retarget.simulation.characteristics import FacialCharacteristics
from retarget.types import Examples, Pair, SolveInfo, Status
from tests.retarget.people import SOURCE, TARGET, examples, frames, pair
from tests.synthetic import problem as ball_problem

NONE = Examples(frames(TARGET)[:0], frames(SOURCE)[:0])


def rms(difference):
    return np.sqrt((difference**2).sum(axis=-1).mean())


def fitted(name, given=None, between=None, **settings):
    between = between or pair()
    return make_method(name, **settings).prepare(between).fit(given or examples(5), frames(SOURCE))


def test_adt_of_the_neutral_is_the_target_and_the_printed_lips_miss_it():
    """adt(S, S, T) = T for the relative contour; eq. (16) puts the source's lips on the target."""
    contour = pair().regions.loops["lip_contour"]
    missed = {}
    for lips in ("relative", "printed"):
        settings = AnatomySettings(lips=lips, collisions=False, w_lip_contour=1000.0)
        found = AnatomicalTransfer(pair(), settings)(pair().source_neutral[None])[0]
        missed[lips] = np.linalg.norm(found - pair().target_neutral, axis=1)
    assert missed["relative"].max() < 0.01
    assert 0.5 < missed["printed"][contour].mean() < 3.0


@pytest.mark.parametrize("name", ["anacondar", "adt", "no_characteristics", "plbs_anacon", "dt_instead_of_adt"])
def test_neutral_maps_to_neutral(name):
    found = fitted(name)(pair().source_neutral[None]).frames[0]
    np.testing.assert_allclose(found, pair().target_neutral, atol=0.01)


@pytest.mark.parametrize(("name", "tolerance"), [("anacondar", 0.1), ("adt", 0.2)])
def test_a_source_that_is_its_own_target_gets_its_frames_back(name, tolerance):
    """Up to what tets of the coarse template cannot follow, and lips that are parted where they cross."""
    alone = pair(SOURCE, SOURCE)
    found = fitted(name, examples(5, SOURCE, SOURCE), alone, collisions=False)(frames(SOURCE)[5:8]).frames
    head = alone.regions.vertices["head"]
    assert rms((found - frames(SOURCE)[5:8])[:, head]) < tolerance
    assert rms((frames(SOURCE)[5:8] - alone.source_neutral)[:, head]) > 1.0


def test_without_examples_it_is_adt_and_then_anacon():
    """Nothing is explained, so evidence takes nothing back and eq. (19) holds as printed."""
    expression = frames(SOURCE)[3]
    method = make_method("anacondar", missing_collisions=True)
    found = method.prepare(pair()).fit(NONE, frames(SOURCE))(expression[None])
    adt = AnatomicalTransfer(pair(), method)
    carried = adt.started()(expression)
    np.testing.assert_allclose(found.parts["draft"][0], carried.skin, atol=1e-9)
    anacon = Carrier(adt.target.inverse(method.inverse_settings), adt.carry.forward)
    formed = anacon.inverse(carried.skin, carried.taken)
    done = anacon.take(formed, FacialCharacteristics(pair(), method.lips)(expression))
    moving = np.linalg.norm(frames(SOURCE)[3] - pair().source_neutral, axis=1) > 1.0
    np.testing.assert_allclose(found.frames[0][moving], done.skin[moving], atol=0.05)
    assert found.info[0].status in (Status.CONVERGED, Status.MAX_ITERATIONS)


def test_examples_that_explain_everything_leave_the_blended_expression():
    """The frame itself is an example: T_i^P is the target's own expression, and evidence leaves it alone."""
    found = fitted("anacondar", lambda_reg=1e-9, collisions=False)(frames(SOURCE)[:3])
    head = pair().regions.vertices["head"]
    assert rms((found.frames - frames(TARGET)[:3])[:, head]) < 1e-3
    printed = fitted("anacondar", lambda_reg=1e-9, collisions=False, completed=False, held="characteristics")
    assert rms((printed(frames(SOURCE)[:3]).frames - frames(TARGET)[:3])[:, head]) > 0.1


def test_parts_add_up():
    result = fitted("anacondar")(frames(SOURCE)[6:8])
    parts = result.parts
    np.testing.assert_allclose(parts["source_reconstruction"] + parts["missing_source"], frames(SOURCE)[6:8], atol=1e-9)
    np.testing.assert_allclose(parts["plbs"] + parts["missing_target"], parts["draft"], atol=1e-9)
    plbs = fitted("plbs", lambda_reg=make_method("anacondar").lambda_reg)(frames(SOURCE)[6:8])
    np.testing.assert_allclose(parts["plbs"], plbs.frames, atol=1e-9)


def test_ablations_leave_out_what_they_say():
    frame = frames(SOURCE)[6:7]
    dt = fitted("dt_instead_of_adt")(frame).parts
    np.testing.assert_allclose(dt["missing_source"], fitted("anacondar")(frame).parts["missing_source"], atol=1e-12)
    assert rms(dt["missing_target"] - fitted("anacondar")(frame).parts["missing_target"]) > 0.01
    assert not fitted("no_missing_blendshape")(frame).parts["missing_target"].any()
    plain = fitted("plbs_anacon", collisions=False)
    anacon = plain.prepared.directed(None)
    formed = anacon.anacon.inverse(plain(frame).parts["plbs"][0])
    np.testing.assert_allclose(plain(frame).frames[0], formed.skin, atol=1e-6)  # fwdSim(invSim(X)) on one head
    smoothed = fitted("source_anacon")(frame).parts["source_reconstruction"]
    assert 0.001 < rms(smoothed - fitted("plbs")(frame).parts["source_reconstruction"]) < 0.5


def test_no_characteristics_are_left_out_in_adt_too():
    frame = frames(SOURCE)[6:7]
    none = fitted("no_characteristics")
    found = none(frame).parts
    missing = pair().source_neutral + found["missing_source"][0]
    alone = none.prepared.adt.started(characteristics=False)(missing)
    np.testing.assert_allclose(found["missing_target"][0], alone.skin - pair().target_neutral, atol=1e-9)
    assert rms(found["missing_target"] - fitted("anacondar")(frame).parts["missing_target"]) > 1e-3


def test_edits_that_anacon_would_do_are_refused_without_it():
    with pytest.raises(InvalidInput, match="without anacon"):
        fitted("no_anacon")(frames(SOURCE)[6:7], {"gravity": [0, 9.81, 0]})


def test_without_anacon_the_draft_comes_back():
    result = fitted("no_anacon")(frames(SOURCE)[6:7])
    np.testing.assert_array_equal(result.frames, result.parts["draft"])
    blended = fitted("no_anacon", missing="nothing")(frames(SOURCE)[6:7])
    plbs = fitted("plbs", lambda_reg=make_method("anacondar").lambda_reg)(frames(SOURCE)[6:7])
    np.testing.assert_array_equal(blended.frames, plbs.frames)
    assert blended.info == (SolveInfo(),)


def test_an_animation_in_its_order_ends_where_its_frames_do_alone():
    """Streaming starts each solve from those before it; the solver's tolerance is all that may differ."""
    path = np.linspace(0, 1, 4)[:, None, None] * (frames(SOURCE)[6] - pair().source_neutral) + pair().source_neutral
    alone, together = fitted("anacondar", collisions=False), fitted("anacondar", collisions=False, streaming=True)
    expected, found = alone(path), together(path)
    np.testing.assert_allclose(found.frames, expected.frames, atol=0.15)
    assert rms(found.frames - expected.frames) < 0.01
    one_by_one = [one.result for one in together.stream(iter(path))]
    np.testing.assert_allclose(one_by_one, found.frames, atol=1e-4)  # blending one frame or four rounds differently


def test_examples_without_counterparts_are_embedded_in_the_sources_span():
    """Where the source's own animation holds the expressions, section 3.5 comes close to the true counterparts."""
    given = examples(3)
    prepared = make_method("anacondar", template="coarse", collisions=False).prepare(pair())
    embedded = prepared.fit(Examples(given.target, None), frames(SOURCE)).blendshapes.source
    told = prepared.fit(given, frames(SOURCE)).blendshapes.source
    missed = [rms(a - b) for a, b in zip(embedded.deltas, told.deltas, strict=True)]
    moved = [rms(b) for b in told.deltas]
    assert np.mean(missed) < 0.5 * np.mean(moved)


def test_every_solve_is_told():
    info = fitted("anacondar")(frames(SOURCE)[6:7]).info[0]
    assert "adt" in info.message
    assert "anacon" in info.message
    assert info.iterations >= 4


def test_the_worst_solve_speaks_for_all():
    good, late, bad = (SolveInfo(status, 2, (1.0,)) for status in Status)
    assert joined({"a": good, "b": late}).status is Status.MAX_ITERATIONS
    both = joined({"a": late, "b": bad, "c": good})
    assert both.status is Status.FAILED
    assert both.iterations == 6
    assert [word.split()[0] for word in both.message.split("; ")] == ["a", "b", "c"]


def test_settings_in_another_unit_of_length_mean_the_same():
    """100 / cm^2 is 1 / mm^2, and lambda in cm^2 is 100 times that in mm^2."""
    centimetres = make_method("anacondar", length_mm=10.0, w_target=100.0, w_lip_contour=1000.0, lambda_reg=1e-4)
    millimetres = make_method("anacondar", length_mm=1.0, w_target=1.0, w_lip_contour=10.0, lambda_reg=1e-2)
    assert centimetres.inverse_settings == millimetres.inverse_settings
    assert centimetres.forward_settings == millimetres.forward_settings
    assert centimetres.ridge.diagonal(7) == pytest.approx(millimetres.ridge.diagonal(7))


def test_refuses_heads_that_are_not_stabilised():
    turned = frames(SOURCE)[6:7] + np.array([0, 3.0, 0])
    with pytest.raises(InvalidInput, match="cranium"):
        fitted("adt")(turned)


def test_a_topology_without_a_template_is_unsupported_with_what_to_do():
    given = ball_problem()
    with pytest.raises(UnsupportedProblem, match=r"retarget\.anatomy build"):
        make_method("anacondar").retarget(given, given.source_animation[:1])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"missing": "adtt"}, "missing: .*adtt"),
        ({"held": "lips"}, "held: .*lips"),
        ({"template": "huge"}, "huge"),
        ({"w_target": -1.0}, "w_target"),
        ({"length_mm": 0.0}, "length_mm"),
        ({"tissue_depth": 0.0}, "tissue_depth"),
        ({"sharpness": 0.0}, "sharpness"),
        ({"tets": "big"}, "tets: .*big"),
    ],
)
def test_settings_out_of_range_are_refused(settings, message):
    method = make_method("anacondar")
    with pytest.raises(InvalidInput, match=message):
        replace(method, **settings)


def test_a_head_is_fitted_once_for_all_that_ask():
    method = make_method("anacondar")
    first, second = (AnatomicalTransfer(pair(), method) for _ in range(2))
    assert first.source.head is second.source.head
    assert first.carry.forward is second.carry.forward
    other = replace(pair(), source_neutral=pair().source_neutral * 1.01)
    assert AnatomicalTransfer(other, method).source.head is not first.source.head


def test_a_shallower_table_lifts_the_skull_to_its_depths():
    as_tabled, shallow = (characters(pair(), "coarse", factor)[1].head for factor in (1.0, 0.8))
    marks = {name: shallow.skin[shallow.template.regions.landmarks[name]] for name in shallow.depth_errors}

    def depth(head, name):
        skull = head.template.skull
        return distance_to((head.vertices[skull], np.searchsorted(skull, head.template.skull_faces)), marks[name][None])

    both = [name for name in shallow.depth_errors if name in as_tabled.depth_errors]
    assert len(both) >= 15
    for name in both:
        assert abs(depth(shallow, name) - 0.8 * as_tabled.template.depths[name]) < 1.0
    assert np.mean([depth(as_tabled, name) / depth(shallow, name) for name in both]) == pytest.approx(1.25, abs=0.1)


def test_equal_tets_leave_the_sum_of_weights():
    settings = AnatomySettings(tets="equal", collisions=False)
    equal = AnatomicalTransfer(pair(), settings).carry.inverse.weights
    volume = AnatomicalTransfer(pair(), replace(settings, tets="volume")).carry.inverse.weights
    assert np.ptp(equal.volume) < 1e-9 * equal.volume.max()
    assert equal.volume.sum() == pytest.approx(volume.volume.sum())


def test_pair_of_one_topology_only():
    with pytest.raises(InvalidInput):
        AnatomicalTransfer(Pair(pair().faces[1:], *(2 * [pair().source_neutral]), pair().regions), AnatomySettings())
