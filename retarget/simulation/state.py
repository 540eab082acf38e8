"""Where a simulation of a head ended, as data that the next one takes."""

from __future__ import annotations

from dataclasses import dataclass

from retarget.types import FloatArray, SolveInfo


@dataclass(frozen=True)
class RigidMotion:
    """x -> R (x - pivot) + pivot + t, in mm; about a pivot, so that scaling t means what it says."""

    rotation: FloatArray  # (3, 3)
    translation: FloatArray  # (3,) mm
    pivot: FloatArray  # (3,) mm

    def __call__(self, points: FloatArray) -> FloatArray:
        """(..., 3) mm."""
        return (points - self.pivot) @ self.rotation.T + (self.pivot + self.translation)


@dataclass(frozen=True)
class Bones:
    """The rigid motions of the skull, the bold nabla B of eq. (8)."""

    cranium: RigidMotion
    jaw: RigidMotion


@dataclass(frozen=True)
class HeadState:
    """A deformed head: the result of an inverse or a forward simulation."""

    vertices: FloatArray  # (m, 3) mm, of the tets
    skin: FloatArray  # (n, 3) mm
    gradients: FloatArray  # (t, 3, 3) deformation gradients, nabla S and nabla M of eq. (8)
    bones: Bones
    info: SolveInfo
