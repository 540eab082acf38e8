"""The dataset as studies see it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from retarget.check import InvalidInput, check_frames, check_triangle_areas
from synth_data.arkit import NAMES, SKIN_NAMES
from synth_data.live_link import read_live_link
from synth_data.makehuman.dataset import MakeHuman
from synth_data.performed import PerformedDataset
from synth_data.recording import ROTATIONS


@pytest.fixture(scope="module")
def data() -> PerformedDataset:
    return MakeHuman(identities=2, expressions=12, truth="personal_blendshapes", weights="sparse").load()


def test_what_a_study_reads(data: PerformedDataset) -> None:
    assert data.identities == ("person-000", "person-001")
    assert len(data.expressions) == 12
    assert (data.conditions.dataset, data.conditions.truth, data.conditions.weights) == (
        "makehuman",
        "personal_blendshapes",
        "sparse",
    )
    assert "LBS becomes exact" in data.favours
    assert data.frames("person-001", []).shape == (0, 4328, 3)


def test_all_frames_pass_the_checks_of_the_library(data: PerformedDataset) -> None:
    for identity in data.identities:
        frames = check_frames(identity, data.frames(identity, range(12)), len(data.neutral(identity)))
        for index, frame in enumerate(frames):
            check_triangle_areas(f"{identity} {index}", frame, data.faces)
        assert np.linalg.norm(frames - data.neutral(identity), axis=-1).max(axis=1).min() > 1  # mm: each one moves


def test_truth_is_linear_in_the_weights(data: PerformedDataset) -> None:
    perform = data.performers["person-000"]
    rest = perform(np.zeros((1, 51)))[0]
    a, b = data.weights[:2] / 2
    both = perform(np.array([a, b, a + b]))
    np.testing.assert_allclose(rest, data.neutral("person-000"), atol=1e-12)
    np.testing.assert_allclose(both[2] - rest, (both[0] - rest) + (both[1] - rest), atol=1e-9)


def test_cranium_is_stable(data: PerformedDataset) -> None:
    cranium = data.regions.vertices["cranium"]
    motion = data.frames("person-000", range(12))[:, cranium] - data.neutral("person-000")[cranium]
    assert np.linalg.norm(motion, axis=-1).mean() < 0.1


def test_identities_and_frames_do_not_depend_on_how_many_are_asked_for(data: PerformedDataset) -> None:
    """Nor on how many cores there are: the same bits."""
    settings = MakeHuman(identities=1, first_seed=1, expressions=5, truth="personal_blendshapes", weights="sparse")
    with threadpool_limits(limits=2):
        alone = settings.load()
        frame = alone.frames("person-001", [3])[0]
    np.testing.assert_array_equal(alone.neutral("person-001"), data.neutral("person-001"))
    np.testing.assert_array_equal(frame, data.frames("person-001", [1, 3, 2])[1])


def test_fingerprint_follows_the_settings_that_decide_frames() -> None:
    settings = MakeHuman()
    same = dataclasses.replace(settings, wheel="/elsewhere.whl", cache="/elsewhere", identities=5, first_seed=9)
    assert same._fingerprint() == settings._fingerprint()
    changes: tuple[dict[str, Any], ...] = ({"expressions": 9}, {"expression_seed": 1}, {"subdivisions": 1})
    prints = {dataclasses.replace(settings, **change)._fingerprint() for change in changes}
    assert len(prints | {settings._fingerprint()}) == 4


def test_weights_of_a_recording_name_it_and_follow_what_is_in_it(tmp_path: Path) -> None:
    """Its path is no part of the fingerprint."""
    columns = [name[0].upper() + name[1:] for name in (*NAMES, *ROTATIONS)]

    def write(folder: str, *smiles: float) -> Path:
        path = tmp_path / folder / "take_7.csv"
        path.parent.mkdir()
        rows = ([str(smile * (name == "MouthSmileLeft")) for name in columns] for smile in smiles)
        lines = (["Timecode", "BlendShapeCount", *columns], *([f"0:0:0:{i}", "61", *row] for i, row in enumerate(rows)))
        path.write_text("\n".join(map(",".join, lines)))
        return path

    path, same, other = write("a", 0, 0.5, 1, 0.25), write("b", 0, 0.5, 1, 0.25), write("c", 0, 0.5, 0.75, 0.25)
    settings = MakeHuman(
        identities=1, expressions=3, truth="personal_blendshapes", weights="recorded", recording=str(path)
    )
    said: list[str] = []
    data = settings.load(said.append)
    assert sorted(data.weights[:, SKIN_NAMES.index("mouthSmileLeft")]) == [0.25, 0.5, 1.0]
    assert (data.conditions.weights, data.expressions[0]) == ("recorded:take_7", "recorded-000")
    assert data.favours.endswith("The expressions come from the recording take_7: 4 rows, 0 lost, 0 clipped.")
    assert "recording take_7: 4 rows, 0 lost, 0 clipped" in said
    assert data.fingerprint == settings._fingerprint(read_live_link(same))
    assert len({data.fingerprint, settings._fingerprint(read_live_link(other)), settings._fingerprint()}) == 3
    with pytest.raises(InvalidInput, match="uses no recording, got 'take_7'"):
        dataclasses.replace(settings, weights="sparse").load()


def test_subdivision_refines_faces_regions_and_frames_alike(data: PerformedDataset) -> None:
    fine = MakeHuman(identities=1, expressions=2, subdivisions=1, truth="personal_blendshapes", weights="sparse").load()
    n = len(fine.neutral("person-000"))
    assert n == 17263
    assert len(fine.faces) == 4 * len(data.faces)
    assert fine.frames("person-000", [0, 1]).shape == (2, n, 3)
    assert all(members.max() < n for members in fine.regions.vertices.values())
    assert len(fine.regions.vertices["head"]) > 3 * len(data.regions.vertices["head"])
    coarse = data.neutral("person-000")
    assert np.linalg.norm(fine.neutral("person-000")[: len(coarse)] - coarse, axis=1).mean() < 1  # mm of smoothing


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"identities": 0}, "dataset.identities: expected a whole number of at least 1, got 0"),
        ({"first_seed": -1}, "dataset.first_seed"),
        ({"expressions": 0}, "dataset.expressions"),
        ({"expressions": 2.5}, "dataset.expressions"),
        ({"subdivisions": 3}, "dataset.subdivisions: expected 0"),
        ({"truth": "personal_blendshape"}, "Did you mean 'personal_blendshapes'"),
        ({"weights": "record"}, "dataset.weights: 'record' is unknown, expected one of sparse, recombined, recorded"),
        ({"recording": "/no/such/take.csv", "weights": "recorded"}, "take.csv: expected a CSV file of Live Link Face"),
        ({"recording": 5}, "dataset.recording: expected the path of a Live Link Face CSV, or null, got 5"),
        ({"recording": 300 * "x", "weights": "recorded"}, "xxx: expected a CSV file of Live Link Face, found none"),
        ({"cache": True}, "dataset.cache: expected the path of a folder, or null, got True"),
        ({"wheel": 5}, "dataset.wheel: expected the path of a wheel file, or null, got 5"),
        ({"truth": None}, "dataset.truth: expected one of additive, .*, personal_blendshapes, got None"),
        ({"weights": 3}, "dataset.weights: expected one of sparse, recombined, recorded, got 3"),
        ({"expressions": True}, "dataset.expressions: expected a whole number of at least 1, got True"),
        ({"wheel": "/no/such/file.whl"}, "does not exist"),
    ],
)
def test_settings_out_of_range_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        MakeHuman(**settings).load()


def test_unknown_identities_and_expressions_are_refused(data: PerformedDataset) -> None:
    with pytest.raises(InvalidInput, match="identity: 'nobody' is unknown, expected one of person-000"):
        data.neutral("nobody")
    with pytest.raises(InvalidInput, match="expected indices from 0 to 11, got 3 to 12"):
        data.frames("person-000", [3, 12])
