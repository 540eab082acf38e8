"""A reader of binary glTF by the letter of the standard, for tests: chunks, accessors, sparse ones too."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

DTYPES = {5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3}


@dataclass(frozen=True)
class Glb:
    scene: dict[str, Any]
    binary: bytes

    @staticmethod
    def read(path: Path) -> Glb:
        data = path.read_bytes()
        magic, version, length = struct.unpack_from("<4sII", data)
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON"
        assert size % 4 == 0
        binary_size, binary_kind = struct.unpack_from("<I4s", data, 20 + size)
        assert binary_kind == b"BIN\0"
        assert 28 + size + binary_size == length
        return Glb(json.loads(data[20 : 20 + size]), data[28 + size :])

    def view(self, index: int, dtype: str, width: int, count: int) -> np.ndarray:
        view = self.scene["bufferViews"][index]
        assert view["byteOffset"] % 4 == 0
        assert view["byteLength"] == np.dtype(dtype).itemsize * width * count
        array = np.frombuffer(self.binary, dtype, width * count, view["byteOffset"])
        return array.reshape(count, width) if width > 1 else array

    def accessor(self, index: int) -> np.ndarray:
        a = self.scene["accessors"][index]
        dtype, width, count = DTYPES[a["componentType"]], WIDTHS[a["type"]], a["count"]
        if "bufferView" in a:
            values = self.view(a["bufferView"], dtype, width, count)
        else:
            values = np.zeros((count, width), dtype)
        if sparse := a.get("sparse"):
            values = values.copy()
            indices = sparse["indices"]
            at = self.view(indices["bufferView"], DTYPES[indices["componentType"]], 1, sparse["count"])
            assert (np.diff(at.astype(int)) > 0).all()
            values[at] = self.view(sparse["values"]["bufferView"], dtype, width, sparse["count"])
        if "min" in a:
            columns = values.reshape(count, -1)
            assert columns.min(axis=0).tolist() == a["min"]
            assert columns.max(axis=0).tolist() == a["max"]
        return values

    def weights(self, mesh: int, seconds: float) -> np.ndarray:
        """(m,) weights of a node's morph targets at a time, by linear interpolation."""
        animation = self.scene["animations"][0]
        channel = next(c for c in animation["channels"] if c["target"] == {"node": mesh, "path": "weights"})
        sampler = animation["samplers"][channel["sampler"]]
        times = self.accessor(sampler["input"])
        curves = self.accessor(sampler["output"]).reshape(len(times), -1)
        return np.array([np.interp(seconds, times, curve) for curve in curves.T])

    def shape(self, mesh: int, weights: np.ndarray, attribute: str = "POSITION") -> np.ndarray:
        """(n, 3) a morphed attribute, as a viewer computes it."""
        primitive = self.scene["meshes"][mesh]["primitives"][0]
        morphed = self.accessor(primitive["attributes"][attribute]).astype(np.float64)
        for weight, target in zip(weights, primitive.get("targets", []), strict=True):
            morphed += weight * self.accessor(target[attribute])
        return morphed
