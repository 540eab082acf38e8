"""Meshes keep their vertices' numbers, whatever the file says besides positions and polygons."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from retarget.check import InvalidInput
from retarget.io.mesh import read_mesh
from retarget.io.obj import ObjText

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.125]], dtype=np.float64)


@pytest.mark.parametrize(
    "lines",
    [
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0.125\nf 1 2 3 4\n",
        "v 0 0 0\r\nv 1 0 0\r\nv 1 1 0\r\nv 0 1 1.25e-1\r\nf 1/1/1 2/2/1 3/3/1 4/4/1\r\n",
        "  v 0 0 0\n\tv\t1  0 0\nv 1 1 0 1.0\nv 0 1 .125 0.5 0.5 0.5\nvn 0 0 1\nvt 0 0\nf -4 -3 -2 -1",  # w, colours
        "# v 9 9 9\nv 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nv 0 1 0.125\nf 1//7 3//7 4//7\n",
    ],
)
def test_obj_in_every_spelling(tmp_path: Path, lines: str) -> None:
    (tmp_path / "a.obj").write_bytes(lines.encode())
    vertices, faces = read_mesh(tmp_path / "a.obj")
    np.testing.assert_array_equal(vertices, SQUARE)
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_a_short_line_is_named_though_the_number_of_fields_fits() -> None:
    text = ObjText.of("a.obj", b"v 0 0\nv 1 2 3 4\nv 0 0 1\n")
    with pytest.raises(InvalidInput, match=r"a\.obj: line 1 cannot be read as OBJ: 'v 0 0'"):
        text.vertices()


def test_polygon_digest_sees_polygons_alone() -> None:
    one, moved, other = (
        ObjText.of("", text).polygon_digest()
        for text in (b"v 0 0 0\nf 1 2 3\n", b"# \nv 1 0 0\nvt 1 1\nf 1 2 3\n", b"v 0 0 0\nf 1 3 2\n")
    )
    assert one == moved != other


def test_ply_keeps_its_vertices_where_textures_have_seams(tmp_path: Path) -> None:
    head = "ply\nformat ascii 1.0\ncomment TextureFile none.png\nelement vertex 4\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "element face 2\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n"
    corners = "3 0 1 2 6 0 0 1 0 1 1\n3 0 2 3 6 .5 0 .5 .5 0 1\n"
    (tmp_path / "a.ply").write_text(head + "".join(f"{x} {y} {z}\n" for x, y, z in SQUARE) + corners)
    vertices, faces = read_mesh(tmp_path / "a.ply")
    np.testing.assert_array_equal(vertices, SQUARE)
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_npz_holds_vertices_and_faces_and_is_never_unpickled(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, vertices=SQUARE, faces=[[0, 1, 2], [0, 2, 3]])
    np.testing.assert_array_equal(read_mesh(path)[0], SQUARE)
    np.savez(path, vertices=SQUARE)
    with pytest.raises(InvalidInput, match="array 'faces'"):
        read_mesh(path)
    np.savez(path, positions=SQUARE)
    with pytest.raises(InvalidInput, match=r"array .vertices. .* got positions"):
        read_mesh(path)
    np.savez(path, vertices=np.array([{}], dtype=object))
    with pytest.raises(InvalidInput, match=r"a\.npz: .* never opened"):
        read_mesh(path)
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(InvalidInput, match=r"a\.npz: .* cannot be read"):
        read_mesh(path)
