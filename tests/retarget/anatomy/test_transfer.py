"""Regions on another topology: against the truth on a MakeHuman head whose vertices are known, and on ICT-FaceKit."""

from __future__ import annotations

import tarfile
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from retarget.anatomy.closed import cap, check_closed
from retarget.anatomy.crossings import self_intersections
from retarget.anatomy.depths import landmark_depths, load_depths
from retarget.anatomy.fit import fit_head
from retarget.anatomy.landmarks import LANDMARKS
from retarget.anatomy.separate import separate
from retarget.anatomy.skin import isolate_skin
from retarget.anatomy.skull import build_skull
from retarget.anatomy.template import build_template
from retarget.anatomy.transfer import transfer_regions
from retarget.check import InvalidInput
from retarget.geometry.edge_loops import boundary_loops, is_edge_cycle, parts
from retarget.geometry.triangles import areas
from retarget.io.landmarks import read_landmarks
from retarget.io.mesh import read_mesh
from retarget.io.regions import check_regions, encode
from retarget.types import FloatArray, IntArray, Regions
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import load_head

ROOT = Path(__file__).parents[3]
ICT = ROOT.parent / "shared" / "data" / "ict_facekit" / "ict_facekit_subset.tar.xz"


@dataclass(frozen=True)
class Case:
    reference: tuple[FloatArray, IntArray, Regions]
    vertices: FloatArray
    faces: IntArray
    truth: Regions
    found: Regions

    @property
    def picked(self) -> dict[str, int]:
        return {name: self.truth.landmarks[name] for name in LANDMARKS}


@pytest.fixture(scope="module")
def case() -> Case:
    """Another person, refined, with shuffled vertices and triangles: nothing but the shape tells what is where."""
    base, targets = load_head()
    regions = load_regions()
    person = IdentitySampler(base, targets, regions)(1)
    regions = replace(regions, loops={**regions.loops, "neck": regions.loops["neck"][::-1]})  # against the triangles
    fine = subdivide(base.faces, len(base.vertices))
    rng = np.random.default_rng(0)
    order = rng.permutation(fine.operator.shape[0])
    number = np.argsort(order)
    faces = number[fine.faces][rng.permutation(len(fine.faces))]
    known = fine.regions(regions)
    truth = Regions(
        vertices={name: np.sort(number[members]) for name, members in known.vertices.items()},
        loops={name: number[loop] for name, loop in known.loops.items()},
        landmarks={name: int(number[vertex]) for name, vertex in known.landmarks.items()},
    )
    vertices = fine(person.vertices)[order]
    reference = base.vertices, base.faces, regions
    found = transfer_regions(reference, vertices, faces, {name: truth.landmarks[name] for name in LANDMARKS})
    return Case(reference, vertices, faces, truth, found)


def test_names_are_those_of_the_reference(case: Case) -> None:
    regions = case.reference[2]
    for part in ("vertices", "loops", "triangles", "patches", "landmarks", "points"):
        assert set(getattr(case.found, part)) == set(getattr(regions, part))
    assert case.found.mirror is None
    check_regions("found", case.found, len(case.vertices), case.faces)


def test_picked_landmarks_stay(case: Case) -> None:
    assert {name: case.found.landmarks[name] for name in LANDMARKS} == case.picked


def test_landmarks_come_near_the_truth(case: Case) -> None:
    names = [name for name in case.truth.landmarks if name not in LANDMARKS]
    there, truth = (case.vertices[[r.landmarks[n] for n in names]] for r in (case.found, case.truth))
    error = np.linalg.norm(there - truth, axis=1)
    assert np.median(error) < 2.0
    assert error.max() < 8.0


def test_loops_run_near_the_truth(case: Case) -> None:
    limits = {"lip_contour": 3.0, "eye_socket_left": 5.0, "eye_socket_right": 5.0, "neck": 1e-9}
    for name, loop in case.found.loops.items():
        a, b = case.vertices[loop], case.vertices[case.truth.loops[name]]
        hausdorff = max(cKDTree(a).query(b)[0].max(), cKDTree(b).query(a)[0].max())
        assert hausdorff <= limits.get(name, 1.5), name


