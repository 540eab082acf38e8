"""The regions file and the files beside it: round trips, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from retarget.anatomy.skin import isolate_skin
from retarget.check import InvalidInput
from retarget.io.landmarks import read_landmarks
from retarget.io.mesh import read_mesh, write_obj
from retarget.io.regions import encode, read_regions, write_regions
from retarget.types import AffinePoint, Regions
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.targets import load_head

BALL = trimesh.creation.icosphere(1)
FACES = np.asarray(BALL.faces, dtype=np.int64)
EQUAL = {"vertices": {}, "loops": {}, "triangles": {}, "patches": {}, "landmarks": {}, "points": {}, "mirror": None}


def small() -> Regions:
    return Regions(
        vertices={"some": np.array([0, 1, 2, 7, 9, 10]), "none": np.array([], dtype=np.int64)},
        loops={"triangle": FACES[3]},
        triangles={"first": np.arange(4)},
        patches={"across": FACES[5:7]},
        landmarks={"pole": 4},
        points={"inside": AffinePoint(np.array([1, 8]), np.array([0.3, 0.7]))},
    )


def test_regions_come_back_from_a_file(tmp_path: Path) -> None:
    write_regions(tmp_path / "regions.json", small())
    again = read_regions(tmp_path / "regions.json", len(BALL.vertices), FACES)
    assert encode(again) == encode(small())
    assert again.mirror is None
    np.testing.assert_array_equal(again.vertices["some"], [0, 1, 2, 7, 9, 10])
    np.testing.assert_array_equal(again.points["inside"].weights, [0.3, 0.7])


def test_the_shipped_regions_fit_their_head(tmp_path: Path) -> None:
    base, _ = load_head()
    write_regions(tmp_path / "regions.json", load_regions())
    again = read_regions(tmp_path / "regions.json", len(base.vertices), base.faces)
    assert encode(again) == encode(load_regions())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"vertices": {"some": "3-90"}}, r"vertices\['some'\] names vertices 3 to 90, expected 0 to 41"),
        ({"vertices": {"some": "3-x"}}, r"vertices\['some'\] cannot be read"),
        ({"vertices": {"some": "5 3"}}, r"vertices\['some'\] is not ascending"),
        ({"loops": {"far": [0, 41, 7]}}, r"loops\['far'\] is no closed chain of edges"),
        ({"patches": {"flat": [0, 1, 1]}}, r"patches\['flat'\] has a triangle with a corner twice"),
        ({"patches": {"odd": [0, 1]}}, r"patches\['odd'\] cannot be read"),
        ({"landmarks": {"pole": 42}}, "landmarks names vertices 42 to 42"),
        ({"points": {"p": {"indices": [0, 1], "weights": [0.5, 0.6]}}}, "the sum 1.1, expected as many of both"),
        ({"points": {"p": {"indices": [0, 1]}}}, r"points\['p'\] cannot be read"),
        ({"mirror": [1, 2, 0]}, "mirror is no pairing of all 42 vertices"),
        ({"regions": {}}, "unknown parts regions"),
        ({"loops": []}, "expected an object with the parts"),
    ],
)
def test_a_file_that_does_not_fit_is_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = tmp_path / "regions.json"
    path.write_text(json.dumps(EQUAL | changes))
    with pytest.raises(InvalidInput, match=message):
        read_regions(path, len(BALL.vertices), FACES)


def test_what_is_no_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "regions.json").write_text("{\n'loops': 3}")
    with pytest.raises(InvalidInput, match="expected JSON, but line 2 is none"):
        read_regions(tmp_path / "regions.json", 3, FACES)
    with pytest.raises(InvalidInput, match="found none"):
        read_regions(tmp_path / "absent.json", 3, FACES)


def test_obj_keeps_its_vertices_where_textures_have_seams(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text(
        "# a quad and a triangle\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 1e-3\nvt 0 0\nvt 1 0\n"
        "f 1/1 2/2 3/1 4/2\nf -1//1 3/2 2/1\n"
    )
    vertices, faces = read_mesh(tmp_path / "m.obj")
    assert vertices.shape == (5, 3)
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 2, 1]]


def test_meshes_come_back_from_files(tmp_path: Path) -> None:
    v = np.round(np.asarray(BALL.vertices) * 90, 6)
    write_obj(tmp_path / "ball.obj", v, FACES)
    trimesh.Trimesh(v, FACES, process=False).export(tmp_path / "ball.ply")
    for name, digits in (("ball.obj", 1e-9), ("ball.ply", 1e-4)):
        vertices, faces = read_mesh(tmp_path / name)
        np.testing.assert_allclose(vertices, v, atol=digits)
        np.testing.assert_array_equal(faces, FACES)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.obj", "v 0 0\n", "line 1 cannot be read as OBJ"),
        ("a.obj", "v 0 0 zero\n", "line 1 cannot be read as OBJ"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "indices reach from 0 to 3, expected 0 to 2"),
        ("a.obj", "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "NaN"),
        ("a.obj", "v 0 0 0\n", "expected at least one triangle"),
        ("a.ply", "no ply", "cannot be read"),
        ("a.stl", "", "expected .obj, .ply or .npz"),
    ],
)
def test_bad_meshes_are_refused(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InvalidInput, match=message):
        read_mesh(tmp_path / name)


def test_landmarks_with_their_unit(tmp_path: Path) -> None:
    path = tmp_path / "landmarks.json"
    path.write_text('{"unit": "cm", "landmarks": {"nasion": 3}}')
    assert read_landmarks(path) == (10.0, {"nasion": 3})
    path.write_text('{"landmarks": {"nasion": 3}}')
    assert read_landmarks(path) == (1.0, {"nasion": 3})
    for text, message in (
        ('{"unit": "ell", "landmarks": {"nasion": 3}}', "unit 'ell' unknown"),
        ('{"nasion": 3}', "expected {"),
        ('{"landmarks": {"nasion": 3.5}}', "expected {"),
        ("nasion 3", "expected JSON"),
    ):
        path.write_text(text)
        with pytest.raises(InvalidInput, match=message):
            read_landmarks(path)


def test_the_skin_is_the_piece_with_the_landmarks() -> None:
    n = len(BALL.vertices)
    both = np.vstack([FACES, FACES + n])
    kept, faces = isolate_skin(both, 2 * n, {"nasion": n + 1, "menton": n + 5})
    np.testing.assert_array_equal(kept, np.arange(n, 2 * n))
    np.testing.assert_array_equal(faces, FACES)
    with pytest.raises(InvalidInput, match="got 2 pieces; menton may sit on"):
        isolate_skin(both, 2 * n, {"nasion": 1, "pronasale": 2, "menton": n + 5})
    with pytest.raises(InvalidInput, match="expected a vertex from 0 to 83, got 84"):
        isolate_skin(both, 2 * n, {"nasion": 2 * n})
