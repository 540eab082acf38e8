"""The template of the MakeHuman head as it ships, and what cannot become one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

from retarget.anatomy.bones import label_bones
from retarget.anatomy.boundary import boundary_faces, enclosed_volume, signed_volumes
from retarget.anatomy.closed import cap
from retarget.anatomy.distance import signed_distance
from retarget.anatomy.head import HeadTemplate
from retarget.anatomy.muscle import muscle_tets
from retarget.anatomy.store import load_template
from retarget.anatomy.template import build_template
from retarget.anatomy.tissue import Tissue
from retarget.check import InvalidInput
from retarget.simulation.tetrahedra import rest_shape
from retarget.types import FloatArray, IntArray
from synth_data.makehuman.author_template import Level, levels


@cache
def heads() -> list[Level]:
    return levels()


@cache
def template(level: int, size: str) -> HeadTemplate:
    _, faces, regions = heads()[level]
    return load_template(faces, regions, size)


def outer_side(head: HeadTemplate) -> tuple[IntArray, IntArray]:
    """The triangles of the tets' boundary on the skin, and their tets."""
    triangles, owner = boundary_faces(head.tets)
    outer = ~np.isin(triangles, head.skull).all(axis=1)
    return triangles[outer], owner[outer]


def test_the_sizes_are_at_least_those_of_the_paper() -> None:
    paper = template(0, "paper")
    assert len(np.unique(boundary_faces(paper.tets)[0])) >= 29_800
    assert len(paper.vertices) >= 60_000
    assert len(paper.tets) >= 234_000
    assert 8_000 < len(template(0, "coarse").vertices) < 12_000


@pytest.mark.parametrize("size", ["coarse", "paper"])
def test_the_tets_fill_what_lies_between_skin_and_skull(size: str) -> None:
    head = template(0, size)
    rest_shape(head.vertices, head.tets)  # refuses flat and inverted tets
    wanted = enclosed_volume(*cap("skin", head.skin, head.faces)) - enclosed_volume(head.vertices, head.skull_faces)
    assert signed_volumes(head.vertices, head.tets).sum() == pytest.approx(wanted, rel=0.005)


@pytest.mark.parametrize("size", ["coarse", "paper"])
def test_the_skull_is_closed_and_lies_under_the_skin(size: str) -> None:
    head = template(0, size)
    faces = head.skull_faces
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, uses = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    assert (uses == 2).all()
    assert len(np.unique(edges, axis=0)) == len(edges)  # oriented alike
    assert enclosed_volume(head.vertices, faces) > 0
    assert signed_distance(cap("skin", head.skin, head.faces), head.vertices[head.skull]).min() > 0.3


@pytest.mark.parametrize("size", ["coarse", "paper"])
def test_bones_are_disjoint_parts_of_the_skull_with_a_gap(size: str) -> None:
    head = template(0, size)
    assert len(np.intersect1d(head.cranium, head.jaw)) == 0
    assert np.isin(head.fixed, head.skull).all()
    assert len(head.cranium) > 2 * len(head.jaw) > 0
    assert len(np.setdiff1d(head.skull, head.fixed)) > 0
    gap, _ = cKDTree(head.vertices[head.cranium]).query(head.vertices[head.jaw])
    assert gap.min() > 2.0
    chin = head.skin[head.regions.landmarks["menton"]]
    nearest = head.skull[np.argmin(np.linalg.norm(head.vertices[head.skull] - chin, axis=1))]
    assert nearest in head.jaw


def test_bones_do_not_depend_on_where_the_head_is() -> None:
    head = template(0, "coarse")
    angle = 0.7
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])

    def moved(points: FloatArray) -> FloatArray:
        return points @ turn.T + [100.0, -50, 30]

    cranium, jaw = label_bones(moved(head.skin), head.regions, moved(head.vertices), head.skull)
    assert np.array_equal(cranium, head.cranium)
    assert np.array_equal(jaw, head.jaw)


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize("size", ["coarse", "paper"])
def test_the_skin_is_embedded_without_residual(level: int, size: str) -> None:
    head = template(level, size)
    assert np.abs(head.skin - heads()[level][0]).max() < 1e-4
    assert np.abs(head.skin - head.embedding @ head.vertices).max() < 1e-6
    assert np.abs(head.embedding.data).max() <= 1.5


