"""The conversation-like performance: the same motion at any rate, smooth, possible, in the pace that it promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import welch

from retarget.check import InvalidInput
from retarget.types import FloatArray
from synth_data.arkit import NAMES, SKIN_NAMES
from synth_data.conversation import _follow, accompanied, conversation
from synth_data.recording import Recording, mirrored
from synth_data.sequence import EXCLUSIVE


@pytest.fixture(scope="module")
def take() -> Recording:
    return conversation(120, fps=60, seed=3)


def unit(take: Recording, name: str) -> FloatArray:
    return take.skin[:, SKIN_NAMES.index(name)]


def test_seed_decides_to_the_bit(take: Recording) -> None:
    np.testing.assert_array_equal(conversation(120, fps=60, seed=3).weights, take.weights)
    assert not np.array_equal(conversation(120, fps=60, seed=4).weights, take.weights)


def test_half_the_rate_is_every_second_frame(take: Recording) -> None:
    slow = conversation(120, fps=30, seed=3)
    assert (slow.fps, take.fps) == (30, 60)
    np.testing.assert_array_equal(slow.times, take.times[::2])
    np.testing.assert_array_equal(slow.weights, take.weights[::2])


@settings(max_examples=10, deadline=None)
@given(seconds=st.floats(0.1, 20), fps=st.sampled_from([24.0, 30.0, 60.0]), seed=st.integers(0, 1000))
def test_any_take_is_a_beginning_in_range_from_rest(seconds: float, fps: float, seed: int) -> None:
    short, long = conversation(seconds, fps, seed), conversation(seconds + 5, fps, seed)
    # the length of an array decides how its last digit is rounded
    np.testing.assert_allclose(short.weights, long.weights[: len(short.weights)], rtol=0, atol=1e-12)
    assert len(short.times) == round(seconds * fps)
    assert 0 <= long.weights.min() <= long.weights.max() <= 1
    assert (long.weights[0] == 0).all()


def test_possible_faces_and_still_tongue(take: Recording) -> None:
    for names in EXCLUSIVE:
        assert sum(unit(take, name) for name in names).max() <= 1 + 1e-12  # type: ignore[union-attr]
    assert (unit(take, "mouthClose") <= unit(take, "jawOpen")).all()
    assert (take.weights[:, NAMES.index("tongueOut")] == 0).all()
    assert not take.lost.any()
    assert not take.clipped.any()


def test_every_blink_shuts_the_eye_whatever_it_does() -> None:
    take = conversation(60, fps=240, seed=3)
    lid = unit(take, "eyeBlinkLeft")
    edges = np.flatnonzero(np.diff(np.r_[0, lid > 0.4, 0]))
    peaks = [lid[start:end].max() for start, end in edges.reshape(-1, 2)]
    assert len(peaks) > 10
    assert min(peaks) >= 0.84
    others = sum(unit(take, f"eye{name}Left") for name in ("Wide", "Squint", "LookDown"))
    assert (lid + others)[lid > 0.84].max() < 1.2  # type: ignore[index]


def test_nothing_jumps() -> None:
    """At ten times the rate a step is a tenth: a jump would stay."""
    coarse, fine = (np.abs(np.diff(conversation(6, fps, seed=3).skin, axis=0)).max() for fps in (200, 2000))
    assert fine < 0.15 * coarse
    assert coarse < 1.875 / 0.05 / 200  # the fastest gaze at the middle of its way


def test_minimum_jerk_by_hand() -> None:
    """Half way at half time, 10 / 4^3 - 15 / 4^4 + 6 / 4^5 at a quarter, then held."""
    target = np.zeros(51)
    target[[SKIN_NAMES.index("jawOpen"), SKIN_NAMES.index("cheekSquintLeft")]] = [0.8, 0.4]
    way = _follow(np.array([0.0, 0.5, 1.0, 2.0, 2.5, 3.0, 4.0]), iter([(target, 2.0, 1.0), (np.zeros(51), 1.0, 9.0)]))
    expected = np.array([0, 0.103515625, 0.5, 1, 1, 1, 0])
    np.testing.assert_allclose(way[:, SKIN_NAMES.index("jawOpen")], 0.8 * expected, atol=1e-15)
    np.testing.assert_allclose(way[:, SKIN_NAMES.index("cheekSquintLeft")], 0.4 * expected, atol=1e-15)
    assert np.count_nonzero(way.any(axis=0)) == 2


def test_companions_by_hand_in_range_and_mirrored() -> None:
    def face(**units: float) -> FloatArray:
        return np.array([[units.get(name, 0.0) for name in SKIN_NAMES]])

    opened = face(jawOpen=0.5, mouthStretchLeft=0.2)
    expected = face(
        jawOpen=0.5,
        mouthStretchLeft=1 - 0.8 * 0.8,  # its own 0.2, and 0.4 x 0.5 brought along
        mouthStretchRight=0.2,
        mouthLowerDownLeft=0.25,
        mouthLowerDownRight=0.25,
    )
    np.testing.assert_allclose(accompanied(opened), expected, atol=1e-15)
    pressed = accompanied(face(mouthPressRight=0.6))
    np.testing.assert_allclose(
        pressed, face(mouthPressRight=0.6, mouthDimpleRight=0.3, mouthShrugLower=0.21), atol=1e-15
    )
    faces = np.random.default_rng(0).uniform(0, 1, (50, 51))
    np.testing.assert_allclose(accompanied(mirrored(faces)), mirrored(accompanied(faces)), atol=1e-12)
    assert (accompanied(faces) >= faces - 1e-15).all()
    strong = accompanied(face(mouthSmileLeft=1, noseSneerLeft=1, browDownLeft=1))
    assert strong[0, SKIN_NAMES.index("cheekSquintLeft")] == 1  # of 0.3 + 0.6 + 0.2
    assert not accompanied(np.zeros((1, 51))).any()


def test_pace_of_speech_and_blinks() -> None:
    """Blinks 15 to 30 a minute that close faster than they open; while someone talks the jaw moves at 2 to 7 Hz."""
    take = conversation(300, seed=0)
    lid, jaw = unit(take, "eyeBlinkLeft"), unit(take, "jawOpen")
    shut = lid > 0.5
    assert 15 < np.count_nonzero(shut[1:] & ~shut[:-1]) / 5 < 30
    assert np.diff(lid).max() > 1.5 * -np.diff(lid).min()
    frequency, power = welch(jaw, fs=30, nperseg=120)
    band, around = power[(frequency > 2) & (frequency < 7)], power[(frequency > 9)]
    assert frequency[1:][np.argmax((power * frequency)[1:])] == pytest.approx(3.5, abs=1.5)
    assert band.mean() > 20 * around.mean()


def test_it_rests_and_uses_the_whole_face() -> None:
    weights = conversation(600, seed=0).skin
    assert (weights.max(axis=1) < 0.02).mean() > 0.02
    assert np.count_nonzero(weights.max(axis=0) > 0.1) >= 49
    assert 2 <= np.median((weights > 0.1).sum(axis=1)) <= 8


@pytest.mark.parametrize(("seconds", "fps"), [(0, 30), (-1, 30), (1, 0), (1e-3, 30), (np.inf, 30), (1, np.nan)])
def test_takes_without_a_row_are_refused(seconds: float, fps: float) -> None:
    with pytest.raises(InvalidInput, match="conversation: expected a positive length"):
        conversation(seconds, fps)
