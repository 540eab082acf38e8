"""The local step of projective dynamics in one pass over the tets.

Deformation gradient, projections, energies and right-hand side are computed for LANES tets at a time, component by
component, so that the compiler emits vector instructions and nothing of the size of the mesh is written between.
Most tets need no SVD: the closest rotation comes from Newton's iteration (Higham 1986) and the closest matrix of unit
determinant from sequential linearisation, both where ||F - R||_F <= 1/3. There the latter is provably global: as
det R = 1 the projection is at most 1/3 away, other stationary points are at least sigma_3 / 2 >= 1/3 away
(see `projections.unit_product`). All other tets, the inverted ones among them, take a one-sided Jacobi SVD.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from retarget.simulation.tetrahedra import RestShape
from retarget.types import FloatArray

CHUNKS = 8  # fixed, so that sums have one order whatever the number of threads
NEAR = 1.0 / 9.0  # ||F - R||^2 up to which the volume projection needs no SVD
FLAT = 1e-3  # determinant up to which Newton's iteration is not tried
POLAR_TOLERANCE = 1e-10  # squared last step; as convergence is quadratic, it bounds the error itself
VOLUME_TOLERANCE = 1e-14  # squared last step; convergence is linear, fast where ||F - R|| is small
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
    """

    def __init__(self, shape: RestShape, strain: FloatArray, volume: FloatArray) -> None:
        order = np.argsort(shape.tets.min(axis=1), kind="stable")  # neighbours in memory are neighbours in a chunk
        tets = shape.tets[order]
        self.size = len(shape.vertices)
        self._tets = np.ascontiguousarray(tets, dtype=np.uint32)
        self._inverse = np.ascontiguousarray(shape.inverse[order]).reshape(-1, 9)
        self._weights = np.stack([np.asarray(strain, dtype=np.float64), np.asarray(volume, dtype=np.float64)], axis=1)[
            order
        ]
        self._bounds = np.linspace(0, len(tets), CHUNKS + 1).astype(np.int64)
        chunks = [tets[a:b] for a, b in zip(self._bounds[:-1], self._bounds[1:], strict=True)]
        self._ranges = np.array([(c.min(), c.max() + 1) if len(c) else (0, 0) for c in chunks], dtype=np.int64)
        self._parts = np.empty((CHUNKS, self.size, 3))

    def __call__(self, vertices: FloatArray) -> LocalStep:
        """At vertices (n, 3) mm. Not re-entrant: calls share one buffer."""
        x = np.ascontiguousarray(vertices, dtype=np.float64)
        sums = np.zeros((CHUNKS, 3))
        _local_step(x, self._tets, self._inverse, self._weights, self._bounds, self._ranges, self._parts, sums)
        descent = np.empty((self.size, 3))
        _gather(self._parts, self._ranges, descent)
        strain, volume, inverted = sums.sum(axis=0)
        return LocalStep(float(strain), float(volume), descent, int(inverted))


def paper_energy(gradients: FloatArray, rotations: FloatArray, strain: FloatArray, volume: FloatArray) -> float:
    """Eqs (11) and (12) as printed: sum strain ||F - R||^2 + volume (det F - 1)^2, for F and R (t, 3, 3)."""
    squared = ((gradients - rotations) ** 2).sum(axis=(1, 2))
    return float(strain @ squared + volume @ (np.linalg.det(gradients) - 1) ** 2)


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
    signed_svd(f.copy().reshape(3, 3), u, sigma, v)
    unit_product(sigma, s)
    for j in range(3):
        for k in range(3):
            r[3 * j + k] = u[j, 0] * v[k, 0] + u[j, 1] * v[k, 1] + u[j, 2] * v[k, 2]
            d[3 * j + k] = s[0] * u[j, 0] * v[k, 0] + s[1] * u[j, 1] * v[k, 1] + s[2] * u[j, 2] * v[k, 2]


# In the lane loops a to i name the entries of one 3 x 3 matrix by rows and c0 to c8 those of its cofactor matrix.


@njit(cache=True, error_model="numpy", fastmath=VECTORISE)
def _determinants(m, det):  # type: ignore[no-untyped-def]
    for k in range(LANES):
        a, b, c, d, e, f, g, h, i = m[0, k], m[1, k], m[2, k], m[3, k], m[4, k], m[5, k], m[6, k], m[7, k], m[8, k]
        det[k] = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)


