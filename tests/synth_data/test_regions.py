"""The regions of the MakeHuman head: names, symmetry, topology, motion, anatomy, and how the data is rebuilt.

Facts about motion are tested with the face units on the base head; anthropometry on sampled adults.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from retarget.check import InvalidInput
from retarget.io.regions import decode, encode
from retarget.types import FloatArray, Regions
from synth_data.makehuman.author_regions import author_regions
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.identities import WIDTHS, IdentitySampler, measure
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import Targets, load_head

ROOT = Path(__file__).parents[2]
SETS = (
    "interior",
    "head",
    "face",
    "upper_lip",
    "lower_lip",
    "lips",
    "brows",
    "cheeks",
    "nose",
    "eyes",
    "jaw",
    "ears",
    "neck",
    "scalp",
    "jaw_skin",
    "cranium_skin",
    "cranium",
    "neck_boundary",
    "brow_left",
    "brow_right",
    "cheek_left",
    "cheek_right",
    "eye_left",
    "eye_right",
    "ear_left",
    "ear_right",
    "lid_margin_upper_left",
    "lid_margin_upper_right",
    "lid_margin_lower_left",
    "lid_margin_lower_right",
)
LOOPS = (
    "lip_contour",
    "lip_inner",
    "lid_margin_left",
    "lid_margin_right",
    "eye_socket_left",
    "eye_socket_right",
    "neck",
)


@pytest.fixture(scope="module")
def regions() -> Regions:
    return load_regions()


@pytest.fixture(scope="module")
def made() -> tuple[BaseHead, Targets]:
    try:
        return load_head()
    except InvalidInput as error:
        pytest.skip(f"the head data cannot be had: {error}")


@pytest.fixture(scope="module")
def head(made: tuple[BaseHead, Targets]) -> BaseHead:
    return made[0]


@pytest.fixture(scope="module")
def units(made: tuple[BaseHead, Targets]) -> dict[str, FloatArray]:
    return {name.removeprefix("units/"): made[1][name] for name in made[1] if name.startswith("units/")}


@pytest.fixture(scope="module")
def adults(made: tuple[BaseHead, Targets], regions: Regions) -> list[FloatArray]:
    sampler = IdentitySampler(*made, regions)
    return [sampler(seed).vertices for seed in range(4)]


def other_side(name: str) -> str:
    return {"left": "right", "right": "left"}.get(name.rpartition("_")[2], "")


def mirrored(name: str) -> str:
    return f"{name.rpartition('_')[0]}_{other_side(name)}" if other_side(name) else name


# What is stored


def test_every_name_is_there(regions: Regions) -> None:
    assert set(regions.vertices) == set(SETS)
    assert set(regions.loops) == set(LOOPS)
    assert set(regions.patches) == {"eye_opening_left", "eye_opening_right", "eye_socket_left", "eye_socket_right"}
    assert set(regions.triangles) == {"eye_socket_left", "eye_socket_right"}
    assert set(regions.points) == {"condyle_left", "condyle_right"}
    assert {f"ibug_{i:02d}" for i in range(51)} <= set(regions.landmarks)


def test_every_name_is_documented(regions: Regions) -> None:
    page = (ROOT / "docs" / "regions.md").read_text()
    named = {*regions.vertices, *regions.loops, *regions.patches, *regions.triangles, *regions.points}
    named |= {name for name in regions.landmarks if not name.startswith("ibug_")}
    stems = {re.sub("_(left|right)$", "", name) for name in named}
    assert {stem for stem in stems if stem not in page} == set()


def test_soft_tissue_landmarks_are_there(regions: Regions) -> None:
    table = ROOT.parent / "shared" / "data" / "soft_tissue" / "depths.csv"
    if not table.is_file():
        pytest.skip("the soft-tissue depth table lies outside the repository and is absent here")
    with table.open() as file:
        for row in csv.DictReader(file):
            name = row["landmark"].lower().replace(" ", "_").replace("-", "_")
            wanted = [name] if row["side"] == "midline" else [f"{name}_left", f"{name}_right"]
            assert set(wanted) <= set(regions.landmarks)


def test_rebuilding_gives_the_committed_data(head: BaseHead, units: dict[str, FloatArray], regions: Regions) -> None:
    assert encode(author_regions(head, units)) == encode(regions)


def test_reading_inverts_writing(regions: Regions) -> None:
    again = decode(encode(regions))
    for part in ("vertices", "loops", "triangles", "patches"):
        stored, read = getattr(regions, part), getattr(again, part)
        assert stored.keys() == read.keys()
        assert all(np.array_equal(stored[name], read[name]) for name in stored)
    assert again.landmarks == regions.landmarks


# Symmetry


def test_mirror_is_an_involution_that_reflects_the_base(head: BaseHead, regions: Regions) -> None:
    assert regions.mirror is not None
    assert np.array_equal(regions.mirror[regions.mirror], np.arange(len(head.vertices)))
    np.testing.assert_allclose(head.vertices[regions.mirror] * (-1, 1, 1), head.vertices, atol=1e-9)


def test_mirror_swaps_left_and_right(regions: Regions) -> None:
    mirror = regions.mirror
    assert mirror is not None
    for name, indices in regions.vertices.items():
        assert np.array_equal(np.sort(mirror[indices]), regions.vertices[mirrored(name)]), name
    for name in ("lid_margin", "eye_socket"):
        assert np.array_equal(mirror[regions.loops[f"{name}_left"]], regions.loops[f"{name}_right"])
    for name, vertex in regions.landmarks.items():
        if not name.startswith("ibug_"):
            assert mirror[vertex] == regions.landmarks[mirrored(name)], name
    for name in ("eye_opening", "eye_socket"):
        left, right = (
            Counter(frozenset(t) for t in regions.patches[f"{name}_{s}"].tolist()) for s in ("left", "right")
        )
        assert Counter(frozenset(mirror[list(t)].tolist()) for t in left) == right


def test_left_is_plus_x_and_moves_with_left_units(
    head: BaseHead, units: dict[str, FloatArray], regions: Regions
) -> None:
    for name in [*regions.vertices, *regions.loops]:
        if name.endswith("_left"):
            members = regions.vertices.get(name, regions.loops.get(name))
            assert head.vertices[members, 0].min() > 0, name
    lids = regions.vertices["lid_margin_upper_left"], regions.vertices["lid_margin_upper_right"]
    left, right = (np.linalg.norm(units["eyeBlinkLeft"][lid], axis=1).mean() for lid in lids)
    assert left > 6
    assert right < 0.1


# Topology


def test_head_and_interior_partition_the_vertices(head: BaseHead, regions: Regions) -> None:
    both = np.concatenate([regions.vertices["head"], regions.vertices["interior"]])
    assert np.array_equal(np.sort(both), np.arange(len(head.vertices)))


def test_face_ears_scalp_and_neck_partition_the_head(regions: Regions) -> None:
    parts = np.concatenate([regions.vertices[name] for name in ("face", "ears", "scalp", "neck")])
    assert np.array_equal(np.sort(parts), regions.vertices["head"])


def test_parts_of_the_face_lie_in_it(regions: Regions) -> None:
    for name in ("lips", "brows", "cheeks", "nose", "eyes", "jaw", "jaw_skin"):
        assert np.isin(regions.vertices[name], regions.vertices["face"]).all(), name
    for a, b in (
        ("lips", "nose"),
        ("eyes", "brows"),
        ("eyes", "cheeks"),
        ("cranium", "eyes"),
        ("cranium_skin", "jaw_skin"),
    ):
        assert len(np.intersect1d(regions.vertices[a], regions.vertices[b])) == 0, (a, b)


@pytest.mark.parametrize("subdivisions", [0, 1])
def test_loops_are_closed_edge_loops(head: BaseHead, regions: Regions, subdivisions: int) -> None:
    fine = subdivide(head.faces, len(head.vertices), subdivisions)
    ends = np.sort(fine.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges = set(map(tuple, ends.tolist()))
    for name, loop in fine.regions(regions).loops.items():
        assert len(set(loop.tolist())) == len(loop), name
        steps = np.sort(np.stack([loop, np.roll(loop, -1)], axis=1), axis=1)
        assert set(map(tuple, steps.tolist())) <= edges, name


def test_neck_is_the_only_boundary(head: BaseHead, regions: Regions) -> None:
    ends = np.sort(head.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, uses = np.unique(ends, axis=0, return_counts=True)
    assert np.array_equal(np.unique(edges[uses == 1]), regions.vertices["neck_boundary"])
    assert np.array_equal(np.sort(regions.loops["neck"]), regions.vertices["neck_boundary"])


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(("patch", "loop"), [("eye_opening", "lid_margin"), ("eye_socket", "eye_socket")])
def test_patches_span_their_loops_and_face_outward(
    head: BaseHead, regions: Regions, patch: str, loop: str, side: str
) -> None:
    triangles, rim = regions.patches[f"{patch}_{side}"], regions.loops[f"{loop}_{side}"]
    assert len(triangles) == len(rim) - 2  # a disc without inner vertices
    half_edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    assert len(np.unique(half_edges, axis=0)) == len(half_edges)  # consistently oriented
    undirected, uses = np.unique(np.sort(half_edges, axis=1), axis=0, return_counts=True)
    around = np.sort(np.stack([rim, np.roll(rim, -1)], axis=1), axis=1)
    assert np.array_equal(undirected[uses == 1], np.unique(around, axis=0))
    a, b, c = (head.vertices[triangles[:, i]] for i in range(3))
    assert np.cross(b - a, c - a)[:, 2].sum() > 50  # mm2, towards the viewer


# Motion


def aperture(vertices: FloatArray, regions: Regions, side: str) -> FloatArray:
    """Height (mm) of the upper lid margin above the lower one, at each upper vertex; negative where they cross."""
    upper = vertices[regions.vertices[f"lid_margin_upper_{side}"]]
    corners = [regions.landmarks[f"{corner}_{side}"] for corner in ("endocanthion", "exocanthion")]
    lower = vertices[np.concatenate([regions.vertices[f"lid_margin_lower_{side}"], corners])]
    lower = lower[np.argsort(lower[:, 0])]
    return upper[:, 1] - np.interp(upper[:, 0], lower[:, 0], lower[:, 1])


@pytest.mark.parametrize("side", ["left", "right"])
def test_each_lid_margin_closes_under_its_blink(
    head: BaseHead, units: dict[str, FloatArray], adults: list[FloatArray], regions: Regions, side: str
) -> None:
    blink = units[f"eyeBlink{side.title()}"]
    for neutral in (head.vertices, *adults):
        opened, closed = aperture(neutral, regions, side), aperture(neutral + blink, regions, side)
        assert opened.min() > 0
        assert np.maximum(closed, 0).mean() < 0.1 * opened.mean()


def test_lips_part_under_jaw_open_and_meet_at_rest(
    head: BaseHead, units: dict[str, FloatArray], regions: Regions
) -> None:
    inner = regions.loops["lip_inner"]
    upper, lower = (np.intersect1d(inner, regions.vertices[f"{side}_lip"]) for side in ("upper", "lower"))
    corners = np.intersect1d(upper, lower)
    assert len(corners) == 2
    middle = [regions.landmarks["stomion_upper"], regions.landmarks["stomion_lower"]]

    def gap(vertices: FloatArray) -> float:
        return float(vertices[middle[0], 1] - vertices[middle[1], 1])

    assert 0 <= gap(head.vertices) < 2
    assert gap(head.vertices + units["jawOpen"]) > 30


def test_cranium_is_still_and_large(head: BaseHead, units: dict[str, FloatArray], regions: Regions) -> None:
    motion = np.max([np.linalg.norm(delta, axis=1) for delta in units.values()], axis=0)
    cranium = regions.vertices["cranium"]
    assert motion[cranium].max() < 0.7
    assert motion[regions.vertices["cranium_skin"]].max() < 1.0
    assert np.ptp(head.vertices[cranium], axis=0).min() > 90  # mm: rigid fits to it are well conditioned
    moved = np.linalg.norm(units["jawOpen"], axis=1)
    assert moved[regions.vertices["jaw_skin"]].min() > 5


# Anatomy


def test_transfer_pairs_of_nose_base_and_inner_upper_lip(head: BaseHead, regions: Regions) -> None:
    """Onizuka et al. 2019 measure the mouth by 15-44, 16-45, 17-46: straight down from the nose base."""
    assert regions.mirror is not None
    for nose, lip in ((15, 44), (16, 45), (17, 46)):
        a, b = (head.vertices[regions.landmarks[f"ibug_{i:02d}"]] for i in (nose, lip))
        assert abs(a[0] - b[0]) < 3
        assert 12 < a[1] - b[1] < 30
    assert regions.landmarks["ibug_16"] == regions.landmarks["subnasale"]
    assert regions.landmarks["ibug_45"] == regions.landmarks["stomion_upper"]


def test_ibug_order_runs_from_the_characters_right(head: BaseHead, regions: Regions) -> None:
    x = head.vertices[[regions.landmarks[f"ibug_{i:02d}"] for i in range(51)]][:, 0]
    for run in (range(10), range(14, 19), range(19, 23), range(25, 29), range(31, 38), range(43, 48)):
        assert (np.diff(x[list(run)]) > 0).all()  # +x is the character's left
    for back in ((28, 29, 30, 25), (22, 23, 24, 19), tuple(range(37, 43)), tuple(range(47, 51))):
        assert (np.diff(x[list(back)]) < 0).all()


def test_landmarks_lie_where_they_belong(regions: Regions) -> None:
    members = {name: set(indices.tolist()) for name, indices in regions.vertices.items()}
    contour, rim = (set(regions.loops[name].tolist()) for name in ("lip_contour", "lid_margin_left"))
    at = regions.landmarks
    assert set(at.values()) <= members["head"]
    assert {at["pronasale"], at["alare_left"], at["rhinion"], at["subnasale"]} <= members["nose"]
    assert {at["cheilion_left"], at["labrale_superius"], at["labrale_inferius"]} <= contour
    assert {at["exocanthion_left"], at["endocanthion_left"], *(at[f"ibug_{i}"] for i in range(25, 31))} <= rim
    assert {at["pogonion"], at["menton"], at["gonion_left"], at["sub_m2_left"]} <= members["jaw"]
    assert {at["zygion_left"], at["supra_m2_left"], at["inferior_malar_left"]} <= members["cheek_left"]
    assert {at[f"ibug_{i:02d}"] for i in range(5, 10)} | {at["supraorbital_left"]} <= members["brow_left"]


def test_profile_goes_down_the_midline(adults: list[FloatArray], regions: Regions) -> None:
    order = (
        "supraglabella",
        "glabella",
        "nasion",
        "rhinion",
        "pronasale",
        "subnasale",
        "mid_philtrum",
        "labrale_superius",
        "stomion_upper",
        "stomion_lower",
        "labrale_inferius",
        "supramentale",
        "pogonion",
        "menton",
    )
    for vertices in adults:
        profile = vertices[[regions.landmarks[name] for name in order]]
        assert (np.diff(profile[:, 1]) < 0).all()
        assert np.abs(profile[:, 0]).max() < 4
        assert profile[:, 2].argmax() == order.index("pronasale")


def test_widths_of_adults_are_near_the_published_ones(adults: list[FloatArray], regions: Regions) -> None:
    measured = np.array([measure(vertices, regions.landmarks) for vertices in adults]).mean(axis=0)
    published = [np.mean([width.men[0], width.women[0]]) for width in WIDTHS.values()]
    np.testing.assert_allclose(measured, published, rtol=0.06)


def test_condyle_lies_before_the_tragus_under_the_skin(adults: list[FloatArray], regions: Regions) -> None:
    for vertices in adults:
        for side, sign in (("left", 1), ("right", -1)):
            joint = regions.points[f"condyle_{side}"](vertices)
            tragion = vertices[regions.landmarks[f"tragion_{side}"]]
            assert 7 < joint[2] - tragion[2] < 15
            assert -10 < joint[1] - tragion[1] < 2
            assert 12 < sign * (tragion[0] - joint[0]) < 25
    for point in regions.points.values():
        assert point.weights.sum() == pytest.approx(1, abs=1e-12)


def test_a_point_follows_rigid_motion(head: BaseHead, regions: Regions) -> None:
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    point = regions.points["condyle_left"]
    moved = point(head.vertices @ quarter.T + (1, 2, 3))
    np.testing.assert_allclose(moved, quarter @ point(head.vertices) + (1, 2, 3), atol=1e-9)
    assert point(np.stack([head.vertices] * 2)).shape == (2, 3)