def test_loops_start_and_turn_as_on_the_reference(case: Case) -> None:
    for name, loop in case.found.loops.items():
        place = cKDTree(case.vertices[case.truth.loops[name]]).query(case.vertices[loop])[1]
        steps = (np.diff(np.r_[place, place[0]]) + len(case.truth.loops[name]) / 2) % len(case.truth.loops[name])
        assert np.sum(steps - len(case.truth.loops[name]) / 2) == len(case.truth.loops[name]), name  # once round


def test_sets_overlap_the_truth(case: Case) -> None:
    def overlap(name: str) -> float:
        a, b = case.found.vertices[name], case.truth.vertices[name]
        return len(np.intersect1d(a, b)) / len(np.union1d(a, b))

    for name in ("head", "interior", "face", "ears", "nose", "eyes"):
        assert overlap(name) > 0.9, name
    for name in ("lips", "upper_lip", "lower_lip", "jaw", "jaw_skin", "cranium_skin", "cheeks", "neck", "scalp"):
        assert overlap(name) > 0.75, name


def test_sets_keep_their_relations(case: Case) -> None:
    v = case.found.vertices
    np.testing.assert_array_equal(np.sort(np.concatenate([v["head"], v["interior"]])), np.arange(len(case.vertices)))
    partition = np.concatenate([v[name] for name in ("face", "ears", "scalp", "neck")])
    np.testing.assert_array_equal(np.sort(partition), v["head"])
    np.testing.assert_array_equal(np.union1d(v["upper_lip"], v["lower_lip"]), v["lips"])
    np.testing.assert_array_equal(v["neck_boundary"], np.sort(case.found.loops["neck"]))
    for side in ("left", "right"):
        for half in ("upper", "lower"):
            assert np.isin(v[f"lid_margin_{half}_{side}"], case.found.loops[f"lid_margin_{side}"]).all()


def test_lips_and_eyes_end_at_their_loops(case: Case) -> None:
    inner = {name: loop for name, loop in case.found.loops.items() if name != "neck"}
    outside = parts(case.faces, len(case.vertices), inner)[
        frozenset({"lip_contour", "eye_socket_left", "eye_socket_right"})
    ]
    for name in ("lips", "eyes", "interior"):
        assert len(np.intersect1d(case.found.vertices[name], outside)) == 0, name


def test_points_follow_the_skin(case: Case) -> None:
    base_vertices, _, regions = case.reference
    person = case.vertices
    for name, point in case.found.points.items():
        assert point.weights.sum() == pytest.approx(1.0, abs=1e-12)
        ear = case.truth.landmarks[f"tragion_{name.removeprefix('condyle_')}"]
        base_ear = regions.landmarks[f"tragion_{name.removeprefix('condyle_')}"]
        offset = point(person) - person[ear]
        assert np.linalg.norm(offset - (regions.points[name](base_vertices) - base_vertices[base_ear])) < 6.0


@pytest.mark.parametrize("name", ["eye_opening_left", "eye_opening_right", "eye_socket_left", "eye_socket_right"])
def test_patches_fill_their_loops_facing_outward(case: Case, name: str) -> None:
    patch, loop = case.found.patches[name], case.found.loops[name.replace("eye_opening", "lid_margin")]
    assert len(patch) == len(loop) - 2
    assert set(patch.ravel().tolist()) == set(loop.tolist())
    assert areas(case.vertices, patch).min() > 1e-3
    a, b, c = (case.vertices[patch[:, i]] for i in range(3))
    assert np.cross(b - a, c - a).sum(axis=0)[2] > 0  # out of the face
    edges = np.sort(np.concatenate([patch[:, [0, 1]], patch[:, [1, 2]], patch[:, [2, 0]]]), axis=1)
    once = {tuple(edge) for edge, uses in zip(*np.unique(edges, axis=0, return_counts=True), strict=True) if uses == 1}
    assert once == {tuple(sorted(edge)) for edge in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True)}


