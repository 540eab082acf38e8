"""The local step of projective dynamics in one pass over the tets.

Deformation gradient, projections, energies and right-hand side are computed tet by tet without intermediate arrays.
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
PROJECTION_TOLERANCE = 1e-7  # last step of the iterations, Frobenius norm


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


Matrix = tuple[float, float, float, float, float, float, float, float, float]  # 3 x 3 by rows


@njit(cache=True)
def _cofactor(a, b, c, d, e, f, g, h, i):  # type: ignore[no-untyped-def]
    return (e * i - f * h, f * g - d * i, d * h - e * g,
            c * h - b * i, a * i - c * g, b * g - a * h,
            b * f - c * e, c * d - a * f, a * e - b * d)  # fmt: skip


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
def _project_by_svd(a, b, c, d, e, f, g, h, i):  # type: ignore[no-untyped-def]
    matrix = np.array([[a, b, c], [d, e, f], [g, h, i]])
    u, v, sigma, s = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    signed_svd(matrix, u, sigma, v)
    unit_product(sigma, s)
    r, m = np.empty(9), np.empty(9)
    for j in range(3):
        for k in range(3):
            r[3 * j + k] = u[j, 0] * v[k, 0] + u[j, 1] * v[k, 1] + u[j, 2] * v[k, 2]
            m[3 * j + k] = s[0] * u[j, 0] * v[k, 0] + s[1] * u[j, 1] * v[k, 1] + s[2] * u[j, 2] * v[k, 2]
    return (
        (r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8]),
        (m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]),
    )


@njit(cache=True)
def _polar(f0, f1, f2, f3, f4, f5, f6, f7, f8):  # type: ignore[no-untyped-def]
    """Rotation next to F, det F > 0, by Newton's iteration; and the last squared step."""
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = f0, f1, f2, f3, f4, f5, f6, f7, f8
    step = 1.0
    for _ in range(12):
        c0, c1, c2, c3, c4, c5, c6, c7, c8 = _cofactor(r0, r1, r2, r3, r4, r5, r6, r7, r8)
        s = 0.5 / (r0 * c0 + r1 * c1 + r2 * c2)
        c0, c1, c2 = s * c0 - 0.5 * r0, s * c1 - 0.5 * r1, s * c2 - 0.5 * r2
        c3, c4, c5 = s * c3 - 0.5 * r3, s * c4 - 0.5 * r4, s * c5 - 0.5 * r5
        c6, c7, c8 = s * c6 - 0.5 * r6, s * c7 - 0.5 * r7, s * c8 - 0.5 * r8
        r0, r1, r2, r3, r4, r5, r6, r7, r8 = (
            r0 + c0, r1 + c1, r2 + c2, r3 + c3, r4 + c4, r5 + c5, r6 + c6, r7 + c7, r8 + c8)  # fmt: skip
        step = c0 * c0 + c1 * c1 + c2 * c2 + c3 * c3 + c4 * c4 + c5 * c5 + c6 * c6 + c7 * c7 + c8 * c8
        if step < 1e-10:  # quadratic convergence: the error is half of this
            break
    return (r0, r1, r2, r3, r4, r5, r6, r7, r8), step


@njit(cache=True)
def _squared(p, q):  # type: ignore[no-untyped-def]
    return (
        (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2 + (p[3] - q[3]) ** 2 + (p[4] - q[4]) ** 2
        + (p[5] - q[5]) ** 2 + (p[6] - q[6]) ** 2 + (p[7] - q[7]) ** 2 + (p[8] - q[8]) ** 2)  # fmt: skip


@njit(cache=True)
def _unit_determinant(f, r):  # type: ignore[no-untyped-def]
    """Matrix of unit determinant next to F by sequential linearisation from the rotation; last squared step."""
    d = r
    step = 1.0
    for _ in range(20):
        c = _cofactor(d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7], d[8])
        det = d[0] * c[0] + d[1] * c[1] + d[2] * c[2]
        along = (
            c[0] * (f[0] - d[0]) + c[1] * (f[1] - d[1]) + c[2] * (f[2] - d[2]) + c[3] * (f[3] - d[3])
            + c[4] * (f[4] - d[4]) + c[5] * (f[5] - d[5]) + c[6] * (f[6] - d[6]) + c[7] * (f[7] - d[7])
            + c[8] * (f[8] - d[8]))  # fmt: skip
        norm = (
            c[0] * c[0] + c[1] * c[1] + c[2] * c[2] + c[3] * c[3] + c[4] * c[4] + c[5] * c[5] + c[6] * c[6]
            + c[7] * c[7] + c[8] * c[8])  # fmt: skip
        s = (1 - det - along) / norm
        n = (
            f[0] + s * c[0], f[1] + s * c[1], f[2] + s * c[2], f[3] + s * c[3], f[4] + s * c[4], f[5] + s * c[5],
            f[6] + s * c[6], f[7] + s * c[7], f[8] + s * c[8])  # fmt: skip
        step = _squared(n, d)
        d = n
        if step < PROJECTION_TOLERANCE**2:
            break
    return d, step


