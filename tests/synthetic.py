"""A small cast of made-up heads for tests: ellipsoids with smooth bumps, and smooth expressions on their fronts."""

from __future__ import annotations

import numpy as np
import trimesh

from retarget.types import FloatArray, IntArray, Regions, RetargetProblem


def ball(subdivisions: int = 3) -> tuple[FloatArray, IntArray]:
    """The unit icosphere: 642 vertices and 1280 triangles for 3 subdivisions."""
    mesh = trimesh.creation.icosphere(subdivisions)
    return np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)


def head(identity: int, subdivisions: int = 3) -> FloatArray:
    """(n, 3) mm: an ellipsoid of a head's size with bumps of up to some mm of its own."""
    rng = np.random.default_rng([identity, 1])
    directions, _ = ball(subdivisions)
    radii = np.array([75.0, 110.0, 95.0]) * rng.uniform(0.93, 1.07, 3)
    waves = np.sin(directions @ rng.normal(0, 2.5, (3, 6)) + rng.uniform(0, 6, 6)) @ rng.normal(0, 0.015, 6)
    return directions * radii * (1 + waves)[:, None]


def expressions(
    identity: int, count: int, subdivisions: int = 3, seed: int = 0, personality: float = 0.3
) -> FloatArray:
    """(count, n, 3) mm: up to four moving spots on the front, at shared places with a personal part."""
    directions, _ = ball(subdivisions)
    neutral = head(identity, subdivisions)
    shared, own = np.random.default_rng([seed, 2]), np.random.default_rng([seed, 3, identity])
    frames = np.repeat(neutral[None], count, axis=0)
    for frame in frames:
        for _ in range(4):
            centre = shared.normal(size=3) * [0.6, 0.5, 0.2] + [0, -0.3, 0.9]
            motion = shared.normal(0, 6, 3) + personality * own.normal(0, 6, 3)
            distance = np.linalg.norm(directions - centre / np.linalg.norm(centre), axis=1)
            frame += np.exp(-((distance / shared.uniform(0.3, 0.6)) ** 2))[:, None] * motion
        frame[cranium(subdivisions)] = neutral[cranium(subdivisions)]
    return frames


def cranium(subdivisions: int = 3) -> IntArray:
    """The back and top of the head, which no expression moves."""
    directions, _ = ball(subdivisions)
    return np.flatnonzero(directions @ np.array([0.0, 0.6, -0.8]) > 0.5)


def landmarks(subdivisions: int = 3) -> dict[str, int]:
    """ibug_00 to ibug_50 on the front: brows, nose, eyes and mouth, each from the character's right to the left."""
    turn = np.linspace(np.pi, -np.pi, 12, endpoint=False)
    brow = np.stack([np.linspace(-0.25, 0.25, 5), [0.0, 0.12, 0.16, 0.12, 0.0]], axis=1)
    bridge = np.stack([np.zeros(4), np.linspace(0.25, 0.0, 4)], axis=1)
    base = np.stack([np.linspace(-0.2, 0.2, 5), [0.0, -0.05, -0.1, -0.05, 0.0]], axis=1) - [0, 0.1]
    eye = np.stack([0.2 * np.cos(turn[::2]), 0.13 * np.sin(turn[::2])], axis=1)
    lips = np.stack([0.4 * np.cos(turn), 0.25 * np.sin(turn)], axis=1)
    inside = 0.6 * lips[[0, 2, 3, 4, 6, 8, 9, 10]]
    left, up = np.array([0.4, 0.0]), np.array([0.0, 0.25])
    parts = [brow - left + 2 * up, brow + left + 2 * up, bridge, base]
    places = np.concatenate([*parts, eye - left + up, eye + left + up, lips - 2 * up, inside - 2 * up])
    wanted = np.column_stack([places, np.sqrt(1 - (places**2).sum(axis=1))])
    nearest = np.argmax(wanted @ ball(subdivisions)[0].T, axis=1)
    return {f"ibug_{i:02d}": int(vertex) for i, vertex in enumerate(nearest)}


def regions(subdivisions: int = 3) -> Regions:
    count = len(ball(subdivisions)[0])
    whole = {"head": np.arange(count), "cranium": cranium(subdivisions)}
    return Regions(vertices=whole, landmarks=landmarks(subdivisions))


def problem(
    source: int = 1, target: int = 2, examples: int = 5, frames: int = 9, subdivisions: int = 3
) -> RetargetProblem:
    """The first `examples` of `frames` expressions are the examples; all form the animation."""
    source_frames = expressions(source, frames, subdivisions)
    return RetargetProblem(
        faces=ball(subdivisions)[1],
        source_neutral=head(source, subdivisions),
        target_neutral=head(target, subdivisions),
        source_animation=source_frames,
        target_examples=expressions(target, examples, subdivisions),
        source_examples=source_frames[:examples],
        regions=regions(subdivisions),
    )
