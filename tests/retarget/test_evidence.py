"""How far examples explain an expression, and what that leaves of characteristics."""

import numpy as np
import pytest

from retarget.check import InvalidInput
from retarget.evidence import NOISE, Evidence, EvidenceSettings
from retarget.geometry.patches import contiguous_patches
from retarget.rig.blendshapes import whole_mesh
from retarget.simulation.characteristics import FacialCharacteristics
from tests.retarget.people import SOURCE, TARGET, frames, pair

UP = np.array([0, 1.0, 0])  # mm


def evidence(patches=None, **settings):
    count = len(pair().source_neutral)
    return Evidence(pair(), patches or whole_mesh(count), EvidenceSettings(**settings))


def test_miss_of_one_patch_by_hand():
    """All vertices move by 2 mm and miss 1 mm of it: m = 1 / sqrt(2^2 + noise^2), whatever is spread."""
    neutral = pair().source_neutral
    miss = evidence().miss(neutral + UP * 2, neutral + UP)
    np.testing.assert_allclose(miss, 1 / np.sqrt(4 + NOISE**2), rtol=1e-12)


def test_nothing_missed_and_nothing_explained_are_the_ends():
    weigh, frame, neutral = evidence(), frames(SOURCE)[3], pair().source_neutral
    assert not weigh.miss(frame, frame).any()
    assert not weigh.miss(neutral, neutral).any()
    np.testing.assert_allclose(weigh.miss(frame, neutral), 1.0, atol=5e-3)
    np.testing.assert_allclose(weigh.miss(frame, 3 * neutral - 2 * frame), 1.0, atol=1e-12)  # twice too much is 1 too


def test_miss_is_spread_over_borders_and_stays_a_share():
    patches = contiguous_patches(pair().faces, len(pair().source_neutral), 20, 0)
    neutral = pair().source_neutral
    moved, rebuilt = neutral + UP * 2, neutral + UP * 2
    rebuilt[patches[3]] = neutral[patches[3]]
    miss = evidence(patches).miss(moved, rebuilt)
    assert 0 <= miss.min() <= miss.max() <= 1
    assert 0.5 < miss[patches[3]].mean() < 1
    between = np.unique(pair().faces[np.isin(pair().faces, patches[3]).any(axis=1)])
    assert 0 < miss[np.setdiff1d(between, patches[3])].min() < 0.9


def test_held_to_the_draft_where_all_is_explained_and_to_the_characteristics_where_nothing_is():
    wanted = FacialCharacteristics(pair())(frames(SOURCE)[3])
    draft, contour = frames(TARGET)[3], pair().regions.loops["lip_contour"]
    weigh = evidence()
    none = weigh.held(wanted, draft, np.ones(len(draft)))
    for part in ("lip_contour", "eye_opening", "eye_socket"):
        np.testing.assert_allclose(getattr(none, part), getattr(wanted, part), atol=1e-9)
    everything = weigh.held(wanted, draft, np.zeros(len(draft)))
    np.testing.assert_array_equal(everything.lip_contour, draft[contour])
    own = FacialCharacteristics(pair(TARGET, TARGET))(draft)
    np.testing.assert_allclose(everything.eye_opening, own.eye_opening, rtol=1e-9)
    np.testing.assert_allclose(everything.eye_socket, own.eye_socket, rtol=1e-9)


def test_half_explained_is_half_way():
    """q = 1: the contour is held to the middle; c = 2: a quarter of what tissue does not follow is kept."""
    wanted = FacialCharacteristics(pair())(frames(SOURCE)[3])
    draft, contour = frames(TARGET)[3], pair().regions.loops["lip_contour"]
    weigh, miss = evidence(sharpness=1.0, caution=2.0), np.full(len(frames(TARGET)[3]), 0.5)
    np.testing.assert_allclose(weigh.detail(np.ones_like(draft), miss), 0.25)
    held = weigh.held(wanted, draft, miss)
    np.testing.assert_allclose(held.lip_contour, 0.5 * (draft[contour] + wanted.lip_contour), atol=1e-9)


@pytest.mark.parametrize("name", ["sharpness", "caution"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_exponents_are_positive(name, value):
    with pytest.raises(InvalidInput, match=name):
        EvidenceSettings(**{name: value})
