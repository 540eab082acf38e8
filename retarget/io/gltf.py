"""Meshes with morph targets as binary glTF 2.0 (ISO/IEC 12113): one ``.glb`` that Blender and three.js open.

Written here because the well-known exporters in Python know no morph targets, or leave accessors to the caller.
glTF is in metres, +y up and +z to the front, so that millimetres are scaled and nothing is turned. Displacements that
are zero at most vertices are stored as sparse accessors, without loss.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from retarget.check import InvalidInput
from retarget.geometry.oriented import vertex_normals
from retarget.io.files import write_whole
from retarget.io.morph_mesh import MorphMesh
from retarget.types import FloatArray, IntArray

METRES = 1e-3  # per mm
LARGEST = 2**32 - 1  # bytes that a GLB container can count
SPACING = 1.15  # distance of neighbours over the width of the widest
SKIN = {  # of a person; light enough that form reads in any viewer
    "name": "skin",
    "doubleSided": True,
    "pbrMetallicRoughness": {"baseColorFactor": [0.72, 0.53, 0.43, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.6},
}
_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125  # component types
_VERTICES, _TRIANGLES = 34962, 34963  # targets of buffer views

Float32 = NDArray[np.float32]


def write_glb(
    path: Path | str,
    faces: IntArray,
    meshes: Sequence[MorphMesh],
    about: Mapping[str, Any] | None = None,
    normals: bool = True,
    advance: Callable[[int], None] = lambda targets: None,
) -> None:
    """Meshes of one topology, faces (f, 3), side by side in one scene, with one animation that plays all of them.

    `normals` stores the change of the normals with each target: smooth shading where the viewer does not compute it
    (three.js), at twice the size. `about` becomes extras of the scene; `advance` is told of finished targets. Raises
    InvalidInput for more than 4 GiB and where the file cannot be written.
    """
    buffer = _Buffer()
    indices = buffer.triangles(faces, max(len(mesh.neutral) for mesh in meshes))
    width = SPACING * max(float(np.ptp(mesh.neutral[:, 0])) for mesh in meshes)
    nodes: list[dict[str, Any]] = []
    stored: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []
    for i, mesh in enumerate(meshes):
        primitive = {"indices": indices, "material": 0, **_shapes(buffer, faces, mesh, normals, advance)}
        stored.append({"name": mesh.name, "primitives": [primitive]})
        if mesh.shape_names:
            stored[-1]["weights"] = [0.0] * len(mesh.shape_names)
            stored[-1]["extras"] = {"targetNames": list(mesh.shape_names)}
        aside = METRES * width * (i - (len(meshes) - 1) / 2)
        nodes.append({"name": mesh.name, "mesh": i, "translation": [aside, 0.0, 0.0], "extras": dict(mesh.about)})
        if len(mesh.times) and len(mesh.shape_names):
            channels.append({"sampler": len(samplers), "target": {"node": i, "path": "weights"}})
            times, weights = buffer.scalars(mesh.times, bounds=True), buffer.scalars(mesh.weights)
            samplers.append({"input": times, "output": weights, "interpolation": "LINEAR"})
    scene: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "anacondar"},
        "scene": 0,
        "scenes": [{"name": "faces", "nodes": list(range(len(nodes))), "extras": dict(about or {})}],
        "nodes": nodes,
        "meshes": stored,
        "materials": [SKIN],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": buffer.size}],
    }
    if channels:
        scene["animations"] = [{"name": "performance", "channels": channels, "samplers": samplers}]
    _write(Path(path), scene, buffer)


def _shapes(
    buffer: _Buffer, faces: IntArray, mesh: MorphMesh, normals: bool, advance: Callable[[int], None]
) -> dict[str, Any]:
    """Attributes of the neutral and displacements of the targets, of a primitive."""
    rest = mesh.neutral.astype(mesh.shapes.dtype)  # rounded like the shapes, so that what does not move is zero
    neutral, upright = _metres(rest), _unit_normals(rest, faces)
    primitive: dict[str, Any] = {
        "attributes": {"POSITION": buffer.vectors(neutral, bounds=True), "NORMAL": buffer.vectors(upright)},
        "targets": [],
    }
    for shape in mesh.shapes:
        target = {"POSITION": buffer.vectors(_metres(shape - rest), bounds=True, sparse=True)}
        if normals:
            target["NORMAL"] = buffer.vectors(_unit_normals(shape, faces) - upright, sparse=True)
        primitive["targets"].append(target)
        advance(1)
    return primitive if len(mesh.shapes) else {"attributes": primitive["attributes"]}


def _metres(vertices: NDArray[np.floating[Any]]) -> Float32:
    return np.asarray(METRES * vertices.astype(np.float64), dtype=np.float32)


def _unit_normals(vertices: NDArray[np.floating[Any]], faces: IntArray) -> Float32:
    """(n, 3) of length one, as glTF asks; +z where no triangle gives one."""
    found: FloatArray = vertex_normals(vertices.astype(np.float64), faces)
    found[np.linalg.norm(found, axis=1) < 0.5] = (0.0, 0.0, 1.0)
    return found.astype(np.float32)


class _Buffer:
    """The binary chunk as it grows, with the views and accessors that describe it."""

    def __init__(self) -> None:
        self.blocks: list[bytes] = []
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.size = 0

    def triangles(self, faces: IntArray, vertex_count: int) -> int:
        kind, corners = _indices(faces.reshape(-1), vertex_count)
        return self._add(kind, "SCALAR", corners.size, bufferView=self._view(corners, _TRIANGLES))

    def scalars(self, values: FloatArray, bounds: bool = False) -> int:
        flat = values.astype(np.float32).reshape(-1)
        limits = {"min": [float(flat.min())], "max": [float(flat.max())]} if bounds else {}
        return self._add(_FLOAT, "SCALAR", flat.size, bufferView=self._view(flat), **limits)

    def vectors(self, values: Float32, bounds: bool = False, sparse: bool = False) -> int:
        """Accessor of (n, 3), with its bounds, sparse where that is smaller."""
        entries: dict[str, Any] = {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        entries = entries if bounds else {}
        moved = np.flatnonzero(values.any(axis=1))
        kind, numbers = _indices(moved, len(values))
        if not sparse or moved.size * (12 + numbers.itemsize) >= values.nbytes:
            entries["bufferView"] = self._view(values, _VERTICES)
        elif moved.size:
            entries["sparse"] = {
                "count": moved.size,
                "indices": {"bufferView": self._view(numbers), "componentType": kind},
                "values": {"bufferView": self._view(values[moved])},
            }
        return self._add(_FLOAT, "VEC3", len(values), **entries)

    def _add(self, component: int, kind: str, count: int, **entries: Any) -> int:
        self.accessors.append({"componentType": component, "type": kind, "count": count, **entries})
        return len(self.accessors) - 1

    def _view(self, array: NDArray[Any], target: int | None = None) -> int:
        block = array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
        view = {"buffer": 0, "byteOffset": self.size, "byteLength": len(block)}
        self.views.append(view if target is None else {**view, "target": target})
        self.blocks.append(block + b"\0" * (-len(block) % 4))
        self.size += len(self.blocks[-1])
        return len(self.views) - 1


def _indices(numbers: IntArray, count: int) -> tuple[int, NDArray[Any]]:
    """Component type and the smallest array for numbers below `count`; the largest number of a type is reserved."""
    return (_UINT16, numbers.astype(np.uint16)) if count <= 2**16 - 1 else (_UINT32, numbers.astype(np.uint32))


def _write(path: Path, scene: Mapping[str, Any], buffer: _Buffer) -> None:
    text = json.dumps(scene, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + buffer.size
    if total > LARGEST:
        raise InvalidInput(
            f"{path}: {total / 2**30:.1f} GiB, a GLB holds at most 4. Export fewer frames or identities, or a coarser "
            "mesh, or leave out the normals of the targets."
        )

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            file.write(struct.pack("<4sII", b"glTF", 2, total))
            file.write(struct.pack("<I4s", len(text), b"JSON") + text)
            file.write(struct.pack("<I4s", buffer.size, b"BIN\0"))
            file.writelines(buffer.blocks)

    write_whole(path, write)
