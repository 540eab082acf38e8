"""The renderer: geometry of the camera, colours, hidden points, and the same bits every time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from reports.render import Camera, draw_lines, draw_points, front, look, render_mesh, side, visible, write_image
from retarget.check import InvalidInput
from tests.reports.example_study import ball

SIZE = (90, 120)
VERTICES, FACES = ball()


def test_projection_by_hand() -> None:
    camera = Camera(eye=(0, 0, 100), target=(0, 0, 0), field_of_view=90.0)
    pixels = camera.project([[0, 0, 0], [50, 0, 0], [0, 100, 0]], (200, 100))
    np.testing.assert_allclose(pixels, [[100, 50], [125, 50], [100, 0]], atol=1e-9)


def test_rays_and_projection_are_inverse() -> None:
    camera = look(VERTICES, SIZE, turn=33, raise_=10)
    origin, directions = camera.rays(SIZE)
    pixels = camera.project(origin + 500 * directions.reshape(-1, 3), SIZE)
    centres = np.stack(np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(pixels, centres, atol=1e-6)


@pytest.mark.parametrize("turn", [0, 32, 90, -140])
def test_the_frame_just_holds_the_head(turn: float) -> None:
    pixels = look(VERTICES, SIZE, turn=turn, margin=0.05).project(VERTICES, SIZE) / SIZE
    assert pixels.min() >= 0.05 - 1e-9
    assert pixels.max() <= 0.95 + 1e-9
    assert np.isclose(pixels.min(axis=0), 0.05).any()
    np.testing.assert_allclose(pixels.min(axis=0) + pixels.max(axis=0), 1.0, atol=0.02)  # centred


def test_the_side_shows_the_left_of_the_head() -> None:
    assert side(VERTICES, SIZE).eye[0] > 100
    assert front(VERTICES, SIZE).eye[2] > 100


def test_the_picture_covers_the_silhouette_and_repeats() -> None:
    camera = front(VERTICES, SIZE)
    image = render_mesh(VERTICES, FACES, camera, SIZE, background=None)
    assert image.shape == (120, 90, 4)
    assert image.dtype == np.uint8
    radii = np.ptp(camera.project(VERTICES, SIZE), axis=0) / 2
    assert (image[..., 3] / 255).sum() == pytest.approx(np.pi * radii[0] * radii[1], rel=0.03)
    np.testing.assert_array_equal(image, render_mesh(VERTICES, FACES, camera, SIZE, background=None))


def test_values_pick_colours_and_nan_is_skin() -> None:
    values = np.where(VERTICES[:, 0] > 0, 1.0, 0.0)
    values[VERTICES[:, 1] < -40] = np.nan
    image = render_mesh(VERTICES, FACES, front(VERTICES, SIZE), SIZE, values, "gray", (0, 1), color="red").astype(int)
    left, right, below = image[50, 25], image[50, 65], image[110, 45]
    assert right.min() > 100
    assert left.max() < 40
    assert below[0] > 80
    assert below[1] < 40


def test_an_error_beyond_the_limit_is_drawn_like_the_limit() -> None:
    camera = front(VERTICES, SIZE)
    at, beyond = (render_mesh(VERTICES, FACES, camera, SIZE, np.full(len(VERTICES), v), limits=(0, 2)) for v in (2, 9))
    np.testing.assert_array_equal(at, beyond)


def test_what_lies_behind_is_darker_in_a_hollow() -> None:
    """A plane under a roof gets less light than one in the open."""
    plane = np.array([[-50, 0, -50], [50, 0, -50], [50, 0, 50], [-50, 0, 50]], dtype=float)
    faces = np.array([[0, 2, 1], [0, 3, 2]])
    camera = Camera(eye=(0, 150, 500), target=(0, 0, 0))
    roof = np.concatenate([plane, plane * 1.2 + [0, 15, 0]])
    open_, under = (
        render_mesh(v, f, camera, SIZE)
        for v, f in ((plane, faces), (roof, np.concatenate([faces, faces[:, ::-1] + 4])))
    )
    middle = tuple(np.round(camera.project([[0, 0, 45]], SIZE)[0]).astype(int)[::-1])
    assert under[middle].sum() < 0.8 * open_[middle].sum()


def test_hidden_points() -> None:
    camera = front(VERTICES, SIZE)
    towards, away = VERTICES[np.argmax(VERTICES[:, 2])], VERTICES[np.argmin(VERTICES[:, 2])]
    assert visible([towards, away], VERTICES, FACES, camera).tolist() == [True, False]


def test_points_and_lines_are_painted_where_they_are() -> None:
    blank = np.full((40, 60, 3), 255, dtype=np.uint8)
    dotted = draw_points(blank, [[20.5, 10.5]], color="black", radius=3, edge=None)
    assert dotted[10, 20].max() == 0
    assert dotted[10, 26].min() == 255
    assert blank.min() == 255
    line = draw_lines(blank, [[5, 20], [50, 20], [50, 30]], color="blue", closed=False, shown=[True, True, False])
    assert line[20, 30, 0] < 40
    assert line[27, 50].min() == 255
    assert draw_points(blank, [[-100, -100], [1000, 5]]).min() == 255  # outside: nothing


def test_images_are_written_without_dates(tmp_path: Path) -> None:
    image = render_mesh(VERTICES, FACES, front(VERTICES, SIZE), SIZE)
    for suffix in ("png", "jpg"):
        for name in ("one", "two"):
            write_image(tmp_path / f"{name}.{suffix}", image)
        assert (tmp_path / f"one.{suffix}").read_bytes() == (tmp_path / f"two.{suffix}").read_bytes()


def test_values_that_do_not_fit_are_refused() -> None:
    camera = front(VERTICES, SIZE)
    with pytest.raises(InvalidInput, match="vertex_values: expected one per vertex"):
        render_mesh(VERTICES, FACES, camera, SIZE, vertex_values=np.zeros(3))
    with pytest.raises(InvalidInput, match="vertex_colors: expected RGB"):
        render_mesh(VERTICES, FACES, camera, SIZE, vertex_colors=np.zeros((3, 3)))