@njit(cache=True, error_model="numpy", fastmath=VECTORISE)
def _newton(r, step):  # type: ignore[no-untyped-def]
    """R <- (R + R^-T) / 2 (Higham 1986); the squared length of the step."""
    for k in range(LANES):
        a, b, c, d, e, f, g, h, i = r[0, k], r[1, k], r[2, k], r[3, k], r[4, k], r[5, k], r[6, k], r[7, k], r[8, k]
        c0, c1, c2 = e * i - f * h, f * g - d * i, d * h - e * g
        c3, c4, c5 = c * h - b * i, a * i - c * g, b * g - a * h
        c6, c7, c8 = b * f - c * e, c * d - a * f, a * e - b * d
        s = 0.5 / (a * c0 + b * c1 + c * c2)
        c0, c1, c2 = s * c0 - 0.5 * a, s * c1 - 0.5 * b, s * c2 - 0.5 * c
        c3, c4, c5 = s * c3 - 0.5 * d, s * c4 - 0.5 * e, s * c5 - 0.5 * f
        c6, c7, c8 = s * c6 - 0.5 * g, s * c7 - 0.5 * h, s * c8 - 0.5 * i
        r[0, k], r[1, k], r[2, k] = a + c0, b + c1, c + c2
        r[3, k], r[4, k], r[5, k] = d + c3, e + c4, f + c5
        r[6, k], r[7, k], r[8, k] = g + c6, h + c7, i + c8
        step[k] = c0 * c0 + c1 * c1 + c2 * c2 + c3 * c3 + c4 * c4 + c5 * c5 + c6 * c6 + c7 * c7 + c8 * c8


@njit(cache=True, error_model="numpy", fastmath=VECTORISE)
def _linearise(m, goal, step):  # type: ignore[no-untyped-def]
    """M <- the matrix closest to the goal with det M + cof M : (M' - M) = 1; the squared length of the step."""
    for k in range(LANES):
        a, b, c, d, e, f, g, h, i = m[0, k], m[1, k], m[2, k], m[3, k], m[4, k], m[5, k], m[6, k], m[7, k], m[8, k]
        c0, c1, c2 = e * i - f * h, f * g - d * i, d * h - e * g
        c3, c4, c5 = c * h - b * i, a * i - c * g, b * g - a * h
        c6, c7, c8 = b * f - c * e, c * d - a * f, a * e - b * d
        det = a * c0 + b * c1 + c * c2
        a, b, c = goal[0, k] - a, goal[1, k] - b, goal[2, k] - c
        d, e, f = goal[3, k] - d, goal[4, k] - e, goal[5, k] - f
        g, h, i = goal[6, k] - g, goal[7, k] - h, goal[8, k] - i
        along = c0 * a + c1 * b + c2 * c + c3 * d + c4 * e + c5 * f + c6 * g + c7 * h + c8 * i
        norm = c0 * c0 + c1 * c1 + c2 * c2 + c3 * c3 + c4 * c4 + c5 * c5 + c6 * c6 + c7 * c7 + c8 * c8
        s = (1 - det - along) / norm
        a, b, c = a + s * c0, b + s * c1, c + s * c2
        d, e, f = d + s * c3, e + s * c4, f + s * c5
        g, h, i = g + s * c6, h + s * c7, i + s * c8
        m[0, k] += a
        m[1, k] += b
        m[2, k] += c
        m[3, k] += d
        m[4, k] += e
        m[5, k] += f
        m[6, k] += g
        m[7, k] += h
        m[8, k] += i
        step[k] = a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + i * i


@njit(cache=True, fastmath=VECTORISE)
def _squared_distance(p, q, squared):  # type: ignore[no-untyped-def]
    squared[:] = 0.0
    for j in range(9):
        for k in range(LANES):
            squared[k] += (p[j, k] - q[j, k]) ** 2


@njit(cache=True)
def project(f, r, d, det):  # type: ignore[no-untyped-def]
    """Closest rotations r and closest matrices d of unit determinant of the gradients f, all (9, LANES); and det f."""
    step, last, far = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    _determinants(f, det)
    for j in range(9):
        for k in range(LANES):
            r[j, k] = f[j, k] if det[k] > FLAT else (1.0 if j % 4 == 0 else 0.0)
    for _ in range(9):
        _newton(r, step)
        if step.max() < POLAR_TOLERANCE:
            break
    _squared_distance(f, r, far)
    for k in range(LANES):
        if not (det[k] > FLAT and step[k] < POLAR_TOLERANCE):
            far[k] = np.inf
    goal = np.empty((9, LANES))
    for j in range(9):
        for k in range(LANES):
            goal[j, k] = f[j, k] if far[k] <= NEAR else r[j, k]
            d[j, k] = r[j, k]
    for _ in range(20):
        _linearise(d, goal, last)
        if last.max() < VOLUME_TOLERANCE:
            break
    for k in range(LANES):
        if not (far[k] <= NEAR and last[k] < VOLUME_TOLERANCE):
            _project_by_svd(f[:, k], r[:, k], d[:, k])


