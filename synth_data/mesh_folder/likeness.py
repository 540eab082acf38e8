"""Whether meshes have their vertices in one order, none is mirrored, and all lie in the same axes.

Told from all vertices, so that it needs no regions, and before any head is aligned.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from retarget.check import InvalidInput
from retarget.types import FloatArray, IntArray
from synth_data.mesh_folder.listing import Files

# Expressions of MakeHuman reach 1.02 and its people 1.03. With 4,000 vertices a random order reaches 13, one that is
# shifted by one 4.8, one in a hundred exchanged 2.3. Noise of half an edge on each axis, over a smooth neutral: 1.6.
STRETCH = 2.0
SAMPLE = 4000  # triangles that are looked at, or up to half as many
TURNED = 60.0  # degrees, an expression against the neutral: heads turn; other axes are 90 degrees away at least
ACROSS = 45.0  # degrees, a neutral against the first person's: beyond, other axes are nearer than these


@dataclass(frozen=True)
class Likeness:
    """How one mesh differs from another in what neither people nor expressions change."""

    stretch: float  # times the length of edges, both meshes scaled to one size
    degrees: float  # of the rotation that fits best
    mirrored: bool  # whether a reflection fits better than any rotation

    @staticmethod
    def of(mesh: FloatArray, other: FloatArray, faces: IntArray) -> Likeness:
        """Of two meshes (n, 3) in any units, with triangles (f, 3), of which some evenly spaced ones are looked at."""
        some = faces[:: 1 + len(faces) // SAMPLE]
        one, two = _centred(mesh[some]), _centred(other[some])
        u, _, vt = np.linalg.svd(np.einsum("fci,fcj->ij", two, one))
        side = 1.0 if np.linalg.det(u @ vt) > 0 else -1.0
        turn = Rotation.from_matrix(u @ np.diag([1.0, 1.0, side]) @ vt)
        return Likeness(_roughness(one) / _roughness(two), float(np.degrees(turn.magnitude())), side < 0)


def _centred(corners: FloatArray) -> FloatArray:
    centred: FloatArray = corners - corners.mean(axis=(0, 1))
    return centred


def _roughness(corners: FloatArray) -> float:
    """Length of edges as a share of the radius, both RMS, of triangles (f, 3, 3); 1 for a mesh without extent."""
    edges, radii = np.linalg.norm(corners[:, 0] - corners[:, 1]), np.linalg.norm(corners) / np.sqrt(3)
    return float(edges / radii) if edges and radii else 1.0


def check_alike(
    people: Mapping[str, Files], meshes: Mapping[str, Sequence[Likeness]], neutrals: Mapping[str, Likeness]
) -> None:
    """Raises InvalidInput for a mesh with another order of vertices, a mirrored one and one in other axes.

    meshes: of each person's files, with the person's neutral, which comes first; neutrals: with the first person's.
    """
    origin = next(iter(next(iter(people.values())).values()))
    for identity, files in people.items():
        rest, *expressions = files.values()
        _check(rest, origin, neutrals[identity], ACROSS)
        for file, likeness in zip(expressions, meshes[identity][1:], strict=True):
            _check(file, rest, likeness, TURNED)


def _check(file: Path, other: Path, found: Likeness, most: float) -> None:
    if not 1 / STRETCH <= found.stretch <= STRETCH:
        raise InvalidInput(
            f"{file}: its edges are {found.stretch:.2g} times as long as those of {other}, both scaled to one size, "
            f"expected {1 / STRETCH:g} to {STRETCH:g} times: one of these two has its vertices in another order, so it "
            "is of another topology. Export it again with the order of vertices kept, or move it out of the folder."
        )
    if found.mirrored:
        raise InvalidInput(
            f"{file}: mirrored against {other}: a reflection brings one onto the other better than any rotation. "
            "Export one of these two again without mirroring, such as a negative scale or an axis that is flipped."
        )
    if found.degrees > most:
        raise InvalidInput(
            f"{file}: turned by {found.degrees:.0f} degrees against {other}, expected at most {most:g}: one of these "
            "two lies in other axes, or has its vertices in another order. Export it again in the axes of the others."
        )
