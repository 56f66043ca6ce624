"""Convex building blocks of the procedural objects. Every function returns convex parts, each (V, 3) points [m]."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from dgs_description.frames import Array

Parts = list[Array]


def moved(parts: Parts, position: ArrayLike = (0, 0, 0), rpy: ArrayLike = (0, 0, 0)) -> Parts:
    """Parts turned by fixed-axis roll, pitch, yaw [rad], then shifted [m]."""
    rotation = Rotation.from_euler("xyz", np.asarray(rpy, float)).as_matrix()
    return [part @ rotation.T + np.asarray(position, float) for part in parts]


def box(size: ArrayLike, chamfer: float = 0.0) -> Parts:
    """A box with edges `size` whose corners are cut back by `chamfer` along each edge [m]."""
    half = np.asarray(size, float) / 2
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3, indexing="ij")).reshape(3, -1).T
    if chamfer <= 0:
        return [signs * half]
    chamfer = min(chamfer, 0.45 * float(half.min()) * 2)
    corners = [signs * (half - chamfer * (np.arange(3) != axis)) for axis in range(3)]
    return [np.concatenate(corners)]


def prism(polygon: ArrayLike, height: float, top_scale: float = 1.0) -> Parts:
    """A convex polygon (V, 2) in x-y, extruded along z, its top scaled."""
    base = np.asarray(polygon, float)
    bottom = np.column_stack([base, np.full(len(base), -height / 2)])
    top = np.column_stack([base * top_scale, np.full(len(base), height / 2)])
    return [np.concatenate([bottom, top])]


def superquadric(half_size: ArrayLike, e1: float, e2: float, rings: int = 9, sectors: int = 16) -> Parts:
    """Superellipsoid with exponents e1 (meridian) and e2 (equator) in (0, 2]: 0.2 = box-like, 1 = ellipsoid.

    x = a cos^e1(eta) cos^e2(omega) etc. (Barr, 1981), powers taken with sign.
    """
    eta = np.linspace(-np.pi / 2, np.pi / 2, rings)[:, None]
    omega = np.linspace(-np.pi, np.pi, sectors, endpoint=False)[None]

    def power(value: Array, exponent: float) -> Array:
        return np.sign(value) * np.abs(value) ** exponent

    x = power(np.cos(eta), e1) * power(np.cos(omega), e2)
    y = power(np.cos(eta), e1) * power(np.sin(omega), e2)
    z = np.broadcast_to(power(np.sin(eta), e1), x.shape)
    unit = np.unique(np.round(np.stack([x, y, z], -1).reshape(-1, 3), 6), axis=0)
    return [unit * np.asarray(half_size, float)]


def _ring(radius: float, z: float, sectors: int, squash: float = 1.0) -> Array:
    if radius < 1e-4:
        return np.array([[0.0, 0.0, z]])
    angle = 2 * np.pi * np.arange(sectors) / sectors
    return np.column_stack([radius * np.cos(angle), squash * radius * np.sin(angle), np.full(sectors, z)])


def lathe(profile: ArrayLike, sectors: int = 18, squash: float = 1.0) -> Parts:
    """A solid of revolution about z, split where its profile turns concave.

    Args:
        profile: (P, 2) radius, z from bottom to top [m].
        squash: scale of y, for oval sections.
    """
    points = np.asarray(profile, float)
    parts, start = [], 0
    for k in range(1, len(points)):
        last = k == len(points) - 1
        if not last:
            a, b, c = points[k - 1], points[k], points[k + 1]
            concave = (b - a)[0] * (c - b)[1] - (b - a)[1] * (c - b)[0] < -1e-9
        if last or concave:
            rings = [_ring(r, z, sectors, squash) for r, z in points[start : k + 1]]
            parts.append(np.concatenate(rings))
            start = k
    return parts


def vessel(
    profile: Sequence[tuple[float, float]], thickness: float, sectors: int = 14, squash: float = 1.0
) -> Parts:
    """A hollow of revolution: a floor disc and wall wedges.

    Args:
        profile: (outer radius, z) of the wall from the floor's rim up to the lip [m].
        thickness: wall and floor thickness [m].
    """
    (radius, z0), *_ = profile
    parts = [np.concatenate([_ring(radius, z, sectors, squash) for z in (z0, z0 + thickness)])]
    angle = 2 * np.pi * np.arange(sectors + 1) / sectors
    for (r0, za), (r1, zb) in pairwise(profile):
        for a0, a1 in pairwise(angle):
            corners = [
                (rr * np.cos(a), squash * rr * np.sin(a), z)
                for a in (a0, a1)
                for r, z in ((r0, za), (r1, zb))
                for rr in (r, max(r - thickness, 1e-3))
            ]
            parts.append(np.array(corners))
    return parts


def tube(centreline: ArrayLike, radii: ArrayLike, sectors: int = 10) -> Parts:
    """A chain of convex segments along a centreline (P, 3) with radii (P,) [m]."""
    line = np.asarray(centreline, float)
    radius = np.broadcast_to(np.asarray(radii, float), len(line))
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    rings = []
    for point, direction, r in zip(line, tangent, radius, strict=True):
        helper = np.eye(3)[np.argmin(np.abs(direction))]
        u = np.cross(direction, helper)
        u /= np.linalg.norm(u)
        v = np.cross(direction, u)
        angle = 2 * np.pi * np.arange(sectors) / sectors
        rings.append(point + r * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v))
    return [np.concatenate(pair) for pair in pairwise(rings)]


def handle(radius: float, height: float, offset: float, thickness: float) -> Parts:
    """A mug's handle in the x-z plane: half a ring of `radius`, starting at x = `offset` [m]."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 6)
    line = np.column_stack([offset + radius * np.cos(angle), np.zeros(6), height * np.sin(angle) / 2])
    return tube(line, thickness, sectors=6)


def strip(stations: Sequence[tuple[float, float, float, float]], thickness: ArrayLike) -> Parts:
    """A bar along x, convex between neighbours among its cross-sections.

    Args:
        stations: (S, 4) x, y, z of each rectangle's middle and its width along y [m].
        thickness: along z, one or (S,) [m].
    """
    rings = [
        np.array([(x, y + s * w / 2, z + u * t / 2) for s in (-1, 1) for u in (-1, 1)])
        for (x, y, z, w), t in zip(stations, np.broadcast_to(thickness, len(stations)), strict=True)
    ]
    return [np.concatenate(pair) for pair in pairwise(rings)]