def test_the_same_input_gives_the_same_regions(case: Case) -> None:
    base, faces, regions = case.reference
    picked = {name: regions.landmarks[name] for name in LANDMARKS}
    once, again = (transfer_regions(case.reference, base, faces, picked) for _ in range(2))
    assert encode(once) == encode(again)


def bad(case: Case, scale: float = 1.0, **changes: int) -> None:
    transfer_regions(case.reference, case.vertices * scale, case.faces, case.picked | changes)


def test_refuses_another_unit(case: Case) -> None:
    with pytest.raises(InvalidInput, match="looks like cm: multiply by 10"):
        bad(case, scale=0.1)
    with pytest.raises(InvalidInput, match="looks like m: multiply by 1000"):
        bad(case, scale=0.001)


def test_refuses_landmarks_that_do_not_fit(case: Case) -> None:
    with pytest.raises(InvalidInput, match="nose_tip unknown"):
        bad(case, nose_tip=3)
    with pytest.raises(InvalidInput, match="expected a vertex from 0 to"):
        bad(case, nasion=len(case.vertices))
    few = {name: case.picked[name] for name in LANDMARKS[:3]}
    with pytest.raises(InvalidInput, match="expected at least 6, got 3"):
        transfer_regions(case.reference, case.vertices, case.faces, few)
    swapped = {
        n: case.picked[n.replace("_left", "_x").replace("_right", "_left").replace("_x", "_right")] for n in LANDMARKS
    }
    with pytest.raises(InvalidInput, match="left and right are exchanged"):
        transfer_regions(case.reference, case.vertices, case.faces, swapped)
    with pytest.raises(InvalidInput, match="a name probably sits at another place"):
        bad(case, pronasale=int(np.argmin(case.vertices[:, 2])))


def test_refuses_further_pieces(case: Case) -> None:
    base, faces, regions = case.reference
    eyeball = base[:3] + np.array([0.0, 0.0, 40.0])
    both = np.vstack([faces, [[len(base), len(base) + 1, len(base) + 2]]])
    picked = {name: regions.landmarks[name] for name in LANDMARKS}
    with pytest.raises(InvalidInput, match="expected one connected piece, the skin, got others of 3 vertices"):
        transfer_regions(case.reference, np.vstack([base, eyeball]), both, picked)


def test_a_head_may_have_holes_for_eyes(case: Case) -> None:
    base, faces, regions = case.reference
    inner = {name: loop for name, loop in regions.loops.items() if name != "neck"}
    behind = parts(faces, len(base), inner)
    sockets = np.concatenate([behind[frozenset({f"lid_margin_{side}"})] for side in ("left", "right")])
    kept = np.setdiff1d(np.arange(len(base)), sockets)
    number = np.full(len(base), -1)
    number[kept] = np.arange(len(kept))
    holes = number[faces[~np.isin(faces, sockets).any(axis=1)]]
    picked = {name: int(number[regions.landmarks[name]]) for name in LANDMARKS}
    found = transfer_regions(case.reference, base[kept], holes, picked)
    assert len(boundary_loops(holes)) == 3
    check_regions("holes", found, len(kept), holes)
    np.testing.assert_array_equal(
        np.sort(found.loops["lid_margin_left"]), np.sort(number[regions.loops["lid_margin_left"]])
    )
    assert set(found.patches) == set(regions.patches)


def test_refuses_a_head_that_lies_on_its_back(case: Case) -> None:
    lying = case.vertices @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T
    with pytest.raises(InvalidInput, match=r"turned by 9\d degrees"):
        transfer_regions(case.reference, lying, case.faces, case.picked)


