"""Example-based facial rigging as a retargeting method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baselines.ebfr import ExampleBasedRetargeting
from retarget.check import UnsupportedProblem
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from retarget.rig.ebfr import ExampleBasedRigging, blending_weights
from retarget.types import RetargetProblem
from tests.experiments.toy import toy

DATA = toy(identities=2)
SOURCE, TARGET = (DATA.frames(name, range(40)) for name in "ab")
METHOD = ExampleBasedRetargeting(beta_first=5e-3, beta_last=1e-3, alternations=2, lambda_reg=0.1)
TEST = slice(35, 40)


def problem(examples: int, animation: slice = slice(None)) -> RetargetProblem:
    return RetargetProblem(
        faces=DATA.faces,
        source_neutral=DATA.neutral("a"),
        target_neutral=DATA.neutral("b"),
        source_animation=SOURCE[animation],
        target_examples=TARGET[:examples],
        source_examples=SOURCE[:examples],
        regions=DATA.regions,
    )


def error(given: RetargetProblem) -> float:
    """mm"""
    return float(np.linalg.norm(METHOD.retarget(given, SOURCE[TEST]).frames - TARGET[TEST], axis=-1).mean())


@pytest.mark.parametrize("weighting", list(Weighting))
def test_without_examples_it_is_deformation_transfer(weighting: Weighting) -> None:
    given = problem(0)
    found = replace(METHOD, deformation_transfer=weighting).retarget(given, SOURCE[TEST])
    expected = DeformationTransfer.of(given.pair, weighting)(SOURCE[TEST])
    np.testing.assert_array_equal(found.frames, expected)
    np.testing.assert_array_equal(found.parts["deformation_transfer"], expected)


def test_examples_personalise_it() -> None:
    """By little: many frames share what an example asks for (section 4.2.2)."""
    errors = [error(problem(count)) for count in (0, 5, 10)]
    assert errors[1] < 0.95 * errors[0]
    assert errors[2] < 0.95 * errors[1]


def test_an_example_in_the_animation_does_not_explain_itself() -> None:
    """T without T_E: the animation with and without the examples is the same to the method."""
    with_them, without = (
        METHOD.retarget(problem(5, part), SOURCE[TEST]).frames for part in (slice(0, 40), slice(5, 40))
    )
    np.testing.assert_allclose(with_them, without, atol=1e-8)


def test_a_frame_of_the_animation_becomes_what_the_alternation_made_of_it() -> None:
    given = problem(5)
    rigging = ExampleBasedRigging(DeformationTransfer.of(given.pair, METHOD.deformation_transfer))
    generic, others = rigging.generic(SOURCE, METHOD), np.arange(40) >= 5
    moved = given.source_examples - given.source_neutral  # type: ignore[operator]
    prior, _ = blending_weights(generic.moved, moved, METHOD.ridge(METHOD.lambda_reg), used=others)
    done = rigging.alternate(generic, given.target_examples, prior, METHOD, others)
    made = rigging.corrected(generic, done.steps[-1][0], done.weights)[TEST]
    found = METHOD.retarget(given, SOURCE[TEST]).frames - given.target_neutral
    np.testing.assert_allclose(found, made, atol=1e-7)


def test_it_needs_no_correspondence() -> None:
    unknown = replace(problem(5), source_examples=None)
    assert error(problem(5)) < error(unknown) < 0.97 * error(problem(0))
    assert (
        METHOD.retarget(replace(unknown, source_animation=SOURCE[:0]), SOURCE[TEST]).frames.shape == SOURCE[TEST].shape
    )


def test_many_sets_of_examples_share_what_the_animation_needs() -> None:
    prepared = METHOD.prepare(problem(5).pair)
    first = prepared.fit(problem(5).examples, SOURCE)
    kept = prepared._generic(SOURCE)
    prepared.fit(problem(3).examples, SOURCE)
    assert prepared._generic(SOURCE.copy()) is kept
    assert prepared._generic(SOURCE[:9]) is not kept
    expected = METHOD.retarget(problem(5), SOURCE[TEST]).frames
    np.testing.assert_array_equal(first(SOURCE[TEST]).frames, expected)


def test_examples_that_do_not_move_are_a_reason() -> None:
    given = problem(2)
    still = replace(given, target_examples=np.repeat(given.target_neutral[None], 2, axis=0))
    with pytest.raises(UnsupportedProblem, match="none of the target's examples differs from its neutral"):
        METHOD.retarget(still, SOURCE[TEST])


def test_the_misfit_is_told_after_each_alternation() -> None:
    info = replace(METHOD, alternations=4).retarget(problem(5), SOURCE[TEST]).info[0]
    assert info.iterations == 4
    assert len(info.energy) == 3
    assert list(info.energy) == sorted(info.energy, reverse=True)
