from dataclasses import replace

import numpy as np
import pytest
import pyvista as pv
from scipy.optimize import nnls

from retarget.check import InvalidInput
from retarget.simulation.bones import pivot
from retarget.simulation.collisions import TRIGGER, Lips
from retarget.simulation.contact_forces import Parting, complementary
from retarget.simulation.facing import FACING, FacingSurface, Samples, vertex_normals
from retarget.simulation.forward import ForwardSettings, ForwardSimulation
from retarget.simulation.penetration import REACH, Surface, inside, nearest_on_triangle
from retarget.simulation.state import Bones, RigidMotion
from retarget.types import Regions, Status
from tests.retarget.simulation.box_head import GAP, box_head
from tests.retarget.simulation.test_bones import turn


@pytest.fixture(scope="module")
def head():
    return box_head()


@pytest.fixture(scope="module")
def lips(head):
    return Lips(head.skin, head.template.faces, head.template.regions)


def strip(height, curve=0.0):
    """Two facing strips, the lower one `height` mm above where they touch; the upper one arches by `curve` mm."""
    x, z = (a.ravel() for a in np.meshgrid(np.linspace(-10, 10, 11), np.linspace(0, 6, 4), indexing="ij"))
    lower = np.c_[x, np.full(44, height), z]
    upper = np.c_[x + 0.3, curve * (1 - (x / 10) ** 2), z + 0.2]
    quad = (np.arange(10)[:, None] * 4 + np.arange(3)).ravel()
    up = np.concatenate([np.c_[quad, quad + 1, quad + 5], np.c_[quad, quad + 5, quad + 4]])
    faces = np.concatenate([up, up[:, ::-1] + 44])
    regions = Regions(vertices={"lower_lip": np.arange(44), "upper_lip": np.arange(44, 88)})
    return np.vstack([lower, upper]), faces, regions


def test_gaps_on_an_arch():
    """Against vtk's nearest cells; the sign is that of the height above the arch."""
    lips = Lips(*strip(-1.0))
    skin, faces, _ = strip(0.4, curve=0.8)
    found = lips.gaps(skin)
    points = np.einsum("sc,sci->si", lips.samples.weights, skin[lips.samples.corners])
    nearest = np.einsum("sc,sci->si", found.weights, skin[found.corners])
    lower, seen = lips.samples.corners[:, 0] < 44, np.isfinite(found.gap)
    assert 60 < seen.sum() < lips.samples.count  # those beyond the rim of the other strip have none
    for mine, other in ((lower, faces[faces[:, 0] >= 44]), (~lower, faces[faces[:, 0] < 44])):
        use = mine & seen
        _, closest = pv.PolyData.from_regular_faces(skin, other).find_closest_cell(
            points[use], return_closest_point=True
        )
        np.testing.assert_allclose(np.abs(found.gap[use]), np.linalg.norm(closest - points[use], axis=1), atol=1e-6)
        np.testing.assert_allclose(nearest[use], closest, atol=1e-5)
    above = np.where(lower, 1, -1) * (points - nearest)[:, 1]
    clear = seen & (np.abs(found.gap) > 0.03)
    np.testing.assert_array_equal(np.sign(found.gap[clear]), -np.sign(above[clear]))
    opening = np.einsum("si,si->s", points - nearest, found.normal)
    np.testing.assert_allclose(opening[clear], found.gap[clear], atol=1e-9)
    assert (found.gap[seen & lower & (np.abs(points[:, 0]) < 4)] > 0).all()  # under the arch


@pytest.mark.parametrize(("height", "met"), [(-1.0, False), (0.5 * TRIGGER, False), (0.2, True)])
def test_only_what_is_inside_counts(height, met):
    lips = Lips(*strip(-1.0))
    skin = strip(height)[0]
    assert lips.meet(skin) == met
    gap = lips.gaps(skin).gap
    np.testing.assert_allclose(gap[np.isfinite(gap)], -height, atol=1e-9)


