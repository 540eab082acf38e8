"""The drawn blending weights: ranges, sparsity, exclusions, sides, determinism."""

from __future__ import annotations

import numpy as np
import pytest

from retarget.types import FloatArray
from synth_data.arkit import SKIN_NAMES
from synth_data.sequence import EXCLUSIVE, PARTS, sparse_weights

COLUMN = {name: i for i, name in enumerate(SKIN_NAMES)}


@pytest.fixture(scope="module")
def weights() -> FloatArray:
    return sparse_weights(250, seed=0)


def test_range_and_sparsity(weights: FloatArray) -> None:
    assert weights.shape == (250, 51)
    assert weights.min() == 0.0
    assert weights.max() <= 1.0
    active = np.count_nonzero(weights, axis=1)
    assert active.min() >= 3
    assert active.max() <= 12
    assert 4 <= np.median(active) <= 9


def test_no_two_rows_are_alike(weights: FloatArray) -> None:
    distance = np.abs(weights[:, None] - weights[None]).max(axis=-1)
    assert distance[np.triu_indices(250, 1)].min() >= 0.02


@pytest.mark.parametrize("names", EXCLUSIVE)
def test_exclusive_units_do_not_add_up(weights: FloatArray, names: tuple[str, ...]) -> None:
    assert weights[:, [COLUMN[name] for name in names]].sum(axis=1).max() <= 1 + 2e-4


def test_mouth_close_never_exceeds_jaw_open(weights: FloatArray) -> None:
    assert (weights[:, COLUMN["mouthClose"]] <= weights[:, COLUMN["jawOpen"]]).all()
    assert (weights[:, COLUMN["mouthClose"]] > 0).any()


def test_every_unit_is_used_and_reaches_half_strength(weights: FloatArray) -> None:
    peak = weights.max(axis=0)
    assert peak.min() > 0.25, [name for name, p in zip(SKIN_NAMES, peak, strict=True) if p <= 0.25]
    named = {unit for _, gestures in PARTS.values() for _, _, units in gestures for unit in units}
    assert {unit for unit in named if unit not in COLUMN} == {u for u in named if u + "Left" in COLUMN}


def test_the_sides_of_a_face_move_together(weights: FloatArray) -> None:
    for name in ("mouthSmile", "eyeBlink", "browDown", "eyeSquint"):
        left, right = (weights[:, COLUMN[name + side]] for side in ("Left", "Right"))
        assert np.corrcoef(left, right)[0, 1] > 0.7


def test_seed_decides_and_a_longer_list_begins_alike(weights: FloatArray) -> None:
    np.testing.assert_array_equal(sparse_weights(40, seed=0), weights[:40])
    assert not np.array_equal(sparse_weights(40, seed=1), weights[:40])
    assert sparse_weights(0).shape == (0, 51)


def test_weights_span_all_units(weights: FloatArray) -> None:
    assert np.linalg.matrix_rank(weights) == 51