def test_lips_and_lids_are_not_glued() -> None:
    """No tet reaches from one lip to the other, or from lid to lid, away from the corners."""
    head = template(0, "paper")
    marks, parts = head.regions.landmarks, head.regions.vertices
    pairs = [("upper_lip", "lower_lip", "cheilion_left", "cheilion_right", 6.0)]
    for side in ("left", "right"):
        lids = (f"lid_margin_upper_{side}", f"lid_margin_lower_{side}")
        pairs.append((*lids, f"exocanthion_{side}", f"endocanthion_{side}", 3.0))
    outside, _ = outer_side(head)
    rim = np.unique(outside)
    inward = -_normals(head.skin, head.faces), -_normals(head.vertices, outside)[rim]
    distance, near = cKDTree(head.skin).query(head.vertices[rim], k=16)
    alike = np.einsum("ijk,ik->ij", inward[0][near], inward[1]) > 0
    first = np.argmax(alike, axis=1)[:, None]
    owner = np.where(
        np.take_along_axis(distance, first, 1) < 1.5, np.take_along_axis(near, first, 1), -1
    )[:, 0]  # fmt: skip
    for upper, lower, *corners, reach in pairs:
        ends = head.skin[[marks[name] for name in corners]]
        sides = []
        for name in (upper, lower):
            away = np.linalg.norm(head.skin[parts[name], None] - ends, axis=2).min(axis=1) > reach
            member = np.zeros(len(head.vertices), dtype=bool)
            member[rim[np.isin(owner, parts[name][away])]] = True
            sides.append(member)
            assert member.sum() >= 4
        assert not (sides[0][head.tets].any(axis=1) & sides[1][head.tets].any(axis=1)).any()


def _normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    at_faces = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    sums = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(sums, faces[:, corner], at_faces)
    return sums


@pytest.mark.parametrize("size", ["coarse", "paper"])
def test_muscle_lies_deep_in_the_face_alone(size: str) -> None:
    head = template(0, size)
    centres = head.vertices[head.tets[head.muscle]].mean(axis=1)
    assert 0.15 < head.muscle.mean() < 0.5
    depth = signed_distance(cap("skin", head.skin, head.faces), centres)
    assert depth.min() > 0
    parts = head.regions.vertices
    outer = np.setdiff1d(np.arange(len(head.skin)), parts["interior"])
    nearest = outer[cKDTree(head.skin[outer]).query(centres)[1]]
    for name in ("scalp", "ears", "neck", "eyes"):
        assert not np.isin(nearest, np.setdiff1d(parts[name], parts["face"])).any(), name
    _, at_skin = outer_side(head)
    assert not head.muscle[at_skin].any()


def test_muscle_is_labelled_as_stored() -> None:
    head = template(0, "coarse")
    tissue = Tissue(head.vertices, head.tets, head.skull_faces)
    assert np.array_equal(muscle_tets(head.skin, head.faces, head.regions, tissue), head.muscle)


def test_bad_input_is_refused_before_meshing() -> None:
    skin, faces, regions = heads()[0]
    with pytest.raises(InvalidInput, match="size: expected one of coarse, paper, got 'huge'"):
        build_template(skin, faces, regions, size="huge")
    broken = skin.copy()
    broken[100] = np.nan
    with pytest.raises(InvalidInput, match="surface: 1 vertices are NaN"):
        build_template(broken, faces, regions)
    points = {name: point for name, point in regions.points.items() if name != "condyle_left"}
    with pytest.raises(InvalidInput, match=r"points\['condyle_left'\] missing"):
        build_template(skin, faces, replace(regions, points=points))
    loops = {name: loop for name, loop in regions.loops.items() if name != "lip_inner"}
    with pytest.raises(InvalidInput, match=r"loops\['lip_inner'\] missing"):
        build_template(skin, faces, replace(regions, loops=loops))
    landmarks = {name: vertex for name, vertex in regions.landmarks.items() if name != "menton"}
    with pytest.raises(InvalidInput, match=r"the head model lacks menton; give this topology a regions file"):
        build_template(skin, faces, replace(regions, landmarks=landmarks))


def test_crossing_and_torn_surfaces_are_refused_before_meshing() -> None:
    skin, faces, regions = heads()[0]
    through = skin.copy()
    through[regions.landmarks["pronasale"], 2] -= 60.0
    with pytest.raises(InvalidInput, match="self-intersections"):
        build_template(through, faces, regions)
    doubled = np.vstack([faces, faces[:1]])
    with pytest.raises(InvalidInput, match="at most two triangles at an edge"):
        build_template(skin, doubled, regions)
    with pytest.raises(InvalidInput, match="expected one opening, the neck, got 1 more, the first of 3 edges"):
        build_template(skin, np.delete(faces, 100, axis=0), regions)
    with pytest.raises(InvalidInput, match=r"mm from corner to corner, got 0\.386"):
        build_template(skin / 1000, faces, regions)


def test_labels_without_a_jaw_are_refused() -> None:
    head = template(0, "coarse")
    with pytest.raises(InvalidInput, match="expected a cranium and a jaw"):
        label_bones(head.skin, head.regions, head.vertices, head.cranium)
