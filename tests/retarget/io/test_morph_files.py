"""NumPy archives and OBJ sequences of meshes with shapes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from retarget.check import InvalidInput
from retarget.io.files import write_whole_folder
from retarget.io.mesh import read_mesh
from retarget.io.morph_mesh import MorphMesh, flipbook
from retarget.io.npz import read_npz, write_npz
from retarget.io.obj_sequence import write_obj_sequence
from tests.retarget.io.test_gltf import FACES, NEUTRAL, performance


def test_an_archive_comes_back_as_it_was(tmp_path: Path) -> None:
    mesh = replace(performance(), about={"truth": "toy", "linear": True})
    write_npz(tmp_path / "a.npz", FACES, mesh)
    faces, back = read_npz(tmp_path / "a.npz")
    assert faces.tolist() == FACES.tolist()
    np.testing.assert_allclose(back.shapes, mesh.shapes, atol=1e-5)  # float32 at 100 mm
    assert (back.name, back.shape_names, back.about) == (mesh.name, mesh.shape_names, mesh.about)
    for k in range(len(mesh.times)):
        np.testing.assert_allclose(back.at(k), mesh.shapes[k], atol=1e-5)


def test_archives_are_equal_to_the_bit_and_hold_no_objects(tmp_path: Path) -> None:
    for name in "ab":
        write_npz(tmp_path / f"{name}.npz", FACES, performance())
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert all(archive[key].dtype != object for key in archive.files)


@pytest.mark.parametrize("content", [b"", b"no archive", None])
def test_a_file_that_is_no_export_is_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "a.npz"
    if content is None:
        np.savez(path, vertices=NEUTRAL)
    else:
        path.write_bytes(content)
    with pytest.raises(InvalidInput, match=r"a\.npz"):
        read_npz(path)


def test_an_obj_sequence_keeps_the_order_of_vertices_and_triangles(tmp_path: Path) -> None:
    mesh = performance()
    write_obj_sequence(tmp_path / "someone", FACES, mesh)
    assert {path.stem for path in (tmp_path / "someone").iterdir()} == {"neutral", *mesh.shape_names}
    for name, expected in zip(("neutral", *mesh.shape_names), (NEUTRAL, *mesh.shapes), strict=True):
        vertices, faces = read_mesh(tmp_path / "someone" / f"{name}.obj")
        np.testing.assert_allclose(vertices, expected, atol=1e-6)
        assert faces.tolist() == FACES.tolist()


@pytest.mark.parametrize("name", ["../up", "neutral", "Neutral", "a/b", ".hidden"])
def test_names_that_are_no_files_of_their_own_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InvalidInput, match="rename"):
        write_obj_sequence(tmp_path / "x", FACES, flipbook("a", NEUTRAL, NEUTRAL[None], [name], [0.0]))


def test_shapes_blend_linearly() -> None:
    shapes = np.stack([np.add(NEUTRAL, [1.0, 0, 0]), np.add(NEUTRAL, [0, 2.0, 0])])
    mesh = MorphMesh("a", NEUTRAL, shapes, ("x", "y"), np.zeros(1), np.array([[0.5, 0.25]]))
    np.testing.assert_allclose(mesh.at(0), np.add(NEUTRAL, [0.5, 0.5, 0]))


def test_arrays_that_do_not_fit_and_names_given_twice_are_refused() -> None:
    with pytest.raises(InvalidInput, match="shapes"):
        flipbook("a", NEUTRAL, NEUTRAL[None], ["x", "y"], [0.0, 1.0])
    with pytest.raises(InvalidInput, match="'x'"):
        flipbook("a", NEUTRAL, np.stack([NEUTRAL] * 2), ["x", "x"], [0.0, 1.0])
    with pytest.raises(InvalidInput, match="increasing"):
        flipbook("a", NEUTRAL, np.stack([NEUTRAL] * 2), ["x", "y"], [1.0, 1.0])


def test_a_folder_is_replaced_when_the_new_one_is_whole(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    write_whole_folder(folder, lambda new: (new / "old").write_text("old"))

    def fails(new: Path) -> None:
        (new / "half").write_text("")
        raise OSError(28, "No space left on device")

    with pytest.raises(InvalidInput, match="No space"):
        write_whole_folder(folder, fails)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert [path.name for path in folder.iterdir()] == ["old"]
    write_whole_folder(folder, lambda new: (new / "new").write_text("new"))
    assert [path.name for path in folder.iterdir()] == ["new"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
