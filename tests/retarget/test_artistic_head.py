"""A lip contour moved by a few control points on a pair of MakeHuman's people, as in Fig. 15 of the paper."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.catalogue import make_method
from retarget.geometry.space_warp import space_warp
from retarget.types import Examples, Fitted, FloatArray, Pair, Status
from synth_data.dataset import Dataset
from synth_data.makehuman.dataset import MakeHuman

SAME = 1e-6  # mm: an edit that changes nothing leaves the result within it
NEAR = 1e-2  # mm: so does one that hardly changes anything, where lips meet and are parted anew


@pytest.fixture(scope="module")
def head() -> tuple[Dataset, Fitted, FloatArray]:
    """A pair of MakeHuman's people at the base resolution, and one expression of the source."""
    data = MakeHuman(
        identities=2, expressions=12, subdivisions=0, truth="personal_blendshapes", weights="sparse"
    ).load()
    source, target = data.identities
    pair = Pair(data.faces, data.neutral(source), data.neutral(target), data.regions)
    examples = Examples(data.frames(target, range(5)), data.frames(source, range(5)))
    fitted = make_method("anacondar").prepare(pair).fit(examples, data.frames(source, range(5)))
    return data, fitted, data.frames(source, [8])


def test_on_a_head_the_contour_arrives_and_the_cranium_does_not_move(head: tuple[Dataset, Fitted, FloatArray]) -> None:
    data, fitted, frames = head
    regions = data.regions
    names = ("cheilion_left", "cheilion_right", "labrale_superius", "labrale_inferius")
    vertices = np.array([regions.landmarks[name] for name in names])
    moves = np.zeros((4, 3))
    plain, still = (
        fitted(frames, e).frames[0] for e in (None, {"control_points": dict(zip(names, moves, strict=True))})
    )
    np.testing.assert_allclose(still, plain, atol=SAME)
    moves[0] = [0, 1e-9, 0]
    hardly = fitted(frames, {"control_points": dict(zip(names, moves, strict=True))}).frames[0]
    np.testing.assert_allclose(hardly, plain, atol=NEAR)
    moves[0] = [3, 4, 0]
    edited = fitted(frames, {"control_points": dict(zip(names, moves, strict=True))})
    contour = regions.loops["lip_contour"]
    wanted = plain[contour] + space_warp(plain[vertices], moves)(plain[contour])
    assert np.linalg.norm(wanted - plain[contour], axis=1).max() > 4
    assert np.linalg.norm(wanted - edited.frames[0, contour], axis=1).max() < 0.1
    assert np.abs(edited.frames[0] - plain)[regions.vertices["cranium"]].max() < 1e-4
    assert edited.info[0].status is Status.CONVERGED