@njit(cache=True)
def project(f, with_volume):  # type: ignore[no-untyped-def]
    """Closest rotation and closest matrix of unit determinant of one F, given and returned as 9 numbers by rows."""
    c = _cofactor(f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8])
    det = f[0] * c[0] + f[1] * c[1] + f[2] * c[2]
    if det > 1e-3:
        r, step = _polar(f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8])
        if step < 1e-10:
            if not with_volume:
                return det, r, f
            if _squared(f, r) <= NEAR:
                d, step = _unit_determinant(f, r)
                if step < PROJECTION_TOLERANCE**2:
                    return det, r, d
    r, d = _project_by_svd(f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8])
    return det, r, d


@njit(cache=True, parallel=True)
def _local_step(x, tets, inverse, weights, bounds, ranges, parts, sums):  # type: ignore[no-untyped-def]
    for chunk in prange(len(bounds) - 1):
        descent = parts[chunk]
        descent[ranges[chunk, 0] : ranges[chunk, 1]] = 0.0
        strain, volume, inverted = 0.0, 0.0, 0
        for t in range(bounds[chunk], bounds[chunk + 1]):
            v0, v1, v2, v3 = tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3]
            x0, y0, z0 = x[v0, 0], x[v0, 1], x[v0, 2]
            ax, ay, az = x[v1, 0] - x0, x[v1, 1] - y0, x[v1, 2] - z0
            bx, by, bz = x[v2, 0] - x0, x[v2, 1] - y0, x[v2, 2] - z0
            cx, cy, cz = x[v3, 0] - x0, x[v3, 1] - y0, x[v3, 2] - z0
            i0, i1, i2 = inverse[t, 0], inverse[t, 1], inverse[t, 2]
            i3, i4, i5 = inverse[t, 3], inverse[t, 4], inverse[t, 5]
            i6, i7, i8 = inverse[t, 6], inverse[t, 7], inverse[t, 8]
            f = (
                ax * i0 + bx * i3 + cx * i6, ax * i1 + bx * i4 + cx * i7, ax * i2 + bx * i5 + cx * i8,
                ay * i0 + by * i3 + cy * i6, ay * i1 + by * i4 + cy * i7, ay * i2 + by * i5 + cy * i8,
                az * i0 + bz * i3 + cz * i6, az * i1 + bz * i4 + cz * i7, az * i2 + bz * i5 + cz * i8)  # fmt: skip
            w, q = weights[t, 0], weights[t, 1]
            det, r, d = project(f, q > 0)
            inverted += not det > 0
            strain += w * _squared(f, r)  # eq. (11), first term
            volume += q * _squared(f, d)  # eqs (11), (12): distance form of the volume term
            p0, p1, p2 = (
                w * (r[0] - f[0]) + q * (d[0] - f[0]),
                w * (r[1] - f[1]) + q * (d[1] - f[1]),
                w * (r[2] - f[2]) + q * (d[2] - f[2]),
            )
            p3, p4, p5 = (
                w * (r[3] - f[3]) + q * (d[3] - f[3]),
                w * (r[4] - f[4]) + q * (d[4] - f[4]),
                w * (r[5] - f[5]) + q * (d[5] - f[5]),
            )
            p6, p7, p8 = (
                w * (r[6] - f[6]) + q * (d[6] - f[6]),
                w * (r[7] - f[7]) + q * (d[7] - f[7]),
                w * (r[8] - f[8]) + q * (d[8] - f[8]),
            )
            ax, ay, az = p0 * i0 + p1 * i1 + p2 * i2, p3 * i0 + p4 * i1 + p5 * i2, p6 * i0 + p7 * i1 + p8 * i2
            bx, by, bz = p0 * i3 + p1 * i4 + p2 * i5, p3 * i3 + p4 * i4 + p5 * i5, p6 * i3 + p7 * i4 + p8 * i5
            cx, cy, cz = p0 * i6 + p1 * i7 + p2 * i8, p3 * i6 + p4 * i7 + p5 * i8, p6 * i6 + p7 * i7 + p8 * i8
            descent[v0, 0] -= ax + bx + cx
            descent[v0, 1] -= ay + by + cy
            descent[v0, 2] -= az + bz + cz
            descent[v1, 0] += ax
            descent[v1, 1] += ay
            descent[v1, 2] += az
            descent[v2, 0] += bx
            descent[v2, 1] += by
            descent[v2, 2] += bz
            descent[v3, 0] += cx
            descent[v3, 1] += cy
            descent[v3, 2] += cz
        sums[chunk, 0] = strain
        sums[chunk, 1] = volume
        sums[chunk, 2] = inverted


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
