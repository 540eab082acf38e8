"""The local step of projective dynamics in one pass over the tets.

Deformation gradient, projections, energies and right-hand side are computed for LANES tets at a time, component by
component, so that the compiler emits vector instructions and nothing of the size of the mesh is written between.
Most tets need no SVD: the closest rotation comes from Newton's iteration (Higham 1986) and a stationary matrix D of
unit determinant from sequential linearisation. D has the singular vectors of F, and d_i (d_i - sigma_i) = mu
(see `projections.unit_product`). All d_i are positive if R^T D and its cofactor matrix have positive traces; then D
is the closest one if det F <= 1, where mu >= 0 leaves no other choice, or if ||F - D|| <= sigma_3 / 2, as any other is
farther away than that. All other tets, the inverted ones among them, take a one-sided Jacobi SVD.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from retarget.simulation.chunks import CHUNKS, gather
from retarget.simulation.tetrahedra import RestShape
from retarget.types import FloatArray

FLAT = 1e-3  # determinant up to which Newton's iteration is not tried
# In double and in single precision, squared last step.
POLAR_TOLERANCE = (1e-10, 1e-7)  # as convergence is quadratic, it bounds the error itself
VOLUME_TOLERANCE = (1e-14, 1e-10)  # convergence is linear, fast where ||F - R|| is small
LANES = 64
VECTORISE = {"contract", "reassoc", "nsz", "arcp"}  # NaN and infinity keep their meaning


@dataclass(frozen=True)
class LocalStep:
    """Sums over all tets at one state."""

    strain: float  # sum w_strain min_R ||F - R||^2
    volume: float  # sum w_volume min_D ||F - D||^2
    descent: FloatArray  # (n, 3): sum G^T (w_strain (R - F) + w_volume (D - F)), minus half the energy's gradient
    inverted: int  # tets with det F <= 0

    @property
    def energy(self) -> float:
        return self.strain + self.volume


class TetrahedralEnergy:
    """E(x) = sum_t strain_t min_R ||F_t - R||^2 + volume_t min_{det D = 1} ||F_t - D||^2, with its local step.

    The weights (t,) >= 0 contain the volumes. The distance in the second term is what projective dynamics minimises
    in place of (det F - 1)^2.  # differs from the paper: eqs (11) and (12) are reported by `paper_energy` instead
    In single precision the projections are good to 1e-6; edges and sums are double in either case.
    """

    def __init__(self, shape: RestShape, strain: FloatArray, volume: FloatArray, single: bool = False) -> None:
        order = np.argsort(shape.tets.min(axis=1), kind="stable")  # neighbours in memory are neighbours in a chunk
        self.size, self._count = len(shape.vertices), len(order)
        order = np.concatenate([order, np.repeat(order[-1:], -len(order) % LANES)])  # the last tile repeats a tet
        weights = np.stack([strain, volume], axis=1)[order]
        weights[self._count :] = 0
        real = np.float32 if single else np.float64
        tiles = len(order) // LANES
        self._tets = np.ascontiguousarray(shape.tets[order], dtype=np.uint32).reshape(tiles, LANES, 4)
        self._inverse = np.ascontiguousarray(_lanes(shape.inverse[order].reshape(-1, 9)), dtype=real)
        self._weights = np.ascontiguousarray(_lanes(weights), dtype=real)
        self._bounds = np.linspace(0, tiles, CHUNKS + 1).astype(np.int64)
        chunks = [self._tets[a:b] for a, b in zip(self._bounds[:-1], self._bounds[1:], strict=True)]
        self._ranges = np.array([(c.min(), c.max() + 1) if len(c) else (0, 0) for c in chunks], dtype=np.int64)
        self._parts = np.empty((CHUNKS, self.size, 3))

    def __call__(self, vertices: FloatArray) -> LocalStep:
        """At vertices (n, 3) mm. Not re-entrant: calls share one buffer."""
        x = np.ascontiguousarray(vertices, dtype=np.float64)
        sums = np.zeros((CHUNKS, 3))
        _local_step(
            x, self._tets, self._inverse, self._weights, self._count, self._bounds, self._ranges, self._parts, sums
        )
        descent = np.empty((self.size, 3))
        gather(self._parts, self._ranges, descent)
        strain, volume, inverted = sums.sum(axis=0)
        return LocalStep(float(strain), float(volume), descent, int(inverted))


def _lanes(values: FloatArray) -> FloatArray:
    """(tiles, c, LANES) from values (tiles * LANES, c)."""
    return np.swapaxes(values.reshape(-1, LANES, values.shape[1]), 1, 2)


def paper_energy(gradients: FloatArray, rotations: FloatArray, strain: FloatArray, volume: FloatArray) -> float:
    """Eqs (11) and (12) as printed: sum strain ||F - R||^2 + volume (det F - 1)^2, for F and R (t, 3, 3)."""
    squared = ((gradients - rotations) ** 2).sum(axis=(1, 2))
    return float(strain @ squared + volume @ (np.linalg.det(gradients) - 1) ** 2)  # eqs (11), (12)


@njit(cache=True)
def signed_svd(matrix: FloatArray, u: FloatArray, sigma: FloatArray, v: FloatArray) -> None:
    """U, sigma, V of matrix (3, 3), written into the last arguments; convention of `projections.signed_svd`.

    One-sided Jacobi: rotations of the columns of B = F V until they are orthogonal.
    """
    b = matrix.copy()
    v[:] = np.eye(3)
    for _ in range(30):
        rotated = False
        for p in range(2):
            for q in range(p + 1, 3):
                pp = b[0, p] ** 2 + b[1, p] ** 2 + b[2, p] ** 2
                qq = b[0, q] ** 2 + b[1, q] ** 2 + b[2, q] ** 2
                pq = b[0, p] * b[0, q] + b[1, p] * b[1, q] + b[2, p] * b[2, q]
                if pq * pq <= 1e-30 * pp * qq:
                    continue
                rotated = True
                zeta = (qq - pp) / (2 * pq)
                t = (1.0 if zeta >= 0 else -1.0) / (abs(zeta) + np.sqrt(1 + zeta * zeta))
                c = 1 / np.sqrt(1 + t * t)
                s = c * t
                for k in range(3):
                    b[k, p], b[k, q] = c * b[k, p] - s * b[k, q], s * b[k, p] + c * b[k, q]
                    v[k, p], v[k, q] = c * v[k, p] - s * v[k, q], s * v[k, p] + c * v[k, q]
        if not rotated:
            break
    for k in range(3):
        sigma[k] = np.sqrt(b[0, k] ** 2 + b[1, k] ** 2 + b[2, k] ** 2)
    for p in (0, 1, 0):  # sort three columns; a swap with one sign keeps V a rotation
        if sigma[p] < sigma[p + 1]:
            sigma[p], sigma[p + 1] = sigma[p + 1], sigma[p]
            for k in range(3):
                b[k, p], b[k, p + 1] = b[k, p + 1], -b[k, p]
                v[k, p], v[k, p + 1] = v[k, p + 1], -v[k, p]
    u[:] = np.eye(3)
    if sigma[0] > 0:
        u[:, 0] = b[:, 0] / sigma[0]
        if sigma[1] > 1e-14 * sigma[0]:
            u[:, 1] = b[:, 1] / sigma[1]
        else:  # any direction normal to the first
            axis = np.argmin(np.abs(u[:, 0]))
            u[:, 1] = -u[axis, 0] * u[:, 0]
            u[axis, 1] += 1
            u[:, 1] /= np.sqrt((u[:, 1] ** 2).sum())
        u[0, 2] = u[1, 0] * u[2, 1] - u[2, 0] * u[1, 1]
        u[1, 2] = u[2, 0] * u[0, 1] - u[0, 0] * u[2, 1]
        u[2, 2] = u[0, 0] * u[1, 1] - u[1, 0] * u[0, 1]
        sigma[2] = u[0, 2] * b[0, 2] + u[1, 2] * b[1, 2] + u[2, 2] * b[2, 2]


@njit(cache=True)
def _plus(sigma: float, mu: float) -> float:
    root = np.sqrt(max(sigma * sigma + 4 * mu, 0.0))
    return 0.5 * (sigma + root) if sigma >= 0 else 2 * mu / (root - sigma)


@njit(cache=True)
def unit_product(sigma: FloatArray, d: FloatArray) -> None:
    """The d (3,) > 0 of unit product closest to sigma; the search of `projections.unit_product`."""
    low, high = 0.0, 1 + max(abs(sigma[0]), abs(sigma[2]))
    if sigma[0] * sigma[1] * sigma[2] >= 1:
        low, high = -0.25 * sigma[2] ** 2, 0.0
    mu = 0.0
    for _ in range(60):  # Newton on the logarithm of the product, kept in a bracket by bisection
        log, slope = 0.0, 0.0
        for k in range(3):
            d[k] = _plus(sigma[k], mu)
            root = 2 * d[k] - sigma[k]
            if d[k] <= 0 or root <= 0:
                log, slope = -np.inf if mu <= low or d[k] <= 0 else np.inf, 1.0
                break
            log += np.log(d[k])
            slope += 1 / (d[k] * root)
        if log < 0:
            low = mu
        else:
            high = mu
        if abs(log) < 1e-14:
            break
        mu -= log / slope
        if not low < mu < high:
            mu = 0.5 * (low + high)
    nearest, product = 0.0, 1.0
    for k in range(3):
        d[k] = _plus(sigma[k], mu)
        nearest += (d[k] - sigma[k]) ** 2
        product *= d[k]
    if abs(product - 1) > 1e-6:
        nearest = np.inf
    if sigma[2] <= 0 or nearest <= 0.25 * sigma[2] ** 2:
        return
    before = 0.0
    for step in range(1, 257):
        low, high = 0.5 * sigma[2] * (step - 1) / 256, 0.5 * sigma[2] * step / 256
        mu = high * (high - sigma[2])
        after = _plus(sigma[0], mu) * _plus(sigma[1], mu) * high
        if before < 1 <= after:
            for _ in range(60):
                third = 0.5 * (low + high)
                mu = third * (third - sigma[2])
                if _plus(sigma[0], mu) * _plus(sigma[1], mu) * third < 1:
                    low = third
                else:
                    high = third
            third = 0.5 * (low + high)
            mu = third * (third - sigma[2])
            first, second = _plus(sigma[0], mu), _plus(sigma[1], mu)
            distance = (first - sigma[0]) ** 2 + (second - sigma[1]) ** 2 + (third - sigma[2]) ** 2
            if distance < nearest:
                nearest = distance
                d[0], d[1], d[2] = first, second, third
        before = after


@njit(cache=True)
def _project_by_svd(f, r, d):  # type: ignore[no-untyped-def]
    """Both projections of one F (9,), written into r and d (9,)."""
    u, v, sigma, s = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    signed_svd(f.astype(np.float64).reshape(3, 3), u, sigma, v)
    unit_product(sigma, s)
    for j in range(3):
        for k in range(3):
            r[3 * j + k] = u[j, 0] * v[k, 0] + u[j, 1] * v[k, 1] + u[j, 2] * v[k, 2]
            d[3 * j + k] = s[0] * u[j, 0] * v[k, 0] + s[1] * u[j, 1] * v[k, 1] + s[2] * u[j, 2] * v[k, 2]


# In the lane loops a to i name the entries of one 3 x 3 matrix by rows and c0 to c8 those of its cofactor matrix.
# They serve single and double precision alike: constants take the type of the arrays. Flat arrays with rows at offsets
# known to the compiler are what it vectorises; of rows with strides it would have to prove that they do not overlap.
A, B, C, D, E, F, G, H, J = range(0, 9 * LANES, LANES)


@njit(cache=True, error_model="numpy", fastmath=VECTORISE)
def _determinants(m, det):  # type: ignore[no-untyped-def]
    m = m.reshape(-1)
    for k in range(LANES):
        a, b, c, d, e, f, g, h, i = (
            m[A + k],
            m[B + k],
            m[C + k],
            m[D + k],
            m[E + k],
            m[F + k],
            m[G + k],
            m[H + k],
            m[J + k],
        )
        det[k] = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)


@njit(cache=True, error_model="numpy", fastmath=VECTORISE)
def _newton(r, step):  # type: ignore[no-untyped-def]
    """R <- (R + R^-T) / 2 (Higham 1986); the squared length of the step."""
    r, half = r.reshape(-1), r.dtype.type(0.5)
    for k in range(LANES):
        a, b, c, d, e, f, g, h, i = (
            r[A + k],
            r[B + k],
            r[C + k],
            r[D + k],
            r[E + k],
            r[F + k],
            r[G + k],
            r[H + k],
            r[J + k],
        )
        c0, c1, c2 = e * i - f * h, f * g - d * i, d * h - e * g
        c3, c4, c5 = c * h - b * i, a * i - c * g, b * g - a * h
        c6, c7, c8 = b * f - c * e, c * d - a * f, a * e - b * d
        s = half / (a * c0 + b * c1 + c * c2)
        c0, c1, c2 = s * c0 - half * a, s * c1 - half * b, s * c2 - half * c
        c3, c4, c5 = s * c3 - half * d, s * c4 - half * e, s * c5 - half * f
        c6, c7, c8 = s * c6 - half * g, s * c7 - half * h, s * c8 - half * i
        r[A + k], r[B + k], r[C + k] = a + c0, b + c1, c + c2
        r[D + k], r[E + k], r[F + k] = d + c3, e + c4, f + c5
        r[G + k], r[H + k], r[J + k] = g + c6, h + c7, i + c8
        step[k] = c0 * c0 + c1 * c1 + c2 * c2 + c3 * c3 + c4 * c4 + c5 * c5 + c6 * c6 + c7 * c7 + c8 * c8


@njit(cache=True, error_model="numpy", fastmath=VECTORISE)
def _linearise(m, goal, step):  # type: ignore[no-untyped-def]
    """M <- the matrix closest to the goal with det M + cof M : (M' - M) = 1; the squared length of the step."""
    m, goal, one = m.reshape(-1), goal.reshape(-1), m.dtype.type(1)
    for k in range(LANES):
        a, b, c, d, e, f, g, h, i = (
            m[A + k],
            m[B + k],
            m[C + k],
            m[D + k],
            m[E + k],
            m[F + k],
            m[G + k],
            m[H + k],
            m[J + k],
        )
        c0, c1, c2 = e * i - f * h, f * g - d * i, d * h - e * g
        c3, c4, c5 = c * h - b * i, a * i - c * g, b * g - a * h
        c6, c7, c8 = b * f - c * e, c * d - a * f, a * e - b * d
        det = a * c0 + b * c1 + c * c2
        u, v, w = goal[A + k] - a, goal[B + k] - b, goal[C + k] - c
        o, p, q = goal[D + k] - d, goal[E + k] - e, goal[F + k] - f
        x, y, z = goal[G + k] - g, goal[H + k] - h, goal[J + k] - i
        along = c0 * u + c1 * v + c2 * w + c3 * o + c4 * p + c5 * q + c6 * x + c7 * y + c8 * z
        norm = c0 * c0 + c1 * c1 + c2 * c2 + c3 * c3 + c4 * c4 + c5 * c5 + c6 * c6 + c7 * c7 + c8 * c8
        s = (one - det - along) / norm
        u, v, w = u + s * c0, v + s * c1, w + s * c2
        o, p, q = o + s * c3, p + s * c4, q + s * c5
        x, y, z = x + s * c6, y + s * c7, z + s * c8
        m[A + k], m[B + k], m[C + k] = a + u, b + v, c + w
        m[D + k], m[E + k], m[F + k] = d + o, e + p, f + q
        m[G + k], m[H + k], m[J + k] = g + x, h + y, i + z
        step[k] = u * u + v * v + w * w + o * o + p * p + q * q + x * x + y * y + z * z


@njit(cache=True)
def _set_identity(m, k):  # type: ignore[no-untyped-def]
    for j in range(9):
        m[j, k] = 1 if j % 4 == 0 else 0


@njit(cache=True)
def _all_below(values, bound):  # type: ignore[no-untyped-def]
    """False for NaN as well."""
    above = 0
    for k in range(LANES):
        above += not values[k] < bound
    return above == 0


@njit(cache=True, error_model="numpy", fastmath=VECTORISE)
def _unit_scale(f, det, r, d):  # type: ignore[no-untyped-def]
    """R and D <- F / cbrt(det F), roughly: what both iterations start from."""
    f, r, d = f.reshape(-1), r.reshape(-1), d.reshape(-1)
    two, three, four = det.dtype.type(2), det.dtype.type(3), det.dtype.type(4)
    for k in range(LANES):
        s = three / (two + det[k])
        for _ in range(2):  # Newton for s^-3 = det
            s = s * (four - det[k] * s * s * s) / three
        for row in range(0, 9 * LANES, LANES):
            r[row + k] = s * f[row + k]
            d[row + k] = s * f[row + k]


@njit(cache=True, error_model="numpy", fastmath=VECTORISE)
def _judge(f, r, d, det, far, near, global_minimum):  # type: ignore[no-untyped-def]
    """||F - R||^2, ||F - D||^2, and a number that is positive where a stationary D is known to be the closest."""
    f, r, d = f.reshape(-1), r.reshape(-1), d.reshape(-1)
    quarter, half, zero, one = det.dtype.type(0.25), det.dtype.type(0.5), det.dtype.type(0), det.dtype.type(1)
    for k in range(LANES):
        length, from_r, from_d, trace = zero, zero, zero, zero
        for row in range(0, 9 * LANES, LANES):
            x, y, z = f[row + k], r[row + k], d[row + k]
            length += x * x
            from_r += (x - y) * (x - y)
            from_d += (x - z) * (x - z)
            trace += y * z
        a, b, c, o, e, p = d[A + k], d[B + k], d[C + k], d[D + k], d[E + k], d[F + k]
        g, h, i = d[G + k], d[H + k], d[J + k]
        second = r[A + k] * (e * i - p * h) + r[B + k] * (p * g - o * i) + r[C + k] * (o * h - e * g)
        second += r[D + k] * (c * h - b * i) + r[E + k] * (a * i - c * g) + r[F + k] * (b * g - a * h)
        second += r[G + k] * (b * p - c * e) + r[H + k] * (c * o - a * p) + r[J + k] * (a * e - b * o)
        third = max(one - np.sqrt(from_r), det[k] / (half * length))  # sigma_3 is no less
        far[k], near[k] = from_r, from_d
        alone = max(one - det[k], quarter * third * third - from_d)
        global_minimum[k] = min(alone, min(trace, second))


@njit(cache=True)
def project(f, r, d, det, far, near):  # type: ignore[no-untyped-def]
    """Closest rotations r and closest matrices d of unit determinant of the gradients f, all (9, LANES).

    Also, each (LANES,), the determinants of f and its squared distances from r and d.
    """
    single = int(f.itemsize == 4)
    polar_tolerance, volume_tolerance = (
        det.dtype.type(POLAR_TOLERANCE[single]),
        det.dtype.type(VOLUME_TOLERANCE[single]),
    )
    flat = det.dtype.type(FLAT)
    step, last, known = np.empty_like(det), np.empty_like(det), np.empty_like(det)
    _determinants(f, det)
    _unit_scale(f, det, r, d)
    for k in range(LANES):
        if not det[k] > flat:
            _set_identity(r, k)
            _set_identity(d, k)
    for _ in range(9):
        _newton(r, step)
        if _all_below(step, polar_tolerance):
            break
    for _ in range(20):
        _linearise(d, f, last)
        if _all_below(last, volume_tolerance):
            break
    _judge(f, r, d, det, far, near, known)
    for k in range(LANES):
        if not (det[k] > flat and step[k] < polar_tolerance and last[k] < volume_tolerance and known[k] > 0):
            _project_by_svd(f[:, k], r[:, k], d[:, k])
            far[k], near[k] = 0, 0
            for j in range(9):
                far[k] += (f[j, k] - r[j, k]) ** 2
                near[k] += (f[j, k] - d[j, k]) ** 2


@njit(cache=True)
def _load(x, tets, edges):  # type: ignore[no-untyped-def]
    """Edges [v1 - v0, v2 - v0, v3 - v0] of one tile of tets (LANES, 4), rounded after the subtraction."""
    for k in range(LANES):
        v0, v1, v2, v3 = tets[k, 0], tets[k, 1], tets[k, 2], tets[k, 3]
        for j in range(3):
            origin = x[v0, j]
            edges[3 * j, k], edges[3 * j + 1, k], edges[3 * j + 2, k] = (
                x[v1, j] - origin,
                x[v2, j] - origin,
                x[v3, j] - origin,
            )


@njit(cache=True, fastmath=VECTORISE)
def _multiply(p, m, product):  # type: ignore[no-untyped-def]
    """P M, lane by lane."""
    p, m, product = p.reshape(-1), m.reshape(-1), product.reshape(-1)
    for row in (A, D, G):
        for k in range(LANES):
            a, b, c = p[row + k], p[row + LANES + k], p[row + 2 * LANES + k]
            product[row + k] = a * m[A + k] + b * m[D + k] + c * m[G + k]
            product[row + LANES + k] = a * m[B + k] + b * m[E + k] + c * m[H + k]
            product[row + 2 * LANES + k] = a * m[C + k] + b * m[F + k] + c * m[J + k]


@njit(cache=True, fastmath=VECTORISE)
def _multiply_transposed(p, m, product):  # type: ignore[no-untyped-def]
    """P M^T, lane by lane."""
    p, m, product = p.reshape(-1), m.reshape(-1), product.reshape(-1)
    for row in (A, D, G):
        for k in range(LANES):
            a, b, c = p[row + k], p[row + LANES + k], p[row + 2 * LANES + k]
            product[row + k] = a * m[A + k] + b * m[B + k] + c * m[C + k]
            product[row + LANES + k] = a * m[D + k] + b * m[E + k] + c * m[F + k]
            product[row + 2 * LANES + k] = a * m[G + k] + b * m[H + k] + c * m[J + k]


@njit(cache=True)
def _scatter(forces, tets, descent):  # type: ignore[no-untyped-def]
    """Add forces on v1, v2, v3 (in columns), and their reaction on v0."""
    for k in range(LANES):
        v0, v1, v2, v3 = tets[k, 0], tets[k, 1], tets[k, 2], tets[k, 3]
        for j in range(3):
            a, b, c = forces[3 * j, k], forces[3 * j + 1, k], forces[3 * j + 2, k]
            descent[v0, j] -= a + b + c
            descent[v1, j] += a
            descent[v2, j] += b
            descent[v3, j] += c


@njit(cache=True, parallel=True)
def _local_step(x, tets, inverse, weights, count, bounds, ranges, parts, sums):  # type: ignore[no-untyped-def]
    for chunk in prange(len(bounds) - 1):
        _chunk(
            x, tets, inverse, weights, count, bounds[chunk], bounds[chunk + 1], ranges[chunk], parts[chunk], sums[chunk]
        )


@njit(cache=True, fastmath=VECTORISE)
def _pull(f, r, d, weights):  # type: ignore[no-untyped-def]
    """R <- strain (R - F) + volume (D - F)."""
    f, r, d, weights = f.reshape(-1), r.reshape(-1), d.reshape(-1), weights.reshape(-1)
    for row in range(0, 9 * LANES, LANES):
        for k in range(LANES):
            i = row + k
            r[i] = weights[k] * (r[i] - f[i]) + weights[LANES + k] * (d[i] - f[i])


@njit(cache=True)
def _chunk(x, tets, inverse, weights, count, begin, end, touched, descent, sums):  # type: ignore[no-untyped-def]
    descent[touched[0] : touched[1]] = 0.0
    f, r, d = np.empty_like(inverse[0]), np.empty_like(inverse[0]), np.empty_like(inverse[0])
    det, strain, volume = np.empty_like(f[0]), np.empty_like(f[0]), np.empty_like(f[0])
    total_strain, total_volume, inverted = 0.0, 0.0, 0
    for tile in range(begin, end):
        _load(x, tets[tile], d)
        _multiply(d, inverse[tile], f)
        project(f, r, d, det, strain, volume)
        for k in range(min(LANES, count - tile * LANES)):
            total_strain += weights[tile, 0, k] * strain[k]  # eq. (11), first term
            total_volume += weights[tile, 1, k] * volume[k]  # eqs (11), (12): distance form of the volume term
            inverted += not det[k] > 0
        _pull(f, r, d, weights[tile])
        _multiply_transposed(r, inverse[tile], f)
        _scatter(f, tets[tile], descent)
    sums[0], sums[1], sums[2] = total_strain, total_volume, inverted