def test_gaps_of_many_triangles():
    """Two wavy sheets, some triangles long: the nearest point on triangles that face a sample, one by one."""
    vertices, faces = sheet()
    rng = np.random.default_rng(2)
    vertices += np.where(rng.random((len(vertices), 1)) < 0.02, 1.5, 0.1) * rng.normal(size=vertices.shape)
    both = np.vstack([vertices, vertices * [1, 0.5, 1] + [0.3, 0.1, 0.2]])
    upper = faces[:, ::-1] + len(vertices)
    samples = Samples.of(np.arange(len(vertices), len(both), 13), upper[::29])
    normals = vertex_normals(both, np.vstack([faces, upper]))
    found = FacingSurface(faces, len(both)).gaps(both, normals, samples, near=2.0, reach=2.0)
    points, up = (np.einsum("sc,sci->si", samples.weights, a[samples.corners]) for a in (both, normals))
    flat = np.cross(both[faces[:, 1]] - both[faces[:, 0]], both[faces[:, 2]] - both[faces[:, 0]])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    seen = np.isfinite(found.gap)
    for k, (point, normal) in enumerate(zip(points, up, strict=True)):
        facing = faces[flat @ normal <= FACING * np.linalg.norm(normal)]
        nearest = min(nearest_on_triangle(point, *both[face])[0] for face in facing) ** 0.5
        if seen[k]:
            assert abs(found.gap[k]) == pytest.approx(nearest, abs=1e-9)
            place = found.weights[k] @ both[found.corners[k]]
            assert np.linalg.norm(point - place) == pytest.approx(nearest, abs=1e-9)
    assert (found.gap[seen] < 0).sum() > 50 < (found.gap[seen] > 0).sum()
    assert seen.sum() > 0.7 * len(seen)


def test_the_side_of_a_sharp_ridge():
    """Beside a knife's edge a point is behind the plane of one of its sides, and outside all the same."""
    z = np.arange(4.0)
    ridge, right, left = (np.c_[np.full(4, x), np.full(4, y), z] for x, y in ((0, 0), (0.8, -3), (-0.8, -3)))
    across = np.concatenate([np.c_[z, z + 5, z + 4], np.c_[z, z + 1, z + 5]])[[0, 1, 2, 4, 5, 6]].astype(int)
    swapped = np.where(across > 3, across + 4, across)[:, ::-1]
    points = np.array([[0.2, 0.3, 1.5], [-0.2, 0.3, 1.5], [0.0, -0.4, 1.5]])
    x = np.vstack([ridge, right, left, points])
    normals = vertex_normals(x, np.vstack([across, swapped]))
    normals[12:] = [[0, -1, 0], [0, -1, 0], [-1, 0, 0]]
    surface, samples = FacingSurface(np.vstack([across, swapped]), 15), Samples.of(np.arange(12, 15), across[:0])
    gap = surface.gaps(x, normals, samples, near=1.0, reach=2.0).gap
    np.testing.assert_allclose(gap[:2], np.hypot(0.2, 0.3))
    assert gap[2] < 0


def test_points_far_away_and_not_finite_have_no_gaps():
    lips, (skin, *_) = Lips(*strip(-1.0)), strip(0.2)
    scattered = 1e9 * np.random.default_rng(0).normal(size=skin.shape)
    assert not np.isfinite(lips.gaps(scattered).gap).any()
    assert not lips.meet(np.where(np.arange(88)[:, None] == 7, np.nan, skin))
    assert lips.depth(np.where(np.arange(88)[:, None] == 7, np.nan, skin)) == 0.0


