"""Identities: widths as published, alignment, size, plausibility, determinism."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from retarget.anatomy.crossings import self_intersections
from retarget.check import InvalidInput, check_triangle_areas
from retarget.geometry.procrustes import rigid_align
from retarget.types import Regions
from synth_data.makehuman import identities
from synth_data.makehuman.anthropometry import Comparison, compare_widths
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.identities import Identity, IdentitySampler, measure
from synth_data.makehuman.lips import REACH, RestingLips
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import Targets

Base = tuple[BaseHead, Targets, Regions]


@pytest.fixture(scope="module")
def widths(base: Base, sampler: IdentitySampler) -> list[Comparison]:
    return compare_widths(sampler, dict(base[2].landmarks), range(60))


def test_mean_and_spread_of_thirty_men_and_thirty_women_are_as_published(widths: list[Comparison]) -> None:
    assert len(widths) == 8
    for row in widths:
        assert abs(row.mean - row.published_mean) < 2.5, row  # mm: half a deviation plus the sampling of 30
        assert 0.55 < row.deviation / row.published_deviation < 1.45, row


def test_same_seed_same_bits_and_no_memory(sampler: IdentitySampler, base: Base) -> None:
    first = sampler(7)
    sampler(8)
    np.testing.assert_array_equal(sampler(7).vertices, first.vertices)
    np.testing.assert_array_equal(IdentitySampler(*base)(7).vertices, first.vertices)


def test_heads_are_aligned_on_the_cranium_adult_and_of_true_size(sampler: IdentitySampler, base: Base) -> None:
    head, _, regions = base
    cranium = regions.vertices["cranium"]
    drawn: list[Identity] = [sampler(seed) for seed in range(8)]
    for identity in drawn:
        rotation, translation = rigid_align(identity.vertices[cranium], head.vertices[cranium])
        np.testing.assert_allclose(rotation, np.eye(3), atol=1e-9)
        np.testing.assert_allclose(translation, 0, atol=1e-6)
        assert 25 <= identity.age <= 90
        check_triangle_areas(str(identity.seed), identity.vertices, head.faces)
    assert [identity.gender for identity in drawn] == ["man", "woman"] * 4
    sizes = [np.ptp(identity.vertices[cranium], axis=0).max() for identity in drawn]
    assert np.std(sizes) > 1  # mm: a similarity would have made them alike


def test_a_seed_whose_draws_all_distort_the_face_is_refused(
    sampler: IdentitySampler, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(identities, "LARGEST_STRAIN", 0.01)
    monkeypatch.setattr(identities, "ATTEMPTS", 2)
    with pytest.raises(InvalidInput, match="Identity seed 5: none of 2 draws"):
        sampler(5)


def test_people_differ(sampler: IdentitySampler, base: Base) -> None:
    face = base[2].vertices["face"]
    heads = [sampler(seed).vertices[face] for seed in range(6)]
    distances = [np.linalg.norm(a - b, axis=1).mean() for i, a in enumerate(heads) for b in heads[:i]]
    assert min(distances) > 2  # mm


def test_measure_by_hand() -> None:
    names = ("zygion", "gonion", "cheilion")
    landmarks = {f"{n}_{side}": 2 * i + j for i, n in enumerate(names) for j, side in enumerate(("left", "right"))}
    landmarks |= {"nasion": 6, "subnasale": 7}
    vertices = np.zeros((8, 3))
    vertices[[0, 2, 4, 6]] = [[130, 0, 0], [60, 80, 0], [0, 0, 50], [0, 48, 14]]
    np.testing.assert_allclose(measure(vertices, landmarks), [130, 100, 50, 50])


CROSSED = {2: 1.0, 12: 0.3, 26: 1.0}  # seeds whose drawn lips pass each other, and mm within which visible skin moves
"""Seed 26 is a lower lip that folds over its own lining."""


@pytest.fixture(scope="module")
def drawn(base: Base) -> dict[int, np.ndarray]:
    """Heads (n, 3) as they are drawn, lips untouched."""
    plain = IdentitySampler(*base)
    plain._lips = lambda vertices: vertices  # type: ignore[assignment]
    return {seed: plain(seed).vertices for seed in (0, *CROSSED)}


def test_lips_touch_without_crossing_on_the_base_mesh_and_refined(
    base: Base, sampler: IdentitySampler, drawn: dict[int, np.ndarray]
) -> None:
    head, _, regions = base
    fine = subdivide(head.faces, len(head.vertices), 1)
    away = cKDTree(head.vertices[regions.vertices["lips"]]).query(head.vertices)[0]
    for seed, most in CROSSED.items():
        before, after = drawn[seed], sampler(seed).vertices
        assert len(self_intersections(before, head.faces)) > 10
        assert len(self_intersections(after, head.faces)) == 0
        assert len(self_intersections(fine(after), fine.faces)) == 0
        moved = np.linalg.norm(after - before, axis=1)
        assert moved[away >= REACH].max() == 0
        assert moved[regions.vertices["head"]].max() < most
        check_triangle_areas(str(seed), after, head.faces)


def test_lips_that_do_not_cross_keep_their_bits(sampler: IdentitySampler, drawn: dict[int, np.ndarray]) -> None:
    np.testing.assert_array_equal(sampler(0).vertices, drawn[0])


def test_parted_lips_stay_mirror_symmetric_and_need_no_second_parting(base: Base) -> None:
    head, _, regions = base
    rest = RestingLips(head, regions)
    shut = head.vertices.copy()
    shut[regions.vertices["upper_lip"], 1] -= 1.0  # mm
    shut = 0.5 * (shut + (shut * (-1, 1, 1))[head.mirror])
    parted = rest(shut)
    assert np.abs(parted - shut).max() > 0.3
    np.testing.assert_allclose((parted * (-1, 1, 1))[head.mirror], parted, atol=0.01)
    np.testing.assert_array_equal(rest(parted), parted)
