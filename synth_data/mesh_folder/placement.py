"""From the unit, axes and head pose of files to this project's: mm, +y up, +z out of the face, the cranium at rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from retarget.anatomy.landmarks import UNITS as LARGE_UNITS
from retarget.check import InvalidInput
from retarget.geometry.procrustes import rigid_align
from retarget.suggest import choose
from retarget.types import FloatArray, IntArray, Regions
from synth_data.mesh_folder.listing import Files
from synth_data.mesh_folder.store import Stored

UNITS = {"mm": 1.0, **LARGE_UNITS}  # in mm
PLAUSIBLE = (80.0, 1000.0)  # mm, longest side of a neutral: from a mask of the face to a bust
ALIKE = 2.0  # sizes of people, and of a person's expressions, that differ by more are of different units
RIGID_MM = 10.0  # RMS left on the cranium; MakeHuman leaves 0.2 mm, and 9.6 where the whole head is the region
STILL_DEGREES, STILL_MM = 1.0, 1.0  # cranium of an expression against the neutral's, where moving ones are refused


class Align(StrEnum):
    """What is done about heads that move."""

    LOAD = "load"  # every frame is aligned rigidly on the cranium
    REFUSE = "refuse"  # nothing is moved, and a cranium that moves is refused
    NONE = "none"  # nothing is moved, and head motion is not checked


@dataclass(frozen=True)
class Frame:
    """The unit of files in mm and the rotation (3, 3) from their axes to +x the person's left, +y up, +z front."""

    scale: float
    rotation: FloatArray

    @staticmethod
    def of(units: str, up: str, front: str) -> Frame:
        """Raises InvalidInput for an unknown unit, or axes that span no frame."""
        scale = UNITS[choose("dataset.units", units, UNITS)]
        upward, forward = _axis("dataset.up", up), _axis("dataset.front", front)
        if upward @ forward:
            raise InvalidInput(
                f"dataset.front: expected an axis across dataset.up, got {front} and {up}; the face looks along front, "
                "the top of the head lies along up."
            )
        return Frame(scale, np.array([np.cross(upward, forward), upward, forward]))

    def __call__(self, vertices: NDArray[np.floating]) -> FloatArray:
        """(..., 3) mm."""
        return self.scale * np.asarray(vertices, dtype=np.float64) @ self.rotation.T


def _axis(name: str, axis: str) -> FloatArray:
    sign, letter = (-1.0, axis[1:]) if axis.startswith("-") else (1.0, axis.removeprefix("+"))
    if letter not in ("x", "y", "z"):
        raise InvalidInput(f"{name}: expected one of +x, -x, +y, -y, +z, -z, got {axis!r}.")
    return sign * np.eye(3)["xyz".index(letter)]


@dataclass(frozen=True)
class Poses:
    """Where the meshes of a person go: x -> x @ rotation.T + translation in mm, and what that removes."""

    rotations: FloatArray  # (k, 3, 3)
    translations: FloatArray  # (k, 3) mm
    degrees: FloatArray  # (k,) by which the cranium is turned against the neutral's
    shifts: FloatArray  # (k,) mm by which its centre has moved
    residuals: FloatArray  # (k,) mm RMS by which it differs after rigid alignment


def poses(crania: FloatArray, neutral: int, reference: FloatArray | None, align: Align) -> Poses:
    """From crania (k, m, 3) mm of a person, of which one is the neutral's, and that of whom all are aligned with.

    Each frame is aligned with the person's own neutral, and that with the reference (m, 3) mm: heads keep their size.
    """
    rest = crania[neutral]
    found = [rigid_align(cranium, rest) for cranium in crania]
    turns = np.array([rotation for rotation, _ in found])
    moves = np.array([translation for _, translation in found])
    angles = Rotation.from_matrix(turns).magnitude()
    still = np.einsum("kij,kmj->kmi", turns, crania) + moves[:, None]
    residuals = np.sqrt(((still - rest) ** 2).sum(axis=2).mean(axis=1))
    shifts = np.linalg.norm(crania.mean(axis=1) - rest.mean(axis=0), axis=1)
    if align is not Align.LOAD:
        turns, moves = np.broadcast_to(np.eye(3), turns.shape).copy(), np.zeros_like(moves)
    elif reference is not None:
        onto, shift = rigid_align(rest, reference)
        turns, moves = onto @ turns, moves @ onto.T + shift
    return Poses(turns, moves, np.degrees(angles), shifts, residuals)


def unmoved(count: int) -> Poses:
    """Of `count` meshes that stay where they are, unmeasured."""
    nothing = np.zeros(count)
    return Poses(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), nothing, nothing, nothing)


def check_rigid(files: Files, measured: Poses) -> None:
    """Raises InvalidInput for the mesh whose cranium fits worst on the neutral's, where that is another shape."""
    worst = int(np.argmax(measured.residuals))
    if measured.residuals[worst] > RIGID_MM:
        raise InvalidInput(
            f"{list(files.values())[worst]}: the cranium differs from the neutral's by {measured.residuals[worst]:.0f} "
            f"mm RMS after rigid alignment, expected at most {RIGID_MM:g} mm: the vertices come in another order, the "
            "scan is damaged there, or the region 'cranium' holds what moves. Export the mesh again, leave it out, or "
            "make the regions file anew."
        )


