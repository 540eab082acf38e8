"""The one place where arrays from outside are validated.

Every message names the thing, what was expected, what came, and what to do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from retarget.types import FloatArray, IntArray, RetargetProblem


class InvalidInput(ValueError):
    """Data or a setting that cannot be used; the message says which, and what to do. Shown without a traceback."""


class UnsupportedProblem(InvalidInput):
    """A well-formed problem that this method does not serve."""


def check_whole(name: str, value: object, least: int) -> None:
    """Raises InvalidInput unless a setting is a whole number of at least `least`."""
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise InvalidInput(f"{name}: expected a whole number of at least {least}, got {value!r}.")


def check_real(name: str, values: ArrayLike) -> FloatArray:
    """float64; raises InvalidInput for all but real floats and integers, such as complex numbers, text or objects."""
    found = np.asarray(values)
    if found.dtype.kind not in "fiu":
        raise InvalidInput(
            f"{name}: expected real numbers (floats or integers), got an array of dtype {found.dtype}; save it again "
            "as float32 or float64."
        )
    return found.astype(np.float64, copy=False)


def check_vertices(name: str, vertices: ArrayLike, count: int | None = None) -> FloatArray:
    """(n, 3) float64 mm, finite, with n == count where given; raises InvalidInput."""
    v = check_real(name, vertices)
    if v.ndim != 2 or v.shape[1] != 3:
        raise InvalidInput(f"{name}: expected vertices of shape (n, 3) in mm, got {v.shape}.")
    return _finite_and_counted(name, v, count)


def check_points(name: str, points: ArrayLike, count: int, each: str) -> FloatArray:
    """(count, 3) float64, finite: a point or a vector for each `each`; raises InvalidInput."""
    v = check_real(name, points)
    if v.shape != (count, 3):
        raise InvalidInput(f"{name}: expected ({count}, 3), one for each {each}, got {v.shape}.")
    bad = np.flatnonzero(~np.isfinite(v).all(axis=1))
    if len(bad):
        raise InvalidInput(
            f"{name}: expected finite numbers, but {len(bad)} of {count} are NaN or infinite, the first "
            f"is that of {each} {bad[0]}."
        )
    return v


def check_frames(name: str, frames: ArrayLike, count: int | None = None) -> FloatArray:
    """(t, n, 3) float64 mm, finite, with n == count where given; t may be 0; raises InvalidInput."""
    v = check_real(name, frames)
    if v.ndim != 3 or v.shape[2] != 3:
        raise InvalidInput(f"{name}: expected frames of shape (t, n, 3) in mm, got {v.shape}.")
    return _finite_and_counted(name, v, count)


def _finite_and_counted(name: str, v: FloatArray, count: int | None) -> FloatArray:
    if count is not None and v.shape[-2] != count:
        raise InvalidInput(
            f"{name}: expected {count} vertices as in the source neutral, got {v.shape[-2]}. "
            "All meshes share one topology; bring them into it first, for example by non-rigid registration."
        )
    finite = np.isfinite(v)
    if not finite.all():
        bad = ~finite.all(axis=-1)
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InvalidInput(
            f"{name}: {int(bad.sum())} vertices are NaN or infinite, the first at index {where}. "
            "Expected finite coordinates in mm; repair or drop that mesh."
        )
    return v


def check_faces(name: str, faces: ArrayLike, vertex_count: int) -> IntArray:
    """(f, 3) integer triangles that index vertex_count vertices; raises InvalidInput."""
    f = np.asarray(faces)
    if f.ndim != 2 or f.shape[1] != 3 or not np.issubdtype(f.dtype, np.integer):
        raise InvalidInput(
            f"{name}: expected triangles of shape (f, 3) with integer indices, got {f.shape} of {f.dtype}; "
            "triangulate the mesh first."
        )
    if len(f) == 0:
        raise InvalidInput(f"{name}: expected at least one triangle, got none.")
    if f.min() < 0 or f.max() >= vertex_count:
        raise InvalidInput(
            f"{name}: indices reach from {f.min()} to {f.max()}, expected 0 to {vertex_count - 1}; "
            "the faces belong to another mesh."
        )
    return f.astype(np.int64)


def check_triangle_areas(name: str, vertices: FloatArray, faces: IntArray, relative: float = 1e-9) -> None:
    """Raises InvalidInput if a triangle is degenerate: area below ``relative`` times the squared mean edge."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    scale = float(np.mean(np.sum((b - a) ** 2, axis=1)))
    bad = np.flatnonzero(area <= relative * scale)
    if len(bad):
        raise InvalidInput(
            f"{name}: {len(bad)} of {len(faces)} triangles are degenerate (zero area), the first is triangle "
            f"{bad[0]} with vertices {faces[bad[0]].tolist()}. Deformation gradients need triangles with an area; "
            "merge or move the vertices that coincide."
        )


def check_no_edits(method: str, edits: Mapping[str, Any] | None) -> None:
    """Raises InvalidInput if a method that knows no artistic edits is given some."""
    if edits:
        raise InvalidInput(
            f"{method}: expected no edits, got {', '.join(sorted(edits))}. This method supports none; "
            "leave them out or choose a method whose page lists them."
        )


def check_problem(problem: RetargetProblem) -> RetargetProblem:
    """The problem with its arrays as float64 and int64; raises InvalidInput where they do not fit together."""
    source = check_vertices("source_neutral", problem.source_neutral)
    n = len(source)
    target = check_vertices("target_neutral", problem.target_neutral, n)
    faces = check_faces("faces", problem.faces, n)
    target_examples = check_frames("target_examples", problem.target_examples, n)
    source_examples = None
    if problem.source_examples is not None:
        source_examples = check_frames("source_examples", problem.source_examples, n)
        if len(source_examples) != len(target_examples):
            raise InvalidInput(
                f"source_examples: expected one for each of the {len(target_examples)} target examples, "
                f"got {len(source_examples)}. Give corresponding pairs, or None where no correspondence is known."
            )
    check_triangle_areas("source_neutral", source, faces)
    check_triangle_areas("target_neutral", target, faces)
    return replace(
        problem,
        faces=faces,
        source_neutral=source,
        target_neutral=target,
        source_animation=check_frames("source_animation", problem.source_animation, n),
        target_examples=target_examples,
        source_examples=source_examples,
    )
