"""The rigid motions of cranium and jaw (section 3.3.2: inverse simulation step 1, forward simulation step 1)."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from retarget.anatomy.head import Head
from retarget.check import InvalidInput, check_vertices
from retarget.geometry.procrustes import rigid_align
from retarget.simulation.state import Bones, RigidMotion
from retarget.types import FloatArray

CRANIUM_ANGLE = 1.0  # degrees of global rigid motion left in an expression
CRANIUM_SHIFT = 1.0  # mm, mean over the set `cranium`
# Jaws open 48.8 mm between the incisors on average, with condyles that slide 15 to 20 mm forward; the limits leave
# room for large jaws and for the noise of a fit to skin.
JAW_ANGLE = 45.0  # degrees
JAW_OPENING = 80.0  # mm at the lower incisors
CONDYLE_SHIFT = 35.0  # mm
# Of a jaw held at its joint, besides the hinge, in one expression:
TURN = 0.05  # rad about the other axes
SLIDE = (1.0, 2.0, 3.0)  # mm along the hinge's axis, up, and forward
SKIN_SLIDE = 1.0  # mm that skin slides over the jaw, rms
JOINT_STEPS = 5  # of Gauss-Newton; from rest to 45 degrees it settles in 4
FARTHEST = 150.0  # mm that a vertex or a handle may be from rest: about twice the largest opening of the jaw


def pivot(head: Head) -> FloatArray:
    """(3,) mm: the middle of the jaw joints, about which both bones turn.

    Where the axis of the joints meets the median plane a jaw that merely opens has no translation, so that scaling
    translations from head to head scales the slide of the joint and leaves the hinge alone.
    """
    middle: FloatArray = head.condyles.mean(axis=0)
    return middle


def at_rest(head: Head) -> Bones:
    """Bones that do not move."""
    still = RigidMotion(np.eye(3), np.zeros(3), pivot(head))
    return Bones(still, still)


def check_moves(name: str, points: FloatArray, rest: FloatArray) -> None:
    """Raises InvalidInput if one of the points (k, 3) mm is more than 150 mm from where it is at rest (k, 3) mm."""
    distance = np.linalg.norm(points - rest, axis=1)
    if len(distance) and distance.max() > FARTHEST:
        raise InvalidInput(
            f"{name}: expected points within {FARTHEST:g} mm of the neutral, but {int(distance.argmax())} is "
            f"{distance.max():.1f} mm away. Check the unit of the mesh, mm, and repair that point."
        )


class Jaw(StrEnum):
    """How the jaw moves."""

    FREE = "free"  # the rigid fit of its skin by itself, section 3.3.2
    JOINT = "joint"  # differs from the paper: about its joints, see `_at_joint`


def fit_bones(head: Head, skin: FloatArray, jaw: Jaw | str = Jaw.FREE) -> Bones:
    """The motions that take the skin over cranium and jaw from rest to `skin` (n, 3) mm.

    Raises InvalidInput for skin that is not stabilised: the set `cranium`, which no expression moves, turns by more
    than 1 degree or is displaced by more than 1 mm on average. `cranium_skin`, from which the bone is fitted, is the
    wider set and moves a little with brows and cheeks. Raises it as well for a jaw that opens further than jaws can,
    and for a vertex that moves by more than 150 mm.
    """
    skin = check_vertices("expression", skin, len(head.skin))
    check_moves("expression", skin, head.skin)
    check_stabilised(head, skin)
    cranium, mandible = (_fit(head, skin, name) for name in ("cranium_skin", "jaw_skin"))
    if Jaw(jaw) is Jaw.JOINT:
        mandible = _at_joint(head, skin, cranium)
    _check_jaw(head, cranium, mandible)
    return Bones(cranium, mandible)


def check_stabilised(head: Head, skin: FloatArray) -> None:
    """Raises InvalidInput if `skin` (n, 3) mm moves the cranium by more than 1 degree or 1 mm against the neutral."""
    motion = _fit(head, skin, "cranium")
    still = head.skin[head.template.regions.vertices["cranium"]].mean(axis=0)
    degrees, shift = rotation_angle(motion.rotation), float(np.linalg.norm(motion(still) - still))
    if degrees > CRANIUM_ANGLE or shift > CRANIUM_SHIFT:
        raise InvalidInput(
            f"expression: expected a head that keeps still, but its cranium turns by {degrees:.2f} degrees and moves "
            f"by {shift:.2f} mm against the neutral (allowed are {CRANIUM_ANGLE:g} and {CRANIUM_SHIFT:g}). "
            "Remove the global rigid motion first, by a rigid alignment on the cranium."
        )


def rotation_angle(rotation: FloatArray) -> float:
    """Degrees that a rotation (3, 3) turns by."""
    axial = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    return float(np.degrees(np.arctan2(np.linalg.norm(axial), 0.5 * (np.trace(rotation) - 1))))


def bounding_box_diameter(skin: FloatArray) -> float:
    """BB: the diagonal in mm of the bounding box of vertices (n, 3) mm."""
    return float(np.linalg.norm(np.ptp(skin, axis=0)))


def size_ratio(source: FloatArray, target: FloatArray) -> float:
    """BB(T) / BB(S) of two neutral skins (n, 3) mm: what translations of bones are scaled by."""
    return bounding_box_diameter(target) / bounding_box_diameter(source)


def carry_bones(head: Head, bones: Bones, scale: float = 1.0) -> Bones:
    """The motions of another head's bones on this one: same rotations about its own pivot, translations scaled.

    Raises InvalidInput for a scale that is not a finite number > 0.
    """
    if np.ndim(scale) or not (np.isfinite(scale) and scale > 0):
        raise InvalidInput(f"scale: expected one finite number > 0, BB(T) / BB(S) of `size_ratio`, got {scale}.")
    here = pivot(head)
    cranium, jaw = (RigidMotion(m.rotation, scale * m.translation, here) for m in (bones.cranium, bones.jaw))
    return Bones(cranium, jaw)


def place_bones(head: Head, bones: Bones, scale: float = 1.0) -> FloatArray:
    """(c, 3) mm: where the vertices ``head.template.fixed`` go, in that order, with the motions of `carry_bones`."""
    template = head.template
    carried = carry_bones(head, bones, scale)
    moved = head.vertices.copy()
    moved[template.cranium] = carried.cranium(head.vertices[template.cranium])
    moved[template.jaw] = carried.jaw(head.vertices[template.jaw])
    return moved[template.fixed]


def _fit(head: Head, skin: FloatArray, name: str) -> RigidMotion:
    members = head.template.regions.vertices.get(name, np.empty(0, dtype=np.int64))
    if len(members) < 3:
        raise InvalidInput(
            f"regions: expected at least 3 vertices in vertices[{name!r}], got {len(members)}; "
            "docs/regions.md says what the name means. Add it to the topology's regions."
        )
    rotation, translation = rigid_align(head.skin[members], skin[members])
    centre = pivot(head)
    return RigidMotion(rotation, translation + rotation @ centre - centre, centre)


def _at_joint(head: Head, skin: FloatArray, cranium: RigidMotion) -> RigidMotion:
    """The jaw's motion as its joints allow: a hinge about the axis of the condyles, and little else.

    # differs from the paper: which fits the jaw's skin by itself. Skin that slides over the bone then turns and shifts
    a jaw that does not move. Minimised, in the cranium's frame, is the mean squared distance of the jaw's skin over
    SKIN_SLIDE^2, plus the squares of all but the hinge over their usual sizes, by Gauss-Newton.
    """
    still = head.template.regions.vertices["jaw_skin"]
    centre, axis = pivot(head), head.condyles[0] - head.condyles[1]
    frame = _frame(axis)
    points = (head.skin[still] - centre) @ frame.T
    seen = (((skin[still] - cranium(centre)) @ cranium.rotation) @ frame.T).ravel()
    prior = np.concatenate([[0.0], 1 / np.square([TURN, TURN, *SLIDE])])
    weight = 1 / (len(points) * SKIN_SLIDE**2)
    turn, shift = np.zeros(3), np.zeros(3)
    for _ in range(JOINT_STEPS):
        turned = points @ Rotation.from_rotvec(turn).as_matrix().T
        columns = [np.cross(e, turned).ravel() for e in np.eye(3)]
        columns += [np.tile(e, len(points)) for e in np.eye(3)]
        jacobian = np.stack(columns, axis=1)
        left = seen - (turned + shift).ravel()
        step = np.linalg.solve(
            weight * jacobian.T @ jacobian + np.diag(prior),
            weight * jacobian.T @ left - prior * np.concatenate([turn, shift]),
        )
        turn, shift = turn + step[:3], shift + step[3:]
    rotation = cranium.rotation @ frame.T @ Rotation.from_rotvec(turn).as_matrix() @ frame
    return RigidMotion(rotation, cranium.translation + cranium.rotation @ (frame.T @ shift), centre)


def _frame(axis: FloatArray) -> FloatArray:
    """(3, 3) rotation whose rows are the hinge's axis, up, and forward as far as they are at right angles."""
    first = axis / np.linalg.norm(axis)
    forward = np.cross(first, [0.0, 1.0, 0.0])
    forward /= np.linalg.norm(forward)
    return np.stack([first, np.cross(forward, first), forward])


def _check_jaw(head: Head, cranium: RigidMotion, jaw: RigidMotion) -> None:
    """Raises InvalidInput if the jaw's motion relative to the cranium is beyond what joints allow."""
    rotation = cranium.rotation.T @ jaw.rotation
    marks = head.template.regions.landmarks
    incisors = head.skin[marks["infradentale"]] if "infradentale" in marks else jaw.pivot  # in the median plane
    opened, slid = (float(np.linalg.norm(jaw(p) - cranium(p))) for p in (incisors, jaw.pivot))
    degrees = rotation_angle(rotation)
    if degrees > JAW_ANGLE or opened > JAW_OPENING or slid > CONDYLE_SHIFT:
        raise InvalidInput(
            f"expression: expected a jaw that opens as jaws can, but it turns by {degrees:.1f} degrees, moves the "
            f"incisors by {opened:.1f} mm and the joints by {slid:.1f} mm (allowed are {JAW_ANGLE:g}, {JAW_OPENING:g} "
            f"and {CONDYLE_SHIFT:g}). Check unit and scale of the mesh, or reduce the expression's strength."
        )
