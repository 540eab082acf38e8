"""Pictures of meshes by ray casting: no display, no graphics library of the system, the same bits every time.

`render_mesh` shades with a key light, a fill, a rim light and a sky, each dimmed by what the mesh itself hides;
`visible`, `draw_points` and `draw_lines` put landmarks and loops on top.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
import trimesh
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from matplotlib.colors import Colormap, to_rgb, to_rgba
from matplotlib.typing import ColorType
from numpy.typing import ArrayLike, NDArray

from reports.camera import Camera, front, look, side, three_quarter
from reports.colors import ERROR_COLORMAP, SKIN
from retarget.check import InvalidInput, check_faces, check_vertices
from retarget.types import FloatArray, IntArray

__all__ = [
    "ERROR_COLORMAP", "SKIN", "Camera", "draw_lines", "draw_points", "front", "look", "render_mesh", "side",
    "three_quarter", "visible", "write_image",
]  # fmt: skip

Image = NDArray[np.uint8]  # (h, w, 3) RGB or (h, w, 4) RGBA
Float32 = NDArray[np.float32]

# Studio lights, fixed to the camera (right, up, towards the viewer).
_KEY, _FILL, _RIM = ((-0.50, 0.55, 0.70), (0.85, 0.05, 0.50), (0.45, 0.55, -0.75))
_KEY_POWER, _FILL_POWER, _RIM_POWER, _SKY_POWER = 0.80, 0.24, 0.35, 0.44
_KEY_RADIUS = 0.22  # of the lamp as a tangent: soft shadows
_SKY_RAYS, _KEY_RAYS = 96, 12
_LIFT = 0.2  # mm that shadow rays start above the skin


def render_mesh(
    vertices: ArrayLike,
    faces: ArrayLike,
    camera: Camera,
    size: tuple[int, int] = (600, 800),
    vertex_values: ArrayLike | None = None,
    colormap: str | Colormap = ERROR_COLORMAP,
    limits: tuple[float, float] | None = None,
    vertex_colors: ArrayLike | None = None,
    color: ColorType = SKIN,
    background: ColorType | None = "white",
    samples: int = 2,
) -> Image:
    """Render vertices (n, 3) mm with faces (f, 3) into a picture of size (width, height) pixels.

    vertex_values (n,) are shown by `colormap` between `limits` (by default 0 and their largest), NaN in `color`;
    vertex_colors (n, 3) RGB in [0, 1] are shown as they are; without either the mesh has one `color`. Returns
    (height, width, 3) uint8, or with ``background=None`` (height, width, 4) with transparent surroundings.
    Each pixel averages samples x samples rays. Raises InvalidInput for arrays that do not fit each other.
    """
    v = check_vertices("vertices", vertices)
    f = check_faces("faces", faces, len(v))
    albedo, mapped = _albedo(len(v), vertex_values, colormap, limits, vertex_colors, color)
    scene = _scene(v, f)
    origin, directions = camera.rays(size, samples)
    hits = scene.run(
        np.broadcast_to(origin, (directions[..., 0].size, 3)).astype(np.float32),
        directions.reshape(-1, 3).astype(np.float32),
        output=1,
    )
    hit = np.flatnonzero(hits["primID"] >= 0)
    triangle, u, w = f[hits["primID"][hit]], hits["u"][hit], hits["v"][hit]
    mesh = trimesh.Trimesh(v, f, process=False)
    normals = np.asarray(mesh.vertex_normals)
    light = np.zeros((len(v), 2))
    seen = np.unique(triangle)
    light[seen] = _light_reaching(scene, v[seen], normals[seen], camera)
    attributes = np.column_stack([normals, light, albedo]).astype(np.float32)
    at = (1 - u - w)[:, None] * attributes[triangle[:, 0]]
    at += u[:, None] * attributes[triangle[:, 1]]
    at += w[:, None] * attributes[triangle[:, 2]]
    towards_viewer = -directions.reshape(-1, 3)[hit].astype(np.float32)
    facing = np.einsum("ij,ij->i", mesh.face_normals[hits["primID"][hit]].astype(np.float32), towards_viewer)
    rgb = _shade(
        at[:, :3], towards_viewer, at[:, 3:5], mapped(at[:, 5:]), facing < 0, camera, gloss=vertex_values is None
    )
    return _develop(rgb, hit, size, samples, background)


def visible(
    points: ArrayLike, vertices: ArrayLike, faces: ArrayLike, camera: Camera, lift: float = 1.0
) -> NDArray[np.bool_]:
    """(m,) whether the camera sees points (m, 3) mm on the mesh, tested from `lift` mm before them."""
    v = check_vertices("vertices", vertices)
    p = check_vertices("points", points)
    towards = np.subtract(camera.eye, p)
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    scene = _scene(v, check_faces("faces", faces, len(v)))
    hidden = scene.run((p + lift * towards).astype(np.float32), towards.astype(np.float32), query="OCCLUDED")
    return np.asarray(hidden < 0)


def sky_share(vertices: ArrayLike, faces: ArrayLike) -> FloatArray:
    """(n,) share in [0, 1] of an even sky that reaches vertices (n, 3) mm past their own mesh with faces (f, 3)."""
    v = check_vertices("vertices", vertices)
    f = check_faces("faces", faces, len(v))
    normals = np.asarray(trimesh.Trimesh(v, f, process=False).vertex_normals)
    return _sky_share(_scene(v, f), v + _LIFT * normals, normals)


def draw_points(
    image: Image, pixels: ArrayLike, color: ColorType = "#c1121f", radius: float = 4.0, edge: ColorType | None = "white"
) -> Image:
    """A copy of the image with a disc of `radius` pixels at each of pixels (m, 2), each with a thin edge."""
    out = image.copy()
    for centre in np.asarray(pixels, dtype=np.float64).reshape(-1, 2):
        if edge is not None:
            _stroke(out, centre, centre, radius + 1.2, edge)
        _stroke(out, centre, centre, radius, color)
    return out


def draw_lines(
    image: Image,
    pixels: ArrayLike,
    color: ColorType = "#c1121f",
    width: float = 2.5,
    closed: bool = True,
    shown: ArrayLike | None = None,
) -> Image:
    """A copy of the image with the line through pixels (m, 2), closed to a loop unless told otherwise.

    Where `shown` (m,) is given, only segments with both ends shown are drawn.
    """
    out, p = image.copy(), np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    keep = np.ones(len(p), dtype=bool) if shown is None else np.asarray(shown, dtype=bool)
    for i in range(len(p) if closed else len(p) - 1):
        j = (i + 1) % len(p)
        if keep[i] and keep[j]:
            _stroke(out, p[i], p[j], width / 2, color)
    return out


def write_image(path: Path | str, image: Image) -> None:
    """Write PNG or, by the suffix, JPEG; no dates inside."""
    from PIL import Image as Pillow

    options: dict[str, int] = {"quality": 90, "subsampling": 0} if Path(path).suffix == ".jpg" else {}
    Pillow.fromarray(image).save(path, format=None, **options)


def _albedo(
    count: int,
    vertex_values: ArrayLike | None,
    colormap: str | Colormap,
    limits: tuple[float, float] | None,
    vertex_colors: ArrayLike | None,
    color: ColorType,
) -> tuple[FloatArray, Callable[[Float32], Float32]]:
    """Channels (n, c) to interpolate over triangles, and what turns them into linear RGB (m, 3)."""
    plain = _linear(to_rgb(color))
    if vertex_values is not None:
        values = np.asarray(vertex_values, dtype=np.float64)
        if values.shape != (count,):
            raise InvalidInput(f"vertex_values: expected one per vertex, shape ({count},), got {values.shape}.")
        known = np.isfinite(values)
        low, high = limits or (0.0, float(values[known].max(initial=0.0)))
        unit = np.where(known, (values - low) / max(high - low, 1e-12), 0.0)
        table = _linear(matplotlib.colormaps.get_cmap(colormap)(np.linspace(0, 1, 1024))[:, :3])

        def mapped(channels: Float32) -> Float32:
            share = channels[:, 1:]
            index = np.clip(channels[:, 0] / np.maximum(share[:, 0], 1e-6) * 1023, 0, 1023).astype(np.int64)
            return share * table[index] + (1 - share) * plain

        return np.column_stack([unit, known]), mapped
    if vertex_colors is not None:
        colors = np.asarray(vertex_colors, dtype=np.float64)
        if colors.shape != (count, 3):
            raise InvalidInput(f"vertex_colors: expected RGB of shape ({count}, 3) in [0, 1], got {colors.shape}.")
        return _linear(colors).astype(np.float64), lambda channels: channels
    return np.empty((count, 0)), lambda channels: np.broadcast_to(plain, (len(channels), 3))


def _light_reaching(scene: rtcore_scene.EmbreeScene, v: FloatArray, normals: FloatArray, camera: Camera) -> FloatArray:
    """(n, 2) shares of the key light and of the sky that reach each vertex past the mesh itself."""
    key = _unit(_KEY)
    across = _unit(np.cross(key, [0.0, 1.0, 0.0]))
    spiral = _sunflower(_KEY_RAYS) * _KEY_RADIUS
    lamp = _unit(key + spiral[:, :1] * across + spiral[:, 1:] * np.cross(key, across)) @ camera.axes
    origins = v + _LIFT * normals
    key_share = _unhidden(scene, origins, lamp, np.ones((len(v), len(lamp))))
    return np.column_stack([key_share, _sky_share(scene, origins, normals)])


def _sky_share(scene: rtcore_scene.EmbreeScene, origins: FloatArray, normals: FloatArray) -> FloatArray:
    sky = _sphere(_SKY_RAYS)
    return _unhidden(scene, origins, sky, np.maximum(normals @ sky.T, 0.0))


def _unhidden(
    scene: rtcore_scene.EmbreeScene, origins: FloatArray, directions: FloatArray, weights: FloatArray
) -> FloatArray:
    """(n,) weighted share of directions (r, 3) in which origins (n, 3) see past the mesh; weights (n, r) >= 0."""
    vertex, ray = np.nonzero(weights > 0.05)
    free = scene.run(origins[vertex].astype(np.float32), directions[ray].astype(np.float32), query="OCCLUDED") < 0
    weight = weights[vertex, ray]
    total = np.bincount(vertex, weight, len(origins))
    return np.bincount(vertex, weight * free, len(origins)) / np.maximum(total, 1e-12)


def _shade(
    normals: Float32,
    viewer: Float32,
    reaching: Float32,
    albedo: Float32,
    inside: NDArray[np.bool_],
    camera: Camera,
    gloss: bool,
) -> Float32:
    """Linear RGB (m, 3) of surface points: Lambert terms of the four lights, and a soft sheen where `gloss`."""
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    normals[inside] *= -1
    lights = (_unit(np.array([_KEY, _FILL, _RIM])) @ camera.axes).astype(np.float32)
    key, fill, rim = np.maximum(normals @ lights.T, 0).T
    key_share, sky_share = reaching.T
    up = normals @ camera.axes[1].astype(np.float32)
    light = _KEY_POWER * key * key_share + (_FILL_POWER * fill + _SKY_POWER * (0.7 + 0.3 * up)) * sky_share
    light += _RIM_POWER * rim * sky_share
    light *= np.where(inside, np.float32(0.35), np.float32(1.0))
    if not gloss:  # a map's colours stay close to those of its colour bar
        light = 0.25 * sky_share + 0.75 * np.minimum(light, 1)
    rgb = albedo * light[:, None]
    if gloss:
        half = viewer + lights[0]
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        sheen = np.maximum(np.einsum("ij,ij->i", normals, half), 0) ** 24
        rgb += (0.06 * sheen * key_share)[:, None]
    return rgb.astype(np.float32)


def _develop(rgb: Float32, hit: IntArray, size: tuple[int, int], samples: int, background: ColorType | None) -> Image:
    """Average the sub-pixels `hit` with colours (m, 3), the rest being background, into 8-bit sRGB."""
    layers = np.zeros((size[0] * size[1] * samples**2, 4), dtype=np.float32)
    layers[hit, :3] = _srgb(rgb)
    layers[hit, 3] = 1.0
    pixels = layers.reshape(size[1], samples, size[0], samples, 4).mean(axis=(1, 3))
    color, cover = pixels[..., :3], pixels[..., 3:]
    if background is None:
        out = np.concatenate([color / np.maximum(cover, 1e-6), cover], axis=-1)
    else:
        out = color + (1 - cover) * np.array(to_rgb(background), dtype=np.float32)
    return np.round(np.clip(out, 0, 1) * 255).astype(np.uint8)


def _scene(v: FloatArray, f: IntArray) -> rtcore_scene.EmbreeScene:
    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, v.astype(np.float32), f.astype(np.int32))
    return scene


def _stroke(image: Image, start: FloatArray, end: FloatArray, radius: float, color: ColorType) -> None:
    """Paint a line with round ends, anti-aliased by its distance field, into the image."""
    low = np.maximum(np.floor(np.minimum(start, end) - radius - 1).astype(int), 0)
    high = np.minimum(np.ceil(np.maximum(start, end) + radius + 2).astype(int), (image.shape[1], image.shape[0]))
    if (high <= low).any():
        return
    grid = np.stack(np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5), axis=-1)
    along = end - start
    share = np.clip(((grid - start) @ along) / max(float(along @ along), 1e-12), 0, 1)
    distance = np.linalg.norm(grid - start - share[..., None] * along, axis=-1)
    cover = np.clip(radius - distance + 0.5, 0, 1)[..., None]
    paint = np.array(to_rgba(color))[: image.shape[2]] * 255
    window = image[low[1] : high[1], low[0] : high[0]]
    window[:] = np.round(window * (1 - cover) + paint * cover)


def _linear(srgb: ArrayLike) -> Float32:
    c = np.asarray(srgb, dtype=np.float32)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _srgb(linear: Float32) -> Float32:
    c = np.clip(linear, 0, 1)
    return np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055).astype(np.float32)


def _unit(vectors: ArrayLike) -> FloatArray:
    v = np.asarray(vectors, dtype=np.float64)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _sunflower(count: int) -> FloatArray:
    """(count, 2) points spread evenly over the unit disc."""
    i = np.arange(count)
    angle = i * np.pi * (3 - np.sqrt(5))
    return np.sqrt((i + 0.5) / count)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def _sphere(count: int) -> FloatArray:
    """(count, 3) unit vectors spread evenly over the sphere."""
    i = np.arange(count)
    height = 1 - (2 * i + 1) / count
    angle = i * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - height**2)
    return np.column_stack([ring * np.cos(angle), height, ring * np.sin(angle)])
