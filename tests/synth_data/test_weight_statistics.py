"""Statistics of weights, on motions whose values are known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from retarget.check import InvalidInput
from retarget.types import FloatArray
from synth_data.arkit import NAMES, SKIN_NAMES
from synth_data.conversation import conversation
from synth_data.live_link import read_live_link
from synth_data.recording import ROTATIONS, Recording
from synth_data.weight_statistics import correlations, dimensions, main, spectrum, statistics, unexplained

ROOT = Path(__file__).parents[2]
REAL = ROOT / ".." / "shared" / "data" / "livelink" / "alex_rom_3.csv"
STORED = ROOT / "docs" / "data" / "recording_statistics.json"


def take(fps: float, seconds: float, **units: FloatArray) -> Recording:
    times = np.arange(round(fps * seconds)) / fps
    weights = np.zeros((len(times), len(NAMES)))
    for name, values in units.items():
        weights[:, NAMES.index(name)] = values
    none = np.zeros(len(times), dtype=bool)
    return Recording("made", times, weights, np.zeros((len(times), len(ROTATIONS))), none, none)


@pytest.mark.parametrize("fps", [30.0, 60.0])
def test_figures_by_hand_at_any_rate(fps: float) -> None:
    t = np.arange(round(40 * fps)) / fps
    sine, blink = 0.5 + 0.4 * np.sin(2 * np.pi * 2.5 * t), np.where(t % 4 > 3.5, 1.0, 0.0)
    found = statistics(
        take(fps, 40, jawOpen=sine, mouthSmileLeft=sine, mouthSmileRight=sine, eyeBlinkLeft=blink, eyeBlinkRight=blink)
    )
    assert found["blinks"] == pytest.approx(15, abs=0.1)
    assert found["share at zero"] == pytest.approx((46 + 2 * 7 / 8) / 51, abs=0.002)
    assert found["active units"] == 3
    assert found["dimensions, 99 %"] == 2
    assert found["coupled pairs"] == 2  # the jaw with either corner; the two corners are one unit's sides
    assert found["speed, 99 %"] == pytest.approx(0.4 * 2 * np.pi * 2.5, rel=0.05)
    assert found["speed, median"] == 0
    assert found["half the power below"] == pytest.approx(2.5, abs=0.2)


def test_a_still_take_has_zeros_and_no_nan() -> None:
    found = statistics(take(30, 10, jawOpen=np.full(300, 0.5)))
    assert np.isfinite(list(found.values())).all()
    assert (found["active units"], found["active units, from rest"], found["mean |r|"]) == (1, 0, 0)


def test_correlations_agree_with_numpy_and_opposites_are_negative() -> None:
    weights = np.random.default_rng(0).random((50, 51))
    np.testing.assert_allclose(correlations(weights), np.corrcoef(weights.T), atol=1e-12)
    weights[:, 1] = 1 - weights[:, 0]
    assert correlations(weights)[0, 1] == pytest.approx(-1)


def test_spectrum_of_a_take_with_dropped_frames() -> None:
    whole = take(30, 40, jawOpen=0.5 + 0.4 * np.sin(2 * np.pi * np.arange(1200) / 20))  # 1.5 Hz
    kept = np.r_[:700, 700:1200:2]
    part = replace(whole, times=whole.times[kept], weights=whole.weights[kept])
    frequency, power = spectrum(part)
    assert frequency[np.argmax(power)] == pytest.approx(1.5, abs=0.07)
    assert power[frequency > 2.5].sum() < 1e-3 * power.sum()


def test_dimensions_count_components() -> None:
    rng = np.random.default_rng(0)
    weights = rng.normal(size=(400, 4)) @ np.linalg.qr(rng.normal(size=(51, 4)))[0].T
    assert dimensions(weights) == (4, 4)
    gram = np.diag([1e6] + [1.0] * 50)  # one unit moves everything
    assert dimensions(rng.random((400, 51)), gram) == (1, 1)
    assert dimensions(np.ones((5, 51))) == (0, 0)
    # variances 94, 4 and 2 %
    axes = np.zeros((6, 51))
    axes[[0, 1, 2, 3, 4, 5], [0, 0, 1, 1, 2, 2]] = np.repeat(np.sqrt([94, 4, 2]), 2) * np.tile([1, -1], 3)
    assert dimensions(axes) == (2, 3)


def test_unexplained_motion_by_hand() -> None:
    """Four axes, each three times: what is no example lies on an axis that some example has, or has no share of it."""
    rows = np.tile(np.eye(51)[:4], (3, 1))
    gram = np.diag(np.arange(1.0, 52))
    assert unexplained(rows, gram, 11) == pytest.approx(0, abs=1e-9)
    alone = unexplained(rows[:4], np.eye(51), 1)  # one of four axes is never the others
    assert alone == pytest.approx(1)
    diagonal = np.zeros((2, 51))
    diagonal[0, 0], diagonal[1, :2] = 1, [0.6, 0.8]
    assert unexplained(diagonal, np.eye(51), 1) == pytest.approx(0.8)
    for examples in (0, 12):
        with pytest.raises(InvalidInput, match="examples: expected 1 to 11 of 12 rows"):
            unexplained(rows, gram, examples)


@pytest.mark.skipif(not REAL.is_file(), reason="the recording ../shared/data/livelink/alex_rom_3.csv is not here")
def test_the_stored_statistics_are_those_of_the_recording() -> None:
    stored = json.loads(STORED.read_text())
    found = statistics(read_live_link(REAL))
    assert found == pytest.approx(stored["statistics"], rel=1e-3, abs=1e-4)
    np.testing.assert_allclose(stored["correlations"], correlations(read_live_link(REAL).skin), atol=0.0051)


def test_more_examples_explain_more() -> None:
    weights = conversation(60).skin[::10]
    shares = [unexplained(weights, np.eye(51), k, draws=5) for k in (2, 5, 15, 30)]
    assert shares == sorted(shares, reverse=True)
    assert len(SKIN_NAMES) == 51


def test_the_command_compares_with_the_conversation(capsys: pytest.CaptureFixture[str]) -> None:
    main([])
    printed = capsys.readouterr().out
    assert "conversation" in printed
    assert len(printed.splitlines()) == 15