def test_separate_opens_lips_that_were_pressed_together(case: Case) -> None:
    base, targets = load_head()
    regions = case.reference[2]
    pressed = base.vertices - 0.12 * targets["units/jawOpen"]
    _, closed = cap("head", pressed, base.faces)
    assert len(self_intersections(cap("head", pressed, base.faces)[0], closed)) > 0
    apart = separate(pressed, base.faces, regions)
    check_closed("head", *cap("head", apart, base.faces))
    moved = np.linalg.norm(apart - pressed, axis=1)
    assert moved.max() < 8.0
    corners = [regions.landmarks[f"cheilion_{side}"] for side in ("left", "right")]
    assert moved[corners].max() < 0.3 * moved.max()
    assert moved[regions.vertices["eyes"]].max() == 0
    assert moved[regions.vertices["cranium"]].max() == 0
    upper, lower = (regions.landmarks[f"stomion_{side}"] for side in ("upper", "lower"))
    assert (apart - pressed)[upper, 1] > 1 > -1 > (apart - pressed)[lower, 1]


def test_separate_refuses_what_crosses_elsewhere(case: Case) -> None:
    base, _ = load_head()
    crossed = base.vertices.copy()
    tip = case.reference[2].landmarks["pronasale"]
    crossed[tip, 2] -= 60.0  # the tip of the nose pushed into the mouth cavity
    if not len(self_intersections(crossed, base.faces)):
        pytest.fail("the test's head has to cross itself")
    with pytest.raises(InvalidInput, match="at lips and lids alone"):
        separate(crossed, base.faces, case.reference[2])


Skin = tuple[FloatArray, IntArray, dict[str, int]]


@pytest.fixture(scope="module")
def ict() -> Callable[[str], Skin]:
    """Reads the skin of an ICT-FaceKit mesh: vertices in mm, triangles and landmarks."""
    if not ICT.is_file():
        pytest.skip(f"{ICT.name} is not there, expected under {ICT.parents[2].name}/ beside the repository")
    unit, marks = read_landmarks(ROOT / "docs" / "examples" / "ict_facekit_landmarks.json")

    def read(name: str) -> Skin:
        with tarfile.open(ICT) as archive, tempfile.TemporaryDirectory() as folder:
            archive.extract(f"ICT-FaceKit/FaceXModel/{name}.obj", folder, filter="data")
            vertices, faces = read_mesh(Path(folder) / "ICT-FaceKit" / "FaceXModel" / f"{name}.obj")
        kept, faces = isolate_skin(faces, len(vertices), marks)
        return vertices[kept] * unit, faces, {n: int(np.searchsorted(kept, vertex)) for n, vertex in marks.items()}

    return read


def test_ict_facekit_gets_regions_and_opens_its_lips(case: Case, ict: Callable[[str], Skin]) -> None:
    vertices, faces, marks = ict("generic_neutral_mesh")
    assert len(vertices) == 14_062
    regions = transfer_regions(case.reference, vertices, faces, marks)
    check_regions("ict", regions, len(vertices), faces)
    assert all(is_edge_cycle(loop, faces, len(vertices)) for loop in regions.loops.values())
    mirrored = cKDTree(vertices).query(vertices * (-1, 1, 1))[1]  # the generic head is symmetric
    for name in ("eye", "ear", "cheek"):
        left, right = regions.vertices[f"{name}_left"], mirrored[regions.vertices[f"{name}_right"]]
        assert len(np.intersect1d(left, right)) > 0.9 * len(np.union1d(left, right)), name
    with pytest.raises(InvalidInput, match="self-intersections"):
        check_closed("ict", *cap("ict", vertices, faces))
    opened = cap("ict", separate(vertices, faces, regions), faces)
    skull = build_skull(*opened, regions, landmark_depths(load_depths(), regions), spacing=4.0)
    assert np.abs(list(skull.errors.values())).max() < 3.0


@pytest.mark.slow
def test_ict_facekit_identities_get_a_volumetric_head(case: Case, ict: Callable[[str], Skin]) -> None:
    vertices, faces, marks = ict("generic_neutral_mesh")
    regions = transfer_regions(case.reference, vertices, faces, marks)
    template = build_template(separate(vertices, faces, regions), faces, regions)
    for name in ("generic_neutral_mesh", "identity000", "identity001", "identity003"):
        head = fit_head(template, ict(name)[0])
        assert np.abs(list(head.depth_errors.values())).max() < 1.0, name
        a, b, c, d = (head.vertices[template.tets[:, i]] for i in range(4))
        assert np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)).min() > 0, name