def check_still(files: Files, measured: Poses) -> None:
    """Raises InvalidInput for the mesh whose cranium moves most, where one moves too much."""
    excess = np.maximum(measured.degrees / STILL_DEGREES, measured.shifts / STILL_MM)
    worst = int(np.argmax(excess))
    if excess[worst] > 1:
        raise InvalidInput(
            f"{list(files.values())[worst]}: the cranium is turned by {measured.degrees[worst]:.1f} degrees and moved "
            f"by {measured.shifts[worst]:.1f} mm against the neutral's, expected at most {STILL_DEGREES:g} degree and "
            f"{STILL_MM:g} mm with dataset.align=refuse ({int((excess > 1).sum())} of {len(excess)} meshes of this "
            "person move more). Stabilise the head, or let it be aligned with dataset.align=load."
        )


def check_sizes(people: Mapping[str, Files], stored: Mapping[str, Stored], units: str) -> None:
    """Raises InvalidInput for heads of implausible size, people in different units and expressions in another one.

    The neutral comes first in the files of each.
    """

    def neutral(files: Files) -> Path:
        return next(iter(files.values()))

    sizes = {identity: UNITS[units] * found.extents[0] for identity, found in stored.items()}
    others = {name: float(np.median([sizes[other] for other in sizes if other != name])) for name in sizes}
    for identity, size in sizes.items():
        if not PLAUSIBLE[0] <= size <= PLAUSIBLE[1]:
            fitting = [unit for unit, mm in UNITS.items() if PLAUSIBLE[0] <= size / UNITS[units] * mm <= PLAUSIBLE[1]]
            mend = f"Set dataset.units={fitting[0]}." if fitting else "Set dataset.units to the unit of the files."
            if PLAUSIBLE[0] <= others[identity] <= PLAUSIBLE[1]:
                usual = others[identity]
                mend = f"The others measure about {usual:.0f} mm: scale all meshes of {identity} by {usual / size:.2g}."
            raise InvalidInput(
                f"{neutral(people[identity])}: this head measures {size:.4g} mm at its longest side if the files are "
                f"in {units}, expected {PLAUSIBLE[0]:g} to {PLAUSIBLE[1]:g} mm. {mend}"
            )
    for identity, size in sizes.items():
        if not 1 / ALIKE < size / others[identity] < ALIKE:
            raise InvalidInput(
                f"{neutral(people[identity])}: this head measures {size:.4g} mm at its longest side, the others about "
                f"{others[identity]:.0f} mm; they are probably in different units. Bring all people into one, or leave "
                "one out with dataset.identities."
            )
    for identity, found in stored.items():
        for file, extent in zip(people[identity].values(), found.extents, strict=True):
            if not 1 / ALIKE < extent / found.extents[0] < ALIKE:
                raise InvalidInput(
                    f"{file}: it measures {UNITS[units] * extent:.4g} mm at its longest side, the neutral of this "
                    f"person {sizes[identity]:.4g} mm. Bring all meshes into one unit, or export this one again."
                )


def check_upright(file: Path, neutral: FloatArray, regions: Regions) -> None:
    """Raises InvalidInput where landmarks contradict the axes: left at +x, the nasion above the menton."""
    marks = regions.landmarks
    stems = [name.removesuffix("_left") for name in marks if name.endswith("_left")]
    pairs = [(marks[f"{stem}_left"], marks[f"{stem}_right"]) for stem in stems if f"{stem}_right" in marks]
    directions: list[tuple[str, str, FloatArray]] = []
    if pairs:
        directions.append(("the person's left", "x", np.sum([neutral[a] - neutral[b] for a, b in pairs], axis=0)))
    if {"nasion", "menton"} <= set(marks):
        directions.append(("up", "y", neutral[marks["nasion"]] - neutral[marks["menton"]]))
    for what, axis, direction in directions:
        towards = int(np.abs(direction).argmax())
        if towards != "xyz".index(axis) or direction[towards] < 0:
            points = f"{'+' if direction[towards] > 0 else '-'}{'xyz'[towards]}"
            raise InvalidInput(
                f"{file}: with dataset.up and dataset.front as they are, {what} points along {points}, expected "
                f"+{axis}. Say along which axis of the files the top of the head lies (dataset.up) and the face looks "
                "(dataset.front); where left and right alone are exchanged, the meshes or the regions are mirrored."
            )


def cranium_of(regions: Regions | None, align: Align) -> IntArray | None:
    """The vertices to align on, or None where nothing is aligned. Raises InvalidInput where they are unknown."""
    if align is Align.NONE:
        return None
    members = None if regions is None else regions.vertices.get("cranium")
    if members is None or len(members) < 3:
        raise InvalidInput(
            f"dataset.align={align}: heads are aligned on the cranium, because the rest moves with the expression, "
            "and nothing says which vertices the cranium has. Make a regions file once for this topology (python -m "
            "experiments.topology transfer, docs/own_topology.md) and set dataset.regions=FILE; or, where the meshes "
            "are stabilised already, set dataset.align=none."
        )
    return members
