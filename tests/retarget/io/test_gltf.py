from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from retarget.check import InvalidInput
from retarget.geometry.oriented import vertex_normals
from retarget.io import gltf
from retarget.io.gltf import write_glb
from retarget.io.morph_mesh import MorphMesh, flipbook
from tests.retarget.io.glb import Glb

SPHERE = trimesh.creation.icosphere(subdivisions=2, radius=90.0)
FACES = np.asarray(SPHERE.faces, dtype=np.int64)
NEUTRAL = np.asarray(SPHERE.vertices)


def performance(name: str = "someone", frames: int = 5) -> MorphMesh:
    """Smooth bumps that grow: the first leaves most vertices alone, the last moves all."""
    rng = np.random.default_rng(3)
    reach = np.linspace(10, 90, frames)[:, None]
    bump = np.exp(-((90 - NEUTRAL[:, 2]) ** 2) / (2 * reach**2))
    bump[bump < 0.05] = 0
    shapes = NEUTRAL + bump[:, :, None] * rng.normal(size=(frames, 1, 3)) * 9
    return flipbook(name, NEUTRAL, shapes, [f"frame_{i}" for i in range(frames)], np.arange(frames) / 4)


@pytest.fixture
def stored(tmp_path: Path) -> Glb:
    write_glb(tmp_path / "a.glb", FACES, [performance()], {"unit": "m"})
    return Glb.read(tmp_path / "a.glb")


def test_a_file_read_back_wears_each_frame_at_its_time(stored: Glb) -> None:
    mesh = performance()
    for k, time in enumerate(mesh.times):
        np.testing.assert_allclose(1e3 * stored.shape(0, stored.weights(0, time)), mesh.shapes[k], atol=2e-5)
    between = 0.5 * (mesh.shapes[1] + mesh.shapes[2])
    np.testing.assert_allclose(1e3 * stored.shape(0, stored.weights(0, 0.375)), between, atol=2e-5)


def test_normals_are_those_of_each_frame(stored: Glb) -> None:
    mesh = performance()
    for k, time in enumerate(mesh.times):
        expected = vertex_normals(mesh.shapes[k], FACES)
        np.testing.assert_allclose(stored.shape(0, stored.weights(0, time), "NORMAL"), expected, atol=1e-6)


def test_the_neutral_is_shown_before_anything_plays_and_triangles_are_kept(stored: Glb) -> None:
    mesh = stored.scene["meshes"][0]
    np.testing.assert_allclose(1e3 * stored.shape(0, np.array(mesh["weights"])), NEUTRAL, atol=1e-5)
    assert stored.accessor(mesh["primitives"][0]["indices"]).tolist() == FACES.ravel().tolist()


def test_names_are_where_blender_and_three_js_look_for_them(stored: Glb) -> None:
    assert stored.scene["meshes"][0]["extras"]["targetNames"] == [f"frame_{i}" for i in range(5)]
    assert stored.scene["nodes"][0]["name"] == "someone"
    assert stored.scene["scenes"][0]["extras"] == {"unit": "m"}


def test_what_moves_little_is_sparse_and_what_does_not_move_takes_no_space(tmp_path: Path) -> None:
    still = MorphMesh("a", NEUTRAL, NEUTRAL[None], ("still",), np.zeros(1), np.ones((1, 1)))
    write_glb(tmp_path / "still.glb", FACES, [still])
    glb = Glb.read(tmp_path / "still.glb")
    target = glb.scene["meshes"][0]["primitives"][0]["targets"][0]
    assert {"bufferView", "sparse"}.isdisjoint(glb.scene["accessors"][target["POSITION"]])
    write_glb(tmp_path / "moves.glb", FACES, [performance()])
    glb = Glb.read(tmp_path / "moves.glb")
    first, *_, last = (target["POSITION"] for target in glb.scene["meshes"][0]["primitives"][0]["targets"])
    assert "sparse" in glb.scene["accessors"][first]
    assert "sparse" not in glb.scene["accessors"][last]


def test_characters_stand_side_by_side_without_touching(tmp_path: Path) -> None:
    write_glb(tmp_path / "a.glb", FACES, [performance(name) for name in "abc"])
    glb = Glb.read(tmp_path / "a.glb")
    x = [node["translation"][0] for node in glb.scene["nodes"]]
    assert x[0] == -x[2]
    assert x[1] == 0
    assert x[2] > 0.18  # the spheres are 180 mm wide
    assert len(glb.scene["animations"]) == 1  # one clip plays all
    assert len(glb.scene["animations"][0]["channels"]) == 3


def test_another_reader_finds_the_same_neutral(tmp_path: Path) -> None:
    write_glb(tmp_path / "a.glb", FACES, [performance()])
    mesh = trimesh.load_scene(tmp_path / "a.glb", process=False).to_geometry()
    np.testing.assert_allclose(1e3 * np.asarray(mesh.vertices), NEUTRAL, atol=1e-5)
    assert np.asarray(mesh.faces).tolist() == FACES.tolist()


def test_same_meshes_same_bits(tmp_path: Path) -> None:
    for name in "ab":
        write_glb(tmp_path / f"{name}.glb", FACES, [performance()])
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()


def test_a_mesh_without_shapes_is_a_plain_mesh(tmp_path: Path) -> None:
    plain = MorphMesh("a", NEUTRAL, np.empty((0, *NEUTRAL.shape)), (), np.empty(0), np.empty((0, 0)))
    write_glb(tmp_path / "a.glb", FACES, [plain])
    scene = Glb.read(tmp_path / "a.glb").scene
    assert "animations" not in scene
    assert "targets" not in scene["meshes"][0]["primitives"][0]


def test_vertices_without_a_triangle_have_a_normal_of_length_one(tmp_path: Path) -> None:
    neutral = np.vstack([NEUTRAL, [0.0, 0.0, 0.0]])
    write_glb(tmp_path / "a.glb", FACES, [flipbook("a", neutral, neutral[None], ["x"], [0.0])])
    normals = Glb.read(tmp_path / "a.glb").shape(0, np.zeros(1), "NORMAL")
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)


def test_more_than_a_container_can_count_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gltf, "LARGEST", 10_000)
    with pytest.raises(InvalidInput, match="GiB"):
        write_glb(tmp_path / "a.glb", FACES, [performance()])
    assert not list(tmp_path.iterdir())