def test_a_surface_that_faces_the_same_way_is_no_contact():
    """The outer side of a lip: the point has come out again, or was never in."""
    rest, faces, regions = strip(-1.0)
    faces = np.concatenate([faces[: len(faces) // 2], faces[len(faces) // 2 :, ::-1]])
    assert not Lips(rest, faces, regions).meet(strip(0.2)[0])


def test_lips_that_cross_at_rest_count_where_they_go_deeper():
    lips = Lips(*strip(0.2))
    assert not lips.meet(strip(0.24)[0])
    assert lips.meet(strip(0.4)[0])
    assert not Lips(*strip(1.2)).meet(strip(1.9)[0])  # folded, not in contact


def test_corners_are_no_samples(head):
    lips = Lips(head.skin, head.template.faces, head.template.regions)
    shared = np.intersect1d(*(head.template.regions.vertices[n] for n in ("upper_lip", "lower_lip")))
    assert len(shared)
    assert np.isin(shared, lips.vertices).all()
    assert not np.isin(lips.vertices[lips.samples.corners], shared).any()


def parting(rest, faces, regions, softness, stiffness=1e6):
    """Points that move by themselves, each as far as `softness` (88,) says."""
    lips = Lips(rest, faces, regions)
    return lips, Parting(lips.gaps, lips.samples, lips.floor, rest, np.diag(softness), stiffness)


def test_lips_of_equal_softness_meet_half_way():
    """Section 3.3.2: both sides go to their average position."""
    rest, faces, regions = strip(-1.0)
    rest[44:, [0, 2]] = rest[:44, [0, 2]]  # vertex over vertex
    _, both = parting(rest, faces, regions, np.ones(88))
    free = rest + np.where(np.arange(88) < 44, 1.4, 0.0)[:, None] * [0, 1, 0]
    inner = np.isin(np.arange(44), [4 * i + j for i in range(1, 10) for j in (1, 2)])
    for found in (both.directly(free, 12), next(both.along(free, 12))):
        points = free + found.forces
        assert found.left < 0.05
        np.testing.assert_allclose(points[:44][inner, 1], 0.2, atol=0.02)
        np.testing.assert_allclose(points[44:][inner, 1], 0.2, atol=0.02)
        np.testing.assert_allclose(found.forces.sum(axis=0), 0.0, atol=1e-9)


def test_the_softer_lip_gives_way():
    rest, faces, regions = strip(-1.0)
    softness = np.r_[np.full(44, 3.0), np.full(44, 1.0)]
    lips, uneven = parting(rest, faces, regions, softness)
    free = rest + np.where(np.arange(88) < 44, 1.4, 0.0)[:, None] * [0, 1, 0]
    moved = softness[:, None] * uneven.directly(free, 12).forces
    assert -moved[:44, 1].mean() == pytest.approx(3 * moved[44:, 1].mean())
    assert (lips.gaps(free + moved).gap > -0.05).all()


def crossed_wholly():
    """5 mm deep, nothing of the one lip is near the other: the lips, what parts them, and the free points."""
    rest, faces, regions = strip(-1.0)
    lips = Lips(rest, faces, regions)
    apart = np.linalg.norm(rest[:, None] - rest[None], axis=2)
    soft = np.exp(-0.5 * (apart / 4) ** 2) * (np.arange(88)[:, None] // 44 == np.arange(88) // 44)
    free = rest + np.where(np.arange(88) < 44, 6.0, 0.0)[:, None] * [0, 1, 0]
    return soft, Parting(lips.gaps, lips.samples, lips.floor, rest, soft, 1000.0), free


def test_a_lip_wholly_through_the_other_one_is_parted_on_its_way():
    """Only the way tells the side."""
    soft, both, free = crossed_wholly()
    found = next(both.along(free, 12))
    points = free + soft @ found.forces
    assert found.way == 1
    inner = [4 * i + j for i in range(1, 10) for j in (1, 2)]
    np.testing.assert_allclose(points[inner, 1].mean(), 2.5, atol=0.5)
    assert points[44:, 1].mean() > points[:44, 1].mean() - 0.05


def test_the_way_has_an_end(monkeypatch):
    """Rounds are bounded, the states tried back are few, and the last one holds all points at rest."""
    soft, both, free = crossed_wholly()
    monkeypatch.setattr("retarget.simulation.contact_forces.LONGEST", 3)
    states = list(both.along(free, 12))
    assert 3 <= states[0].rounds <= 3 + 5
    ways = [state.way for state in states]
    assert 0 < ways[0] < 1
    assert ways == sorted(ways, reverse=True)
    assert ways[-1] == 0.0
    rest = strip(-1.0)[0]
    np.testing.assert_allclose((free + soft @ states[-1].forces)[:, 1], rest[:, 1], atol=0.05)


def test_complementary_forces():
    """Against scipy's active set method on the same quadratic programme."""
    rng = np.random.default_rng(3)
    for count in (1, 7, 40):
        root = rng.normal(size=(count, count + 2))
        matrix, wanted = root @ root.T + 0.01 * np.eye(count), rng.normal(size=count)
        forces = complementary(matrix, wanted, rng.random(count) < 0.5)
        lower = np.linalg.cholesky(matrix)
        expected, _ = nnls(lower.T, np.linalg.solve(lower, wanted))
        np.testing.assert_allclose(forces, expected, atol=1e-7)
        assert (matrix @ forces - wanted > -1e-8).all()
        assert forces @ (matrix @ forces - wanted) == pytest.approx(0, abs=1e-7)


def sheet():
    x, z = (a.ravel() for a in np.meshgrid(np.linspace(-20, 20, 41), np.linspace(-20, 20, 41), indexing="ij"))
    quad = (np.arange(40)[:, None] * 41 + np.arange(40)).ravel()
    faces = np.concatenate([np.c_[quad, quad + 1, quad + 42], np.c_[quad, quad + 42, quad + 41]])
    return np.c_[x, 2 * np.sin(x / 5) * np.cos(z / 6), z], faces


def test_nearest_points_of_a_wavy_sheet():
    """Against vtk's nearest cells."""
    vertices, faces = sheet()
    rng = np.random.default_rng(0)
    points = np.c_[rng.uniform(-22, 22, 300), rng.uniform(-7, 7, 300), rng.uniform(-22, 22, 300)]
    skin = np.vstack([vertices, points, [[0, -30, 0]]])
    distances, triangles, barycentric = Surface(faces).nearest(skin, np.arange(len(vertices), len(skin)))
    _, nearest = pv.PolyData.from_regular_faces(vertices, faces).find_closest_cell(points, return_closest_point=True)
    np.testing.assert_allclose(distances[:-1], np.linalg.norm(nearest - points, axis=1), atol=1e-6)
    np.testing.assert_allclose(np.einsum("kc,kci->ki", barycentric, skin[triangles])[:-1], nearest, atol=1e-5)
    assert distances[-1] == REACH
    assert barycentric[-1].max() == 0
    assert Surface(faces[:0]).nearest(skin, np.arange(3))[0].min() == REACH


def winding(vertices, faces, points):
    """Winding number of a closed surface about each of points (k, 3), from solid angles (Van Oosterom, Strackee 1983):
    independent of rays."""
    a, b, c = (vertices[faces[:, i]][None] - points[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(e, axis=2) for e in (a, b, c))
    volume = np.einsum("kfi,kfi->kf", a, np.cross(b, c))
    rest = la * lb * lc + sum(np.einsum("kfi,kfi->kf", u, v) * w for u, v, w in ((a, b, lc), (b, c, la), (c, a, lb)))
    return np.arctan2(volume, rest).sum(axis=1) / (2 * np.pi)


def test_inside_of_a_surface_that_crosses_itself():
    """Two balls that overlap, one of them hollow: the rays count what the solid angles say."""
    balls = [
        pv.Sphere(radius=5),
        pv.Sphere(radius=4, center=(3, 1, 2)),
        pv.Sphere(radius=2, center=(-1, 0, 0)).flip_faces(),
    ]
    start = np.cumsum([0] + [ball.n_points for ball in balls[:-1]])
    vertices = np.vstack([ball.points for ball in balls]).astype(float)
    faces = np.vstack([ball.regular_faces + first for ball, first in zip(balls, start, strict=True)])
    points = np.random.default_rng(0).uniform(-8, 8, (500, 3))
    skin = np.vstack([vertices, points])
    found = inside(skin, faces, np.arange(len(vertices), len(skin)))
    expected = winding(vertices, faces, points)
    np.testing.assert_allclose(expected, np.round(expected), atol=1e-9)
    assert {0, 1, 2} == set(np.round(expected).astype(int))
    np.testing.assert_array_equal(found, expected > 0.5)
    own = np.arange(start[2])  # vertices of the balls: outside of their own, inside of the other if within
    within = np.r_[np.linalg.norm(vertices[: start[1]] - [3, 1, 2], axis=1) < 3.9, np.zeros(start[2] - start[1], bool)]
    within[start[1] :] = np.linalg.norm(vertices[start[1] : start[2]], axis=1) < 4.9
    clear = np.r_[
        np.abs(np.linalg.norm(vertices[: start[1]] - [3, 1, 2], axis=1) - 4) > 0.1,
        np.abs(np.linalg.norm(vertices[start[1] : start[2]], axis=1) - 5) > 0.1,
    ]
    hollow = np.linalg.norm(vertices[own] + [1, 0, 0], axis=1) < 2.1
    keep = clear & ~hollow
    assert 100 < within[keep].sum() < keep.sum() - 100
    np.testing.assert_array_equal(inside(skin, faces, own)[keep], within[keep])


def test_no_ray_slips_between_triangles():
    """Rays through vertices and edges of a cube's grid."""
    cube = pv.Box((-2, 2, -2, 2, -2, 2), level=3).triangulate().clean()
    grid = np.stack(np.meshgrid(*[np.linspace(-1.5, 1.5, 7)] * 3), axis=-1).reshape(-1, 3)
    skin = np.vstack([cube.points, grid, grid + np.array([4, 0, 0]), grid - np.array([0, 0, 4])]).astype(float)
    found = inside(skin, cube.regular_faces, np.arange(cube.n_points, len(skin)))
    np.testing.assert_array_equal(found, np.repeat([True, False, False], len(grid)))


def closed(head, lift, degrees=0.0):
    still = RigidMotion(np.eye(3), np.zeros(3), pivot(head))
    return Bones(still, RigidMotion(turn("x", -degrees), np.array([0, lift, 0.0]), pivot(head)))


def depth(head, skin):
    """mm: how deep any point of one lip lies behind the nearest point of the other, along that surface's normal.

    Independent of the resolver, which measures straight up and down. Points nearest to a rim are beyond the lip.
    """
    regions = head.template.regions
    lips, deepest = Lips(head.skin, head.template.faces, regions), 0.0
    for mine, other, surface in (
        ("upper_lip", "lower_lip", lips.lower_faces),
        ("lower_lip", "upper_lip", lips.upper_faces),
    ):
        points = np.setdiff1d(regions.vertices[mine], regions.vertices[other])
        mesh = pv.PolyData.from_regular_faces(skin, surface)
        triangle, nearest = mesh.find_closest_cell(skin[points], return_closest_point=True)
        a, b, c = (skin[surface[triangle, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        inside = np.einsum("ij,ij->i", nearest - skin[points], normal / np.linalg.norm(normal, axis=1, keepdims=True))
        distance = np.linalg.norm(nearest - skin[points], axis=1)
        inner = np.abs(np.abs(inside) - distance) < 1e-4  # the nearest point is straight below: within the surface
        deepest = max(deepest, float(inside[inner].max(initial=0.0)))
    return deepest


@pytest.mark.parametrize("bones", [(4.0, 0.0), (2.5, 0.0), (1.0, 5.0), (2.0, 10.0)])
def test_lips_are_parted(head, bones):
    gradients = np.broadcast_to(np.eye(3), (len(head.template.tets), 3, 3))
    motion = closed(head, *bones)
    crossed = ForwardSimulation(head, ForwardSettings(collisions=False))(gradients, motion)
    parted = ForwardSimulation(head)(gradients, motion)
    assert depth(head, crossed.skin) > 0.2
    assert depth(head, parted.skin) < 0.1
    assert parted.lips.before > 0.2 > 0.1 > parted.lips.after
    assert "lip" in parted.info.message
    assert (parted.info.status is Status.CONVERGED) == (parted.lips.way == 1.0)
    moved = np.linalg.norm(parted.vertices - crossed.vertices, axis=1)
    inside = np.setdiff1d(np.arange(len(moved)), head.template.embedding[parted_rows(head)].indices)
    assert moved[inside].max() > 0.1  # the displacement goes on into the tissue
    assert moved[head.template.fixed].max() == 0


def parted_rows(head):
    return np.union1d(head.template.regions.vertices["upper_lip"], head.template.regions.vertices["lower_lip"])


def test_what_is_not_resolved_is_said(head):
    """Lips that are held once only."""
    gradients = np.broadcast_to(np.eye(3), (len(head.template.tets), 3, 3))
    state = ForwardSimulation(head, ForwardSettings(collision_rounds=1, collision_stiffness=0.05))(
        gradients, closed(head, 4.0)
    )
    assert state.lips.after <= state.lips.before
    assert state.info.status is Status.MAX_ITERATIONS
    assert state.lips.after > 0.1 or state.lips.way < 1
    assert f"{state.lips.after:.2f} mm left; held where" in state.info.message
    assert f"after {100 * state.lips.way:.0f} % of their way" in state.info.message


@pytest.mark.parametrize("bones", [(8.0, 0.0), (20.0, 0.0), (40.0, 0.0), (0.0, 25.0), (-3.0, 30.0)])
def test_never_deeper_than_without_contacts(head, bones):
    gradients = np.broadcast_to(np.eye(3), (len(head.template.tets), 3, 3))
    motion = closed(head, *bones)
    state = ForwardSimulation(head)(gradients, motion)
    crossed = ForwardSimulation(head, ForwardSettings(collisions=False))(gradients, motion)
    lips = Lips(head.skin, head.template.faces, head.template.regions)
    assert state.lips.before == pytest.approx(lips.depth(crossed.skin), abs=1e-9)
    assert state.lips.after == pytest.approx(lips.depth(state.skin), abs=1e-9)
    assert state.lips.after <= state.lips.before
    if state.lips.after > 0.1 or state.lips.way < 1:
        assert state.info.status is Status.MAX_ITERATIONS
        assert f"{state.lips.after:.2f} mm left" in state.info.message


def test_lips_that_do_not_touch_are_left_alone(head):
    gradients = np.broadcast_to(np.eye(3), (len(head.template.tets), 3, 3))
    motion = closed(head, -2.0)
    apart = ForwardSimulation(head)(gradients, motion)
    assert apart.lips.rounds == apart.lips.contacts == 0
    free = ForwardSimulation(head, ForwardSettings(collisions=False))(gradients, motion)
    np.testing.assert_allclose(apart.skin, free.skin, atol=1e-9)
    assert depth(head, head.skin) == 0.0 < GAP


def test_a_topology_without_lips(head):
    bare = replace(head.template, regions=Regions())
    with pytest.raises(InvalidInput, match=r"vertices\['upper_lip'\] for lip collisions"):
        ForwardSimulation(replace(head, template=bare))
    ForwardSimulation(replace(head, template=bare), ForwardSettings(collisions=False))
