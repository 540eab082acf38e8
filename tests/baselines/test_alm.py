"""ALM as a method: what it refuses, edits, calibration, and its own examples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baselines.alm import AnatomicalLocalModels
from experiments.catalogue import make_method
from retarget.check import InvalidInput, UnsupportedProblem
from tests.retarget.people import examples, frames, pair
from tests.synthetic import problem

PROBLEM = problem()
METHOD = AnatomicalLocalModels(lambda_reg=1e-6, lambda_overlap=1e-6, patch_count=20, rings=2, anatomical=False)
FRAMES = PROBLEM.source_animation[5:7]


def fitted(method: AnatomicalLocalModels = METHOD):
    return method.prepare(PROBLEM.pair).fit(PROBLEM.examples, PROBLEM.source_animation)


def test_examples_are_reproduced() -> None:
    result = fitted()(PROBLEM.source_examples)
    error = np.linalg.norm(result.frames - PROBLEM.target_examples, axis=2)
    assert error.mean() < 0.01
    rebuilt = np.linalg.norm(result.parts["source_reconstruction"] - PROBLEM.source_examples, axis=2)
    assert rebuilt.mean() < 0.01


def test_the_tuned_method_reproduces_its_examples_on_a_head() -> None:
    known = examples(6)
    result = make_method("alm").prepare(pair()).fit(known, known.source)(known.source)
    error = np.linalg.norm(result.frames - known.target, axis=2)
    assert error.mean() < 0.1  # mm
    assert "anatomy converged" in result.info[0].message
    unlike = make_method("alm_patch_only").prepare(pair()).fit(known, known.source)(frames("person-000")[8:9])
    second = make_method("alm").prepare(pair()).fit(known, known.source)(frames("person-000")[8:9])
    assert 1e-4 < np.abs(unlike.frames - second.frames).max() < 5.0
    np.testing.assert_array_equal(unlike.frames, second.parts["patches"])


def test_shrinkage_grows_with_lambda_reg() -> None:
    errors = [
        np.linalg.norm(
            fitted(replace(METHOD, lambda_reg=weight))(PROBLEM.source_examples).frames - PROBLEM.target_examples
        )
        for weight in (1e-6, 1e-2, 1.0)
    ]
    assert errors[0] < errors[1] < errors[2]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"source_examples": None}, "unknown"),
        (
            {"source_examples": PROBLEM.source_examples[:0], "target_examples": PROBLEM.target_examples[:0]},
            "no examples",
        ),
        ({"source_examples": np.repeat(PROBLEM.source_neutral[None], 5, axis=0)}, "differs from its neutral"),
    ],
)
def test_problems_it_cannot_serve_are_named(change: dict[str, object], reason: str) -> None:
    given = replace(PROBLEM, **change)
    assert reason in METHOD.unsupported(given)
    with pytest.raises(UnsupportedProblem, match=reason):
        METHOD.retarget(given, FRAMES)
    with pytest.raises(UnsupportedProblem, match="alm"):
        METHOD.prepare(given.pair).fit(given.examples, given.source_animation)(FRAMES)


def test_a_topology_without_a_template_is_not_served_by_the_second_step() -> None:
    assert "template" in replace(METHOD, anatomical=True).unsupported(PROBLEM)
    assert METHOD.unsupported(PROBLEM) is None


def test_calibration_needs_examples_left_to_build() -> None:
    assert "5 of 5 examples calibrate" in replace(METHOD, calibration=5).unsupported(PROBLEM)
    calibrated = fitted(replace(METHOD, calibration=2))
    assert calibrated.target.count == 3
    assert np.abs(calibrated.strengths - 1).max() > 1e-3


def test_strength_scales_the_motion_of_a_patch() -> None:
    double = fitted()
    plain, strong = double(FRAMES).frames, double(FRAMES, {"patch_weights": dict.fromkeys(range(20), 2.0)}).frames
    np.testing.assert_allclose(strong - PROBLEM.target_neutral, 2 * (plain - PROBLEM.target_neutral), atol=1e-9)
    still = double(FRAMES, {"patch_weights": dict.fromkeys(range(20), 0.0)}).frames
    np.testing.assert_allclose(still, np.repeat(PROBLEM.target_neutral[None], 2, axis=0), atol=1e-9)


def test_a_shape_that_is_not_wanted_is_used_less() -> None:
    method = fitted(replace(METHOD, lambda_reg=1e-2))
    used = []
    for gamma in (1.0, 0.3, 0.0):
        patches, _ = method._directed({"shape_preferences": {0: gamma}})
        used.append(np.abs(patches(FRAMES).alpha[:, :, 0]).sum())
    assert used[0] > used[1] > used[2] == 0
    by_region = method(FRAMES, {"shape_preferences": {"cranium": {0: 0.0}}}).frames
    assert np.isfinite(by_region).all()


@pytest.mark.parametrize(
    ("edits", "message"),
    [
        ({"shape_preferences": {0: 1.5}}, "from 0 to 1"),
        ({"shape_preferences": {9: 0.5}}, "one of the 5 examples"),
        ({"shape_preferences": {99: {0: 0.5}}}, "one of the 20 patches"),
        ({"shape_preferences": {"craniun": {0: 0.5}}}, "cranium"),
        ({"shape_preferences": [0.5]}, "expected a mapping"),
        ({"patch_weights": {0: -1.0}}, "patch_weights"),
        ({"gravity": [0, 0, 0]}, "gravity"),
    ],
)
def test_edits_out_of_range_are_refused(edits: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        fitted()(FRAMES, edits)


@pytest.mark.parametrize(("change", "message"), [({"rings": -1}, "rings"), ({"calibration": -1}, "calibration")])
def test_settings_out_of_range_are_refused(change: dict[str, int], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        replace(METHOD, **change)
