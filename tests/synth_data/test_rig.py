"""Personal rigs: what each unit must keep, how far two people differ, and the blinks."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
import trimesh

from retarget.types import FloatArray, IntArray, Regions
from synth_data.arkit import MIRRORED, SKIN_NAMES
from synth_data.blink import OVERLAP, close_lids
from synth_data.makehuman.anthropometry import personalisation
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.identities import Identity
from synth_data.makehuman.rig import generic_rig, personal_rig
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import Targets
from synth_data.truth import FLIP
from synth_data.truths.personal_blendshapes import (
    ASYMMETRY,
    FIELD_DEVIATION,
    GAIN_DEVIATION,
    LOPSIDED,
    SHARED,
    _Way,
    local_similarity,
)

Base = tuple[BaseHead, Targets, Regions]
People = list[tuple[Identity, FloatArray]]
UNIT = {name: i for i, name in enumerate(SKIN_NAMES)}


def lip_gap(vertices: FloatArray, regions: Regions) -> float:
    """mm between the middles of the lips: height of the lip contour's inner loop at the midline."""
    loop = regions.loops["lip_inner"]
    assert regions.mirror is not None
    middle = loop[regions.mirror[loop] == loop]
    return float(np.ptp(vertices[middle, 1]))


def crossings(vertices: FloatArray, faces: IntArray) -> int:
    """Number of mesh edges that pass through a triangle which they do not touch."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    edges = mesh.edges_unique
    start, along = vertices[edges[:, 0]], np.diff(vertices[edges], axis=1)[:, 0]
    length = np.linalg.norm(along, axis=1)
    triangle, edge, at = mesh.ray.intersects_id(start, along / length[:, None], True, 6, return_locations=True)
    distance = np.linalg.norm(at - start[edge], axis=1)
    touching = (faces[triangle][:, :, None] == edges[edge][:, None, :]).any(axis=(1, 2))
    return int((~touching & (distance > 1e-3) & (distance < length[edge] - 1e-3)).sum())


def test_personal_deltas_differ_by_thirty_to_forty_percent(base: Base, people: People) -> None:
    region = base[2].vertices["head"]
    shares = [personalisation(a, b, region) for (_, a), (_, b) in itertools.combinations(people, 2)]
    assert 0.3 < np.mean(shares) < 0.4
    assert min(shares) > 0.22


def test_personalisation_by_hand() -> None:
    rig = np.random.default_rng(0).standard_normal((51, 6, 3))
    everywhere = np.arange(6)
    assert personalisation(rig, rig, everywhere) == 0
    assert personalisation(rig, -rig, everywhere) == pytest.approx(2)
    assert personalisation(rig, 1.1 * rig, everywhere) == pytest.approx(0.1 / np.sqrt((1 + 1.21) / 2))


def test_nothing_moves_where_the_shared_unit_does_not(base: Base, people: People) -> None:
    shared_units = generic_rig(*base).deltas
    for _, rig in people:
        for name, shared, delta in zip(SKIN_NAMES, shared_units, rig, strict=True):
            assert not delta[~shared.any(axis=1)].any()
            ratio = np.linalg.norm(delta, axis=1).max() / np.linalg.norm(shared, axis=1).max()
            assert 0.4 < ratio < 1.8, name


def test_same_seed_same_bits(base: Base, people: People) -> None:
    identity, rig = people[1]
    np.testing.assert_array_equal(personal_rig(identity, *base), rig)


@pytest.mark.parametrize("steps", [0, 1], ids=["base", "subdivided"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_each_blink_closes_each_lid_margin(base: Base, people: People, side: str, steps: int) -> None:
    head, _, coarse = base
    fine = subdivide(head.faces, len(head.vertices), steps)
    regions = fine.regions(coarse)
    loop = regions.loops[f"lid_margin_{side}"]
    upper = np.isin(loop, regions.vertices[f"lid_margin_upper_{side}"])
    for identity, rig in people:
        neutral = fine(identity.vertices)
        shut = neutral + fine(rig[UNIT[f"eyeBlink{side.title()}"]])
        rest = shut[loop[~upper]]
        rest = rest[np.argsort(rest[:, 0])]
        above = shut[loop[upper], 1] - np.interp(shut[loop[upper], 0], rest[:, 0], rest[:, 1])
        opening = neutral[loop[upper], 1].max() - neutral[loop[~upper], 1].min()
        assert opening > 5
        assert above.max() < 0.35  # mm: no gap ...
        assert above.min() > -OVERLAP - 0.35  # ... and no lid that passes far beyond the other


def test_lids_that_meet_already_stay(base: Base) -> None:
    head, targets, regions = base
    once = close_lids(targets["units/eyeBlinkLeft"], head.vertices, head.vertices, regions, "left")
    twice = close_lids(once, head.vertices, head.vertices, regions, "left")
    assert np.abs(once - targets["units/eyeBlinkLeft"]).max() > 1  # MakeHuman's own blink closes too far
    np.testing.assert_allclose(twice, once, atol=1e-9)


def test_lips_part_under_jaw_open_and_meet_again_under_mouth_close(base: Base, people: People) -> None:
    regions = base[2]
    for identity, rig in people:
        opened = identity.vertices + rig[UNIT["jawOpen"]]
        closed = opened + rig[UNIT["mouthClose"]]
        rest, wide, shut = (lip_gap(v, regions) for v in (identity.vertices, opened, closed))
        assert wide > rest + 15
        assert abs(shut - rest) < 0.5  # mm: jawOpen and mouthClose are personalised alike


def test_units_cross_the_skin_hardly_more_than_the_shared_units_do(base: Base, people: People) -> None:
    head, targets, _ = base
    for name in ("jawOpen", "mouthSmileLeft", "eyeBlinkLeft", "cheekPuff", "browDownLeft"):
        shared = crossings(head.vertices + targets[f"units/{name}"], head.faces)
        for identity, rig in people[:2]:
            at_rest = crossings(identity.vertices, head.faces)
            assert crossings(identity.vertices + rig[UNIT[name]], head.faces) <= shared + at_rest + 60, name


def test_local_similarity_recovers_a_similarity(base: Base) -> None:
    v = base[0].vertices
    angle = 0.3
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    found = local_similarity(v, 1.1 * v @ rotation.T + (5, -3, 2))
    np.testing.assert_allclose(found, np.broadcast_to(1.1 * rotation, found.shape), atol=1e-6)


def test_a_turned_and_scaled_copy_of_a_head_has_turned_and_scaled_units(base: Base) -> None:
    v = base[0].vertices
    angle = 0.3
    similarity = 1.2 * np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    rig, copy = (personal_rig(Identity(3, "woman", 40.0, head), *base) for head in (v, v @ similarity.T + (5, -3, 2)))
    exact = [i for name, i in UNIT.items() if not name.startswith("eyeBlink")]  # a blink meets an overlap in mm
    np.testing.assert_allclose(copy[exact], rig[exact] @ similarity.T, atol=1e-4)


def test_gains_and_their_sides_vary_as_stated(base: Base) -> None:
    generic = generic_rig(*base)
    lefts = [name for name in SKIN_NAMES if name < MIRRORED[name]]
    people = [_Way(seed, False, generic) for seed in range(50)]
    left, right = (
        np.log([[person.gain(name) for name in names] for person in people])
        for names in (lefts, [MIRRORED[name] for name in lefts])
    )
    assert (left - right).std() == pytest.approx(ASYMMETRY, rel=0.15)
    assert ((left + right) / 2).std() == pytest.approx(GAIN_DEVIATION, rel=0.15)
    assert min(ASYMMETRY, GAIN_DEVIATION) >= 0.05


def correlation(fields: Sequence[FloatArray], others: Sequence[FloatArray]) -> float:
    """Of fields with mean zero, over all entries of all people."""
    a, b = np.ravel(fields), np.ravel(others)
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))


def test_tensor_fields_are_mirrored_shared_and_lopsided_as_stated(base: Base) -> None:
    head, generic = base[0], generic_rig(*base)
    fields = {
        name: [_Way(seed, False, generic).field(name) for seed in range(12)]
        for name in ("mouthSmileLeft", "mouthSmileRight", "jawOpen", "browDownLeft")
    }
    mirrored = {name: [m[head.mirror] * np.outer(FLIP, FLIP) for m in of_unit] for name, of_unit in fields.items()}
    even = 1 - LOPSIDED
    assert correlation(fields["mouthSmileLeft"], mirrored["mouthSmileRight"]) == pytest.approx(even, abs=0.04)
    assert correlation(fields["jawOpen"], mirrored["jawOpen"]) == pytest.approx(even, abs=0.04)
    for name in ("jawOpen", "browDownLeft"):
        assert correlation(fields["mouthSmileLeft"], fields[name]) == pytest.approx(SHARED * even, abs=0.12)
    assert np.std(list(fields.values())) == pytest.approx(FIELD_DEVIATION, rel=0.1)
    assert 0.05 < LOPSIDED < 0.2  # hence no exact mirror images ...
    assert 0.3 < SHARED < 0.5  # ... and neither one field for all units nor unrelated ones