@njit(cache=True)
def _load(x, tets, inverse, first, count, f):  # type: ignore[no-untyped-def]
    """Deformation gradients of the tets from `first` on; lanes beyond `count` are at rest."""
    for k in range(count):
        t = first + k
        v0, v1, v2, v3 = tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3]
        for j in range(3):
            a, b, c = x[v1, j] - x[v0, j], x[v2, j] - x[v0, j], x[v3, j] - x[v0, j]
            f[3 * j, k] = a * inverse[t, 0] + b * inverse[t, 3] + c * inverse[t, 6]
            f[3 * j + 1, k] = a * inverse[t, 1] + b * inverse[t, 4] + c * inverse[t, 7]
            f[3 * j + 2, k] = a * inverse[t, 2] + b * inverse[t, 5] + c * inverse[t, 8]
    for k in range(count, LANES):
        for j in range(9):
            f[j, k] = 1.0 if j % 4 == 0 else 0.0


@njit(cache=True)
def _scatter(tets, inverse, first, count, p, descent):  # type: ignore[no-untyped-def]
    """Add G^T p to the corners of the tets."""
    for k in range(count):
        t = first + k
        v0, v1, v2, v3 = tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3]
        for j in range(3):
            u, v, w = p[3 * j, k], p[3 * j + 1, k], p[3 * j + 2, k]
            a = u * inverse[t, 0] + v * inverse[t, 1] + w * inverse[t, 2]
            b = u * inverse[t, 3] + v * inverse[t, 4] + w * inverse[t, 5]
            c = u * inverse[t, 6] + v * inverse[t, 7] + w * inverse[t, 8]
            descent[v0, j] -= a + b + c
            descent[v1, j] += a
            descent[v2, j] += b
            descent[v3, j] += c


@njit(cache=True, parallel=True)
def _local_step(x, tets, inverse, weights, bounds, ranges, parts, sums):  # type: ignore[no-untyped-def]
    for chunk in prange(len(bounds) - 1):
        _chunk(x, tets, inverse, weights, bounds[chunk], bounds[chunk + 1], ranges[chunk], parts[chunk], sums[chunk])


@njit(cache=True)
def _chunk(x, tets, inverse, weights, begin, end, touched, descent, sums):  # type: ignore[no-untyped-def]
    descent[touched[0] : touched[1]] = 0.0
    f, r, d = np.empty((9, LANES)), np.empty((9, LANES)), np.empty((9, LANES))
    det, strain, volume = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    total_strain, total_volume, inverted = 0.0, 0.0, 0
    for first in range(begin, end, LANES):
        count = min(LANES, end - first)
        _load(x, tets, inverse, first, count, f)
        project(f, r, d, det)
        _squared_distance(f, r, strain)
        _squared_distance(f, d, volume)
        for k in range(count):
            total_strain += weights[first + k, 0] * strain[k]  # eq. (11), first term
            total_volume += weights[first + k, 1] * volume[k]  # eqs (11), (12): distance form of the volume term
            inverted += not det[k] > 0
        for j in range(9):
            for k in range(count):
                w, q = weights[first + k, 0], weights[first + k, 1]
                r[j, k] = w * (r[j, k] - f[j, k]) + q * (d[j, k] - f[j, k])
        _scatter(tets, inverse, first, count, r, descent)
    sums[0], sums[1], sums[2] = total_strain, total_volume, inverted


@njit(cache=True, parallel=True)
def _gather(parts, ranges, total):  # type: ignore[no-untyped-def]
    for v in prange(len(total)):
        x, y, z = 0.0, 0.0, 0.0
        for chunk in range(len(ranges)):
            if ranges[chunk, 0] <= v < ranges[chunk, 1]:
                x += parts[chunk, v, 0]
                y += parts[chunk, v, 1]
                z += parts[chunk, v, 2]
        total[v, 0], total[v, 1], total[v, 2] = x, y, z
