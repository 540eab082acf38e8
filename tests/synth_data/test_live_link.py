"""Live Link Face CSV: what is read, by hand; what is repaired; what is refused, with file, line and mend."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retarget.check import InvalidInput
from synth_data.arkit import NAMES, SKIN_NAMES
from synth_data.live_link import read_live_link
from synth_data.recording import ROTATIONS, mirrored

REAL = Path(__file__).parents[2] / ".." / "shared" / "data" / "livelink" / "alex_rom_3.csv"
COLUMNS = [name[0].upper() + name[1:] for name in (*NAMES, *ROTATIONS)]
HEADER = ["Timecode", "BlendShapeCount", *COLUMNS]

Write = Callable[..., Path]


def row(timecode: str, **values: float | str) -> list[str]:
    return [timecode, "61", *(str(values.get(name, 0.0)) for name in COLUMNS)]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write(*rows: Sequence[str], header: Sequence[str] = HEADER, delimiter: str = ",", mark: str = "") -> Path:
        path = tmp_path / "take.csv"
        path.write_text(mark + "\n".join(delimiter.join(line) for line in (header, *rows)) + "\n", encoding="utf-8")
        return path

    return write


def weight(path: Path, name: str) -> list[float]:
    recording = read_live_link(path)
    return recording.weights[:, recording.names.index(name)].tolist()


def test_values_times_and_rotations_by_hand(write: Write) -> None:
    take = read_live_link(
        write(
            row("13:13:59:58.000", JawOpen=0.25, HeadYaw=-0.5),
            row("13:14:00:00.000", JawOpen=0.5, MouthLeft=0.125),
            row("13:14:00:02.500", TongueOut=1, RightEyeRoll=0.75),
        )
    )
    assert take.name == "take"
    np.testing.assert_allclose(take.times, [0, 2 / 60, 4.5 / 60])
    expected = np.zeros((3, 52))
    expected[[0, 1, 1, 2], [NAMES.index(n) for n in ("jawOpen", "jawOpen", "mouthLeft", "tongueOut")]] = [
        0.25, 0.5, 0.125, 1,
    ]  # fmt: skip
    np.testing.assert_array_equal(take.weights, expected)
    assert take.rotations[0].tolist() == [-0.5, 0, 0, 0, 0, 0, 0, 0, 0]
    assert take.rotations[2].tolist() == [0, 0, 0, 0, 0, 0, 0, 0, 0.75]
    assert take.skin[1, SKIN_NAMES.index("mouthLeft")] == 0.125
    assert not take.lost.any()
    assert not take.clipped.any()


def test_columns_go_by_name_in_any_order_and_spelling(write: Write) -> None:
    rows = [row("00:00:00:00", JawLeft=0.5, MouthRight=0.25), row("00:00:00:01", JawLeft=0.75)]
    plain = read_live_link(write(*rows))
    order = [0, 1, *(2 + np.random.default_rng(0).permutation(len(COLUMNS)))]
    camel = [name[0].lower() + name[1:] for name in COLUMNS]
    for header in (HEADER, ["Timecode", "BlendshapeCount", *COLUMNS], ["Timecode", "BlendShapeCount", *camel]):
        path = write(*([line[i] for i in order] for line in rows), header=[header[i] for i in order])
        shuffled = read_live_link(path)
        np.testing.assert_array_equal(shuffled.weights, plain.weights)
        np.testing.assert_array_equal(shuffled.rotations, plain.rotations)
    assert plain.weights[0, NAMES.index("jawLeft")] == 0.5
    assert plain.weights[0, NAMES.index("jawRight")] == 0


def test_byte_order_mark_windows_lines_and_blank_lines(write: Write) -> None:
    rows = [row("00:00:00:00", JawOpen=0.5), row("00:00:00:01")]
    path = write(*rows, mark="\ufeff")
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n") + b"\r\n")
    assert weight(path, "jawOpen") == [0.5, 0]


def test_lost_rows_lie_between_their_neighbours_in_time(write: Write) -> None:
    path = write(
        ["00:00:00:00.000", "0"],
        row("00:00:00:02.000", JawOpen=0.25),
        ["00:00:00:03.000", "0"],
        ["00:00:00:08.000", "0"],
        row("00:00:00:10.000", JawOpen=0.75),
        ["00:00:00:12.000", "0", *["0.0"] * 61],
    )
    take = read_live_link(path)
    assert take.lost.tolist() == [True, False, True, True, False, True]
    np.testing.assert_allclose(weight(path, "jawOpen"), [0.25, 0.25, 0.3125, 0.625, 0.75, 0.75])


def test_values_a_little_outside_are_clipped_and_told(write: Write) -> None:
    path = write(
        row("00:00:00:00", JawOpen=1.0033), row("00:00:00:01", JawOpen=-0.01, HeadYaw=-3), ["00:00:00:02", "0"]
    )
    take = read_live_link(path)
    assert weight(path, "jawOpen") == [1, 0, 0]
    assert take.clipped.tolist() == [True, True, False]
    assert take.rotations[1, 0] == -3
    said = "take: 3 rows, 1 lost, 2 clipped (values from -0.01 to 1.003); warning: most rows leave [0, 1]"
    assert take.summary.startswith(said)


def test_a_take_says_how_much_of_it_was_mended(write: Write) -> None:
    moving = [row(f"00:00:00:{k:02d}", JawOpen=0.1 * k) for k in range(4)]
    assert read_live_link(write(*moving)).summary == "take: 4 rows, 0 lost, 0 clipped"
    much = [*moving, row("00:00:00:04", JawOpen=1.24), row("00:00:00:05", JawLeft=-0.3)]
    assert read_live_link(write(*much)).summary == "take: 6 rows, 0 lost, 2 clipped (values from -0.3 to 1.24)"
    lost = [*moving, *([f"00:00:00:{k:02d}", "0"] for k in range(4, 9))]
    assert "9 rows, 5 lost, 0 clipped; warning: most rows are lost" in read_live_link(write(*lost)).summary


def test_weights_that_are_all_negative_are_refused(write: Write) -> None:
    with pytest.raises(
        InvalidInput, match=r"take\.csv: expected weights .* no weight is above 0 \(they reach from -0\.4 to 0"
    ):
        read_live_link(write(row("00:00:00:00", JawOpen=-0.4), row("00:00:00:01", JawOpen=-0.1)))


@pytest.mark.parametrize(("fps", "step"), [(30, 2), (60, 1)])
def test_rate_of_takes_whose_timecode_counts_60ths(write: Write, fps: int, step: int) -> None:
    rows = [row(f"23:59:{58 + k // 60:02d}:{k % 60:02d}.652") for k in range(0, 120, step)]
    rows += [row(f"00:00:{k // 60:02d}:{k % 60:02d}.652") for k in range(0, 90, step)]
    del rows[7:17]
    take = read_live_link(write(*rows))
    assert take.fps == fps
    np.testing.assert_allclose(take.times, np.delete(np.arange(0, 210, step), slice(7, 17)) / 60, atol=1e-9)


@pytest.mark.parametrize("rate", [24, 25, 30])
def test_frames_counted_at_another_rate_are_evenly_spaced(write: Write, rate: int) -> None:
    take = read_live_link(write(*(row(f"10:00:{k // rate:02d};{k % rate:02d}.00") for k in range(4 * rate))))
    np.testing.assert_allclose(take.times, np.arange(4 * rate) / rate, atol=1e-9)
    assert take.fps == rate


@pytest.mark.parametrize("first", [0, 17, 29])
@pytest.mark.parametrize("count", [8, 40])
@pytest.mark.parametrize(("rate", "step", "fps"), [(30, 1, 30), (60, 2, 30)])
def test_short_takes_are_as_long_whichever_way_frames_are_counted(
    write: Write, first: int, count: int, rate: int, step: int, fps: int
) -> None:
    """Whole frames: 30 in a second, or every second one of 60; within a second, or beyond its end."""
    at = [first // step * step + step * k for k in range(count)]
    take = read_live_link(write(*(row(f"10:00:{k // rate:02d}:{k % rate:02d}") for k in at)))
    np.testing.assert_allclose(take.times, np.arange(count) / fps, atol=1e-9)


def test_dropped_and_lost_rows_do_not_change_the_rate_of_a_short_take(write: Write) -> None:
    at = np.delete(np.arange(5, 55), [3, 4, 24, 25, 40])
    rows = [row(f"10:00:{k // 30:02d}:{k % 30:02d}") for k in at]
    rows[7:10] = [[*line[:1], "0"] for line in rows[7:10]]
    np.testing.assert_allclose(read_live_link(write(*rows)).times, (at - 5) / 30, atol=1e-9)


def test_one_motion_at_30_and_60_frames_per_second(write: Write) -> None:
    every = [row(f"00:00:0{k // 60}:{k % 60:02d}", JawOpen=round(0.5 + 0.4 * np.sin(k / 20), 6)) for k in range(181)]
    fast, slow = read_live_link(write(*every)), read_live_link(write(*every[::2]))
    assert (fast.fps, slow.fps) == (60, 30)
    np.testing.assert_allclose(fast.at(slow.times), slow.weights, atol=1e-12)
    np.testing.assert_allclose(slow.at(fast.times), fast.weights, atol=1e-3)
    assert slow.at([-1.0, 99.0])[:, NAMES.index("jawOpen")].tolist() == [0.5, slow.weights[-1, NAMES.index("jawOpen")]]


GOOD = row("00:00:00:00", JawOpen=0.5), row("00:00:00:01", JawOpen=0.25)


def without(column: str) -> tuple[list[str], list[list[str]]]:
    k = HEADER.index(column)
    return HEADER[:k] + HEADER[k + 1 :], [line[:k] + line[k + 1 :] for line in GOOD]


def renamed(old: str, new: str) -> tuple[list[str], list[list[str]]]:
    return [new if name == old else name for name in HEADER], list(GOOD)


@pytest.mark.parametrize("absent", [ROTATIONS, ROTATIONS[3:]])
def test_rotations_may_be_absent(write: Write, absent: tuple[str, ...]) -> None:
    """Blending weights do not need them; those that are there are read."""
    kept = [k for k, name in enumerate(HEADER) if name not in {name[0].upper() + name[1:] for name in absent}]
    rows = [row("00:00:00:00", JawOpen=0.5, HeadPitch=0.1), row("00:00:00:01", TongueOut=0.25, HeadPitch=0.2)]
    path = write(*([line[k] for k in kept] for line in rows), header=[HEADER[k] for k in kept])
    assert weight(path, "jawOpen") == [0.5, 0]
    assert weight(path, "tongueOut") == [0, 0.25]
    pitch = [0.0, 0.0] if "headPitch" in absent else [0.1, 0.2]
    np.testing.assert_array_equal(read_live_link(path).rotations, np.outer(pitch, np.eye(9)[1]))


@pytest.mark.parametrize(
    ("header", "rows", "message"),
    [
        (*without("JawOpen"), r"line 1: .* 1 columns are missing: JawOpen\. Mend the header"),
        (*renamed("JawOpen", "JawOpne"), r"line 1: .* unknown JawOpne\. Did you mean 'JawOpen'\?"),
        (*renamed("JawOpen", "JawLeft"), r"line 1: .* named twice: JawLeft"),
        ([*HEADER, ""], list(GOOD), r"line 1: .* 1 columns are unknown \(no name\)"),
        (HEADER[1:], [line[1:] for line in GOOD], r"line 1: expected a header that begins with Timecode,Blend"),
        (GOOD[0], GOOD[1:], r"line 1: expected a header that begins with Timecode"),
        ([""], [], r"line 1"),
        (HEADER, [], r"expected rows of weights below the header, found none"),
        (HEADER, [["00:00:00:00", "0"], ["00:00:00:01", "0"]], r"got 0 of 2 .* with the face in view"),
        (HEADER, [GOOD[0], ["00:00:00:01", "0"]], r"at least two rows with a tracked face, got 1 of 2"),
        (HEADER, [GOOD[0], GOOD[1][:40]], r"line 3: expected 63 values .* got 40; .* delete the line"),
        (HEADER, [GOOD[0], [*GOOD[1], "0.5"]], r"line 3: expected 63 values .* got 64"),
        (HEADER, [GOOD[0], row("00:00:00:01", JawOpen="NaN")], r"line 3: .* a number for JawOpen, got 'NaN'; mend or"),
        (HEADER, [row("00:00:00:01", MouthLeft="")], r"line 2: .* a number for MouthLeft, got ''"),
        (HEADER, [row("00:00:00:01", HeadYaw="inf")], r"line 2: .* a number for HeadYaw, got 'inf'"),
        (HEADER, [row("00:00:00:01", HeadYaw="much")], r"line 2: .* a number for HeadYaw, got 'much'"),
        (HEADER, [GOOD[0], row("00:00:00:01", JawOpen=87)], r"line 3: JawOpen is 87, expected about 0 to 1; divide"),
        (HEADER, [*GOOD, row("00:00:00:03", JawOpen=-4)], r"line 4: JawOpen is -4"),
        (HEADER, [GOOD[0], row("1.5 s")], r"line 3: expected a timecode HH:MM:SS:FF\.fff, got '1\.5 s'"),
        (HEADER, [GOOD[0], row("00:00:00:61")], r"line 3: expected a timecode"),
        (HEADER, [*GOOD, GOOD[0]], r"line 4: expected a timecode later than .* two takes"),
        (HEADER, [*GOOD, GOOD[1]], r"line 4: expected a timecode later than"),
    ],
)
def test_bad_files_are_refused(write: Write, header: list[str], rows: list[list[str]], message: str) -> None:
    with pytest.raises(InvalidInput, match=message) as refused:
        read_live_link(write(*rows, header=header))
    assert "take.csv" in str(refused.value)


@pytest.mark.parametrize(("delimiter", "shown"), [(";", "';'"), ("\t", r"'\\t'"), ("|", r"'\|'")])
def test_another_delimiter_is_named(write: Write, delimiter: str, shown: str) -> None:
    with pytest.raises(InvalidInput, match=f"line 1: expected columns separated by commas, got {shown}; save"):
        read_live_link(write(*GOOD, delimiter=delimiter))


def test_files_that_are_no_text_empty_or_missing(tmp_path: Path) -> None:
    path = tmp_path / "take.csv"
    with pytest.raises(InvalidInput, match="found none; check the path"):
        read_live_link(path)
    with pytest.raises(InvalidInput, match="found none; check the path"):
        read_live_link(tmp_path)
    path.write_bytes(b"")
    with pytest.raises(InvalidInput, match="expected a header in line 1"):
        read_live_link(path)
    path.write_bytes(bytes(range(256)) * 9)
    with pytest.raises(InvalidInput, match="expected a CSV file of text in UTF-8"):
        read_live_link(path)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_a_damaged_file_is_read_or_refused_but_never_crashes(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Bytes exchanged anywhere: finite weights in [0, 1], or InvalidInput."""
    text = "\n".join(",".join(line) for line in (HEADER, *GOOD, row("00:00:00:02", JawOpen=0.1))).encode()
    damaged = bytearray(text[: data.draw(st.integers(0, len(text)))] + b"\n")
    for _ in range(data.draw(st.integers(0, 3))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("csv") / "damaged.csv"
    path.write_bytes(damaged)
    with contextlib.suppress(InvalidInput):
        take = read_live_link(path)
        assert 0 <= take.weights.min() <= take.weights.max() <= 1
        assert np.isfinite(take.rotations).all()
        assert (np.diff(take.times) > 0).all()


@pytest.mark.skipif(not REAL.is_file(), reason="the recording ../shared/data/livelink/alex_rom_3.csv is not here")
def test_a_real_recording() -> None:
    take = read_live_link(REAL)
    assert take.weights.shape == (4030, 52)
    assert take.fps == 30
    assert take.times[-1] == pytest.approx(134.4, abs=0.1)
    assert take.clipped.sum() > 0
    assert take.weights.max() == 1
    assert not take.lost.any()
    at_rest = np.median(take.weights, axis=0)
    assert at_rest[NAMES.index("eyeLookDownLeft")] == pytest.approx(0.39, abs=0.005)
    assert at_rest[NAMES.index("eyeBlinkLeft")] == pytest.approx(0.28, abs=0.005)
    assert take.weights[:, NAMES.index("jawLeft")].max() < 0.3


def test_mirroring_exchanges_the_sides_by_name() -> None:
    weights = np.zeros((1, 51))
    weights[0, [SKIN_NAMES.index("mouthSmileLeft"), SKIN_NAMES.index("jawRight")]] = [0.25, 0.5]
    weights[0, [SKIN_NAMES.index("jawOpen"), SKIN_NAMES.index("mouthLeft")]] = [0.75, 1.0]
    other = mirrored(weights)[0]
    expected = {"mouthSmileRight": 0.25, "jawLeft": 0.5, "jawOpen": 0.75, "mouthRight": 1.0}
    assert {name: float(w) for name, w in zip(SKIN_NAMES, other, strict=True) if w} == expected
    np.testing.assert_array_equal(mirrored(mirrored(weights)), weights)
    assert mirrored(np.arange(52.0), NAMES)[NAMES.index("tongueOut")] == NAMES.index("tongueOut")
