"""Scan noise: its length, its spectrum, and that it depends on names alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import kv

from retarget.check import InvalidInput
from retarget.types import FloatArray
from synth_data.dataset import Dataset
from synth_data.noise import SMOOTH, ScanNoise, check_noise
from tests.experiments.toy import Toy, toy


def noisy(amount: float) -> Toy:
    data = toy()
    return replace(data, conditions=replace(data.conditions, noise_mm=amount))


def added(data: Dataset, indices: list[int]) -> FloatArray:
    return data.scanned("a", indices) - data.frames("a", indices)


def rms(noise: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(noise**2, axis=-1))))


def test_the_rms_length_per_vertex_is_what_it_says() -> None:
    for amount in (0.1, 0.3):
        data = noisy(amount)
        for i in range(4):
            assert rms(added(data, [i])[0]) == pytest.approx(amount, rel=0.05)
        assert rms(data.scanned_neutral("a") - data.neutral("a")) == pytest.approx(amount, rel=0.05)


def test_half_of_the_variance_is_smooth_and_half_white() -> None:
    """Two implicit steps of heat make white noise on a plane a Matern field of nu = 3: its covariance is known."""
    data = toy(subdivisions=4)
    neutral, edges = data.neutral("a"), data.faces[:, :2]
    make = ScanNoise("a", neutral, data.faces)
    steps = [noise[edges[:, 0]] - noise[edges[:, 1]] for noise in (make(f"scan {i}") for i in range(4))]
    x = np.linalg.norm(neutral[edges[:, 0]] - neutral[edges[:, 1]], axis=1) / (SMOOTH / 2)
    together = x**3 * kv(3, x) / 8  # of the smooth half; the white one has none
    assert rms(np.stack(steps)) == pytest.approx(np.sqrt(np.mean(2 * (1 - 0.5 * together))), rel=0.04)


def test_more_noise_is_the_same_noise_scaled() -> None:
    np.testing.assert_allclose(added(noisy(0.3), [2, 5]), 3 * added(noisy(0.1), [2, 5]), rtol=0, atol=1e-12)


def test_noise_depends_on_names_alone() -> None:
    data = noisy(0.3)
    nothing = np.zeros((3, 642, 3))
    together, alone = data.as_scanned("b", ["x", "y", "z"], nothing), data.as_scanned("b", ["y"], nothing[:1])
    np.testing.assert_array_equal(together[1], alone[0])
    np.testing.assert_array_equal(noisy(0.3).as_scanned("b", ["y"], nothing[:1]), alone)
    every = [*added(data, [0, 1]), data.scanned_neutral("a") - data.neutral("a")]
    every.append(data.scanned("b", [0])[0] - data.frames("b", [0])[0])
    for i in range(len(every)):
        for j in range(i):
            assert rms(every[i] - every[j]) == pytest.approx(0.3 * np.sqrt(2), rel=0.2)  # unrelated


def test_names_that_join_to_the_same_word_differ() -> None:
    data = toy()
    one, two = (ScanNoise(person, data.neutral("a"), data.faces) for person in ("ab", "a"))
    assert not np.allclose(one("c"), two("bc"))


def test_without_noise_scans_are_the_truth_bit_for_bit() -> None:
    data = toy()
    np.testing.assert_array_equal(data.scanned("a", [3, 0]), data.frames("a", [3, 0]))
    np.testing.assert_array_equal(data.scanned_neutral("a"), data.neutral("a"))
    assert data.scanned("a", []).shape == noisy(0.3).scanned("a", []).shape == (0, 642, 3)


def test_the_truth_has_no_noise() -> None:
    np.testing.assert_array_equal(noisy(0.3).frames("a", [3, 0]), toy().frames("a", [3, 0]))
    np.testing.assert_array_equal(noisy(0.3).neutral("a"), toy().neutral("a"))


@pytest.mark.parametrize("amount", [-0.1, float("nan"), float("inf"), "much", None, True])
def test_what_is_no_length_is_refused(amount: object) -> None:
    with pytest.raises(InvalidInput, match=r"dataset\.noise_mm: expected millimetres from 0 on"):
        check_noise("dataset.noise_mm", amount)
