"""The skull under MakeHuman's head, on a coarse grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from retarget.anatomy.closed import cap, check_closed
from retarget.anatomy.crossings import self_intersections
from retarget.anatomy.depths import depths_with_room, landmark_depths, load_depths
from retarget.anatomy.distance import distance_to, signed_distance
from retarget.anatomy.skull import Skull, bridge_skin, build_skull
from retarget.check import InvalidInput
from retarget.types import FloatArray, IntArray
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.targets import load_head

KNOWN_OFF = {"gonion_left", "gonion_right", "sub_m2_left", "sub_m2_right", "rhinion"}  # on a grid of 3 mm
IN_THE_MOUTH = {"mid_philtrum", "prosthion", "infradentale", "supramentale"}  # bone inside the mesh's mouth cavity


@pytest.fixture(scope="module")
def head() -> tuple[FloatArray, IntArray]:
    base, targets = load_head()
    return cap("head", base.vertices + 0.3 * targets["units/jawOpen"], base.faces)


@pytest.fixture(scope="module")
def skull(head: tuple[FloatArray, IntArray]) -> Skull:
    return build_skull(*head, load_regions(), landmark_depths(load_depths(), load_regions()), spacing=3.0)


def test_the_posed_template_head_is_closed(head: tuple[FloatArray, IntArray]) -> None:
    check_closed("head", *head)


def test_the_skull_is_closed_faces_outward_and_does_not_cross_itself(skull: Skull) -> None:
    mesh = trimesh.Trimesh(skull.vertices, skull.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert all(piece.volume > 1000 for piece in mesh.split())  # mm^3, outward
    assert len(self_intersections(skull.vertices, skull.faces)) == 0


def test_reported_errors_are_the_distances_measured_again(skull: Skull, head: tuple[FloatArray, IntArray]) -> None:
    regions, depths = load_regions(), landmark_depths(load_depths(), load_regions())
    assert set(skull.errors) == set(depths) - IN_THE_MOUTH
    names = ["nasion", "zygion_left", "menton"]
    points = head[0][[regions.landmarks[name] for name in names]]
    for name, distance in zip(names, distance_to((skull.vertices, skull.faces), points), strict=True):
        assert skull.errors[name] == pytest.approx(distance - depths[name])


def test_depths_at_the_landmarks_are_kept(skull: Skull) -> None:
    off = {name: error for name, error in skull.errors.items() if abs(error) > 1.0}
    assert set(off) <= KNOWN_OFF, off
    assert max(map(abs, off.values()), default=0.0) < 3.0


def test_the_skull_lies_under_all_skin(skull: Skull, head: tuple[FloatArray, IntArray]) -> None:
    assert signed_distance(head, skull.vertices).min() > 1.0
    assert signed_distance((skull.vertices, skull.faces), head[0]).max() < -1.0  # mouth and sockets included


def test_landmarks_without_room_before_the_mouth_carry_no_depth(head: tuple[FloatArray, IntArray]) -> None:
    depths = landmark_depths(load_depths(), load_regions())
    assert set(depths) - set(depths_with_room(*head, load_regions(), depths)) == IN_THE_MOUTH
    assert depths_with_room(*head, load_regions(), {"prosthion": 2.0}) == {"prosthion": 2.0}


def test_the_skull_is_symmetric_where_the_head_is(skull: Skull) -> None:
    off = distance_to((skull.vertices, skull.faces), skull.vertices * [-1, 1, 1])
    assert np.percentile(off, 99) < 1.0
    assert off.max() < 3.0  # one step of the grid, which is not symmetric


def test_thicker_tissue_makes_a_smaller_skull(skull: Skull, head: tuple[FloatArray, IntArray]) -> None:
    depths = {name: depth + 2.0 for name, depth in landmark_depths(load_depths(), load_regions()).items()}
    thick = build_skull(*head, load_regions(), depths, spacing=4.0)
    assert (np.ptp(thick.vertices, axis=0) < np.ptp(skull.vertices, axis=0)).all()


def test_a_head_in_another_unit_is_refused(head: tuple[FloatArray, IntArray]) -> None:
    depths = landmark_depths(load_depths(), load_regions())
    with pytest.raises(InvalidInput, match="expected room for it under the skin"):
        build_skull(0.1 * head[0], head[1], load_regions(), depths, spacing=0.6)
    with pytest.raises(InvalidInput, match=r"in \(0, 24\] mm, got \[7.0, 500.0\]"):
        build_skull(*head, load_regions(), {"nasion": 7.0, "menton": 500.0})
    with pytest.raises(InvalidInput, match="names of landmarks, got 'chin'"):
        build_skull(*head, load_regions(), {"nasion": 7.0, "chin": 10.0})
    with pytest.raises(InvalidInput, match="room for bone before mouth and eye sockets, got none"):
        build_skull(0.001 * head[0], head[1], load_regions(), depths)


def test_missing_parts_are_named(head: tuple[FloatArray, IntArray]) -> None:
    regions = load_regions()
    less = replace(regions, vertices={k: v for k, v in regions.vertices.items() if k != "ears"})
    with pytest.raises(InvalidInput, match=r"the head model lacks ears; give this topology a regions file"):
        build_skull(*head, less, {"nasion": 7.0})


def test_bridging_flattens_ears_and_keeps_the_face(head: tuple[FloatArray, IntArray]) -> None:
    regions = load_regions()
    bridged = bridge_skin(*head, regions)
    changed = [regions.vertices[name] for name in ("lips", "nose", "ears", "interior")]
    kept = np.setdiff1d(np.arange(len(bridged)), np.concatenate(changed))
    assert np.array_equal(bridged[kept], head[0][kept])
    ears = regions.vertices["ears"]
    assert np.abs(bridged[ears, 0]).max() < np.abs(head[0][ears, 0]).max() - 5
