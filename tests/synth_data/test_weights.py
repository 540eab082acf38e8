"""The three sources of blending weights behind one interface."""

from __future__ import annotations

import numpy as np
import pytest

from retarget.check import InvalidInput
from retarget.types import FloatArray
from synth_data.arkit import MIRRORED, NAMES, SKIN_NAMES
from synth_data.recording import ROTATIONS, Recording, mirrored
from synth_data.sequence import EXCLUSIVE, sparse_weights
from synth_data.weights import REGIONS, SOURCES, _recombinations, blending_weights


def take(skin: FloatArray, lost: tuple[int, ...] = ()) -> Recording:
    weights = np.zeros((len(skin), len(NAMES)))
    weights[:, [NAMES.index(name) for name in SKIN_NAMES]] = skin
    is_lost = np.isin(np.arange(len(skin)), lost)
    still = np.zeros((len(skin), len(ROTATIONS)))
    return Recording("made", np.arange(len(skin)) / 30, weights, still, is_lost, np.zeros(len(skin), dtype=bool))


@pytest.mark.parametrize("source", SOURCES)
def test_every_source_is_in_range_varied_and_seeded(source: str) -> None:
    weights = blending_weights(source, 60, seed=2)
    assert weights.shape == (60, 51)
    assert 0 <= weights.min() <= weights.max() <= 1
    assert weights.max(axis=1).min() >= 0.1 - 0.09 * (source == "sparse")
    distance = np.abs(weights[:, None] - weights[None]).max(axis=-1)
    assert distance[np.triu_indices(60, 1)].min() >= 0.02
    np.testing.assert_array_equal(blending_weights(source, 9, seed=2), weights[:9])
    assert not np.array_equal(blending_weights(source, 60, seed=3), weights)


def test_sparse_is_what_it_was() -> None:
    np.testing.assert_array_equal(blending_weights("sparse", 30, seed=1), sparse_weights(30, seed=1))


def test_recorded_takes_tracked_frames_that_move_each_once() -> None:
    skin = np.zeros((6, 51))
    skin[:, 0] = [0.0, 0.3, 0.31, 0.6, 0.9, 0.7]  # at rest, one frame, a near copy, one, lost, one
    orders = set()
    for seed in range(9):
        rows = blending_weights("recorded", 3, seed, take(skin, lost=(4,)))
        assert sorted(rows[:, 0].round(1).tolist()) == [0.3, 0.6, 0.7]
        assert (rows[:, 1:] == 0).all()
        orders.add(tuple(rows[:, 0]))
    assert len(orders) > 3
    with pytest.raises(InvalidInput, match="expected 4 different expressions, but 'made' has 3 among its 5 tracked"):
        blending_weights("recorded", 4, 0, take(skin, lost=(4,)))


def test_regions_part_the_skin_units_and_map_to_themselves_in_the_mirror() -> None:
    assert sorted(name for names in REGIONS.values() for name in names) == sorted(SKIN_NAMES)
    for names in REGIONS.values():
        assert {MIRRORED[name] for name in names} == set(names)


def test_recombined_regions_come_from_frames_or_their_mirror_image() -> None:
    """Frames of weights that identify them, too small to exclude one another or to be outdone by no gesture."""
    skin = np.random.default_rng(0).uniform(0.1, 0.45, (8, 51))
    frames = np.concatenate([skin, mirrored(skin)])
    draws = _recombinations(1, skin)
    seen: dict[str, set[int]] = {region: set() for region in REGIONS}
    plain = 0
    for row in (next(draws) for _ in range(400)):
        origin = {}
        for region, names in REGIONS.items():
            columns = [SKIN_NAMES.index(name) for name in names if name != "mouthClose"]
            match = np.flatnonzero((frames[:, columns] == row[columns]).all(axis=1))
            if len(match):
                origin[region] = int(match[0])
                seen[region].add(int(match[0]))
        plain += len(origin) == len(REGIONS)
    assert 60 < plain < 200  # a quarter has no gesture added, and some gestures stay below the frame
    assert all(found == set(range(16)) for found in seen.values())


def test_recombined_faces_are_possible() -> None:
    weights = blending_weights("recombined", 250)
    for names in EXCLUSIVE:
        assert weights[:, [SKIN_NAMES.index(name) for name in names]].sum(axis=1).max() <= 1 + 1e-12
    assert (weights[:, SKIN_NAMES.index("mouthClose")] <= weights[:, SKIN_NAMES.index("jawOpen")]).all()
    assert np.linalg.matrix_rank(weights) == 51


def test_a_still_take_becomes_gestures_alone() -> None:
    weights = blending_weights("recombined", 40, 0, take(np.zeros((2, 51))))
    assert (np.count_nonzero(weights, axis=1) <= 24).all()
    assert (weights.max(axis=1) >= 0.1).all()


def test_what_a_source_cannot_use_is_refused() -> None:
    with pytest.raises(InvalidInput, match="'sparse' draws its expressions and uses no recording, got 'made'"):
        blending_weights("sparse", 3, 0, take(np.ones((2, 51))))
    with pytest.raises(InvalidInput, match=r"'recombine' is unknown.*Did you mean 'recombined'"):
        blending_weights("recombine", 3)
