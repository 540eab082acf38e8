"""Fit of the head template to a character: fitHead of section 3.3.2, eq. (7)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_limits

from retarget.anatomy.bone_fit import CLEARANCE, Skin, SkullFit, follow_depths, measure_skull, place_skull
from retarget.anatomy.crossings import self_intersections
from retarget.anatomy.depths import depths_with_room
from retarget.anatomy.head import Head, HeadTemplate
from retarget.anatomy.untangle import Repair, untangle
from retarget.anatomy.warp import farthest_points, warp
from retarget.check import InvalidInput, check_triangle_areas, check_vertices
from retarget.geometry.cholesky import CholeskyFactor
from retarget.geometry.procrustes import rigid_align
from retarget.simulation.tetrahedra import MM3_PER_CM3, RestShape, hat_gradients, rest_shape
from retarget.types import FloatArray

LARGEST_RESIDUAL = 8.0  # mm on the visible skin that the tets may miss; ears miss 2 to 4
LEAST_CARRIED = 0.4  # of the template's landmarks must keep their depths; sampled identities keep 0.54 to 0.75
ATTEMPTS = 4  # at a skull that does not cross itself
DEPTH_RULE = 1.0  # mm that the depth at a landmark may be off
LARGEST_SCALE = 1.6  # of a character against the template, either way; more means another unit
LARGEST_TURN = 45.0  # degrees between character and template; more means other axes
LARGEST_DIFFERENCE = 0.12  # rms after rigid alignment and scale over the template's size; more means another order
BONE_FIRMNESS = 3.0  # of a skull vertex in the repair, where a skin vertex has 1
SKIN_CENTRES, SKULL_CENTRES = 1000, 500
SKIN_WEIGHT = 5e5  # mm; the skin's distance, spread over its vertices, against the gradients of the correction


@dataclass(frozen=True)
class FitReport:
    """How a fit went."""

    repair: Repair
    skull: SkullFit


def fit_head(template: HeadTemplate, neutral: FloatArray) -> Head:
    """The template fitted to a neutral skin (n, 3) mm in its topology and axes.

    The skin is the neutral to the bit: skin = P vertices + residual. The skull lies under all of it, within 1 mm of the
    depths at the landmarks that have room before the mouth (`depths_with_room`). Raises InvalidInput, with the reason,
    for a neutral that no head can be made of: wrong count, NaN, degenerate triangles, another unit, axes or vertex
    order, folded skin, depths that cannot be met, or tets that stay inverted.
    """
    return fit_with_report(template, neutral)[0]


def fit_with_report(template: HeadTemplate, neutral: FloatArray) -> tuple[Head, FitReport]:
    """`fit_head`, and what it had to repair."""
    skin = _checked(template, neutral)
    with threadpool_limits(limits=1):  # the same bits on any machine; its vectors are too short for threads anyway
        return _fitted(template, skin)


def _fitted(template: HeadTemplate, skin: FloatArray) -> tuple[Head, FitReport]:
    new = Skin.of(skin, template.faces, template.regions)
    x, depths = _warped(template, skin, new)
    rest = rest_shape(template.vertices, template.tets)
    rotation, _ = rigid_align(template.skin, skin)
    goal = skin - (template.skin - template.embedding @ template.vertices) @ rotation.T
    repair = _repaired(template, rest, _pulled(template, rest, x, goal), goal)
    bone = template.skull
    skull = measure_skull((repair.vertices[bone], np.searchsorted(bone, template.skull_faces)), new, depths)
    _check_fit(template, repair, skull)
    left = np.linalg.norm((goal - template.embedding @ repair.vertices)[template.regions.vertices["head"]], axis=1)
    if left.max() > LARGEST_RESIDUAL:
        raise InvalidInput(
            f"neutral: expected a skin that the tets can follow within {LARGEST_RESIDUAL:g} mm, got one that leaves "
            f"{left.max():.1f} mm at vertex {template.regions.vertices['head'][left.argmax()]}; it is folded there."
        )
    condyles = np.array([template.regions.points[f"condyle_{side}"](skin) for side in ("left", "right")])
    return Head(template, skin, repair.vertices, condyles, skull.errors), FitReport(repair, skull)


def _checked(template: HeadTemplate, neutral: FloatArray) -> FloatArray:
    """The neutral as float64; raises InvalidInput where it cannot be a face of this template."""
    skin = check_vertices("neutral", neutral)
    if len(skin) != len(template.skin):
        raise InvalidInput(
            f"neutral: expected the {len(template.skin)} vertices of the template's skin, got {len(skin)}; "
            "load the template of this topology and resolution, or bring the character into it."
        )
    size, rest_size = (float(np.linalg.norm(np.ptp(v, axis=0))) for v in (skin, template.skin))
    if not rest_size / LARGEST_SCALE < size < rest_size * LARGEST_SCALE:
        raise InvalidInput(
            f"neutral: expected a head of about {rest_size:.0f} mm from corner to corner, got {size:.3g} mm; "
            "vertices are in mm."
        )
    check_triangle_areas("neutral", skin, template.faces)
    rotation, translation = rigid_align(skin, template.skin)
    turn = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
    aligned = (skin @ rotation.T + translation - template.skin.mean(axis=0)) * (rest_size / size)
    difference = float(np.sqrt(((aligned + template.skin.mean(axis=0) - template.skin) ** 2).sum(axis=1).mean()))
    if difference > LARGEST_DIFFERENCE * rest_size:
        raise InvalidInput(
            f"neutral: expected a face in the template's vertex order, got one {difference:.0f} mm (rms) away from it "
            "after alignment; the vertices are in another order, or mirrored."
        )
    if turn > LARGEST_TURN:
        raise InvalidInput(
            f"neutral: expected a head with +y up and +z out of the face, got one turned by {turn:.0f} degrees against "
            "the template; rotate it."
        )
    _check_crossings(template, skin)
    return skin


def _check_crossings(template: HeadTemplate, skin: FloatArray) -> None:
    """Raises InvalidInput for a skin that crosses itself elsewhere than at lips and lids, which touch at rest."""
    soft = np.zeros(len(skin), dtype=bool)
    for name in ("lips", "eyes", "interior"):
        soft[template.regions.vertices.get(name, [])] = True
    pairs = self_intersections(skin, template.faces)
    allowed = soft[template.faces[pairs]].any(axis=-1).all(axis=-1)
    crossing = pairs[np.logical_not(allowed)]
    if len(crossing):
        where = np.round(skin[template.faces[crossing[0, 0]]].mean(axis=0), 1).tolist()
        raise InvalidInput(
            f"neutral: expected skin that crosses itself at lips and lids at most, got {len(crossing)} pairs of "
            f"crossing triangles elsewhere, the first {crossing[0].tolist()} near {where} mm; repair the mesh there."
        )


def _check_fit(template: HeadTemplate, repair: Repair, skull: SkullFit) -> None:
    """Raises InvalidInput, with the reason, unless tets and skull are as they must be."""
    try:
        rest_shape(repair.vertices, template.tets)
    except InvalidInput as error:
        raise InvalidInput(
            f"neutral: expected a face that the template's tets can follow, got one where {repair.after} of "
            f"{len(template.tets)} tets stay inverted or flat after repair; the surface is folded there. ({error})"
        ) from error
    off = {name: error for name, error in skull.errors.items() if not abs(error) <= DEPTH_RULE}
    if off:
        name = max(off, key=lambda n: abs(off[n]))
        raise InvalidInput(
            f"neutral: expected a skull within {DEPTH_RULE:g} mm of the soft-tissue depths, got {len(off)} landmarks "
            f"beyond, the worst {name} by {off[name]:+.1f} mm; is the landmark where its name says on this face?"
        )
    if skull.clearance <= 0:
        raise InvalidInput(
            f"neutral: expected room for the skull under the skin, got skull vertices up to {-skull.clearance:.1f} mm "
            "outside; the skin is folded, or too thin for the depths."
        )


def _warped(template: HeadTemplate, skin: FloatArray, new: Skin) -> tuple[FloatArray, dict[str, float]]:
    """Tet vertices (m, 3) mm warped with skin and skull, the skull in its place, and the depths that it meets."""
    bone = template.skull
    at_rest, faces = template.vertices[bone], np.searchsorted(bone, template.skull_faces)
    on_skin, on_bone = farthest_points(template.skin, SKIN_CENTRES), farthest_points(at_rest, SKULL_CENTRES)
    sources, targets = template.skin[on_skin], skin[on_skin]
    old = Skin.of(template.skin, template.faces, template.regions)
    start, depths = (
        follow_depths(at_rest, old, warp(sources, targets)(at_rest), new),
        depths_with_room(*new.surface, template.regions, template.depths, behind=CLEARANCE),
    )
    for attempt in range(ATTEMPTS):
        placed = place_skull((at_rest, faces), old, start, new, depths, CLEARANCE * 0.5**attempt)
        crossing = self_intersections(placed, faces)
        if len(crossing) == 0:
            break
        depths = _without_nearest(depths, new, placed[faces[crossing.ravel()]].mean(axis=1))
    else:
        raise InvalidInput(
            f"neutral: expected room for a skull, got one that crosses itself at {len(crossing)} pairs of triangles, "
            f"the first near {np.round(placed[faces[crossing[0, 0]]].mean(axis=0), 1).tolist()} mm; the tissue there "
            "is too thin for the soft-tissue depths."
        )
    if len(depths) < LEAST_CARRIED * len(template.depths):
        raise InvalidInput(
            f"neutral: expected room for bone under at least {LEAST_CARRIED:.0%} of the {len(template.depths)} "
            f"landmarks with a depth, got it under {len(depths)}; the face is too thin for the soft-tissue depths."
        )
    x = warp(np.vstack([sources, at_rest[on_bone]]), np.vstack([targets, placed[on_bone]]))(template.vertices)
    x[bone] = placed
    return x, depths


def _without_nearest(depths: Mapping[str, float], skin: Skin, points: FloatArray) -> dict[str, float]:
    """The depths without those of the landmarks nearest to points (p, 3) mm: there, bone was squeezed to nothing."""
    marks = skin.surface[0][[skin.regions.landmarks[name] for name in depths]]
    nearest = np.bincount(np.argmin(cdist(points, marks), axis=1), minlength=len(marks))
    return {name: depth for (name, depth), n in zip(depths.items(), nearest, strict=True) if 2 * n < nearest.max()}


def _repaired(template: HeadTemplate, rest: RestShape, x: FloatArray, goal: FloatArray) -> Repair:
    """x (m, 3) mm without inverted tets, P x near the goal (n, 3) mm and the skull nearly where it was."""
    bone = template.skull
    firm = np.full(len(bone), BONE_FIRMNESS)
    at_bone = sp.csr_array((firm, (np.arange(len(bone)), bone)), shape=(len(bone), len(x)))
    anchors = sp.csr_array(sp.vstack([template.embedding, at_bone]))
    return untangle(rest, x, anchors, np.vstack([goal, BONE_FIRMNESS * x[bone]]))


def _pulled(template: HeadTemplate, rest: RestShape, x: FloatArray, goal: FloatArray) -> FloatArray:
    """x (m, 3) mm plus the correction with the smallest gradients that takes P x to the goal (n, 3) mm, skull fixed."""
    hats = hat_gradients(rest)
    blocks = (rest.volumes * MM3_PER_CM3)[:, None, None] * (hats @ np.swapaxes(hats, 1, 2))
    rows, columns = (np.broadcast_to(i, blocks.shape).ravel() for i in (rest.tets[:, :, None], rest.tets[:, None]))
    gradients = sp.csr_array((blocks.ravel(), (rows, columns)), shape=(len(x), len(x)))
    p = template.embedding
    free = np.setdiff1d(np.arange(len(x)), template.skull)
    weight = SKIN_WEIGHT / len(goal)
    system = sp.csr_array(gradients + weight * (p.T @ p))[free][:, free]
    moved = x.copy()
    moved[free] += CholeskyFactor(system, "skin correction").solve((weight * (p.T @ (goal - p @ x)))[free])
    return moved
