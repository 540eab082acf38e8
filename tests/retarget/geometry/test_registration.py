"""Registration of a ball to a head-sized ellipsoid with a bump, where the other surface is known."""

from __future__ import annotations

import numpy as np
import trimesh

from retarget.geometry.oriented import OrientedSurface, vertex_normals
from retarget.geometry.registration import register


def test_a_ball_comes_to_lie_on_an_ellipsoid_and_its_landmarks_on_theirs() -> None:
    ball, fine = trimesh.creation.icosphere(3), trimesh.creation.icosphere(4)
    moving, faces = np.asarray(ball.vertices) * 80.0, np.asarray(ball.faces, dtype=np.int64)
    directions = np.asarray(fine.vertices)
    bump = 12 * np.exp(-8 * np.sum((directions - [0, 0, 1]) ** 2, axis=1))
    fixed = directions * [75.0, 110.0, 95.0] + bump[:, None] * [0.0, 0.3, 1.0]
    fixed_faces = np.asarray(fine.faces, dtype=np.int64)
    ours = np.array([int(np.argmax(ball.vertices @ d)) for d in np.vstack([np.eye(3), -np.eye(3)])])
    theirs = np.array([int(np.argmax(directions @ d)) for d in np.vstack([np.eye(3), -np.eye(3)])])

    found = register(moving, faces, np.arange(len(moving)), fixed, fixed_faces, (ours, theirs))

    surface = OrientedSurface(fixed, fixed_faces)
    sample = surface.closest(found, vertex_normals(found, faces))
    off = np.abs(np.einsum("ij,ij->i", surface.positions[sample] - found, surface.normals[sample]))
    assert off.max() < 0.3
    assert np.linalg.norm(found[ours] - fixed[theirs], axis=1).max() < 0.2
    assert np.median(np.linalg.norm(found - (moving / 80 * [75.0, 110.0, 95.0]), axis=1)) < 3.0  # little sliding


def test_what_does_not_follow_is_carried_along() -> None:
    ball = trimesh.creation.icosphere(3)
    moving, faces = np.asarray(ball.vertices) * 80.0, np.asarray(ball.faces, dtype=np.int64)
    corners = np.array([int(np.argmax(ball.vertices @ d)) for d in np.vstack([np.eye(3), -np.eye(3)])])
    fixed = moving * 1.1 + np.array([5.0, 0.0, 0.0])
    front = np.flatnonzero(moving[:, 2] > 0)
    found = register(moving, faces, front, fixed, faces, (corners, corners))
    np.testing.assert_allclose(found, fixed, atol=0.5)
