"""Joint paths q(s) as piecewise cubic curves: lines, splines through dense samples, polylines with rounded corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline, PPoly

from dgs_description.frames import Array

_STRAIGHT = 1e-6
"""Less than this is no corner, as directions differ."""


class SmoothPath:
    """A twice continuously differentiable joint path q(s), s in [0, length].

    Its third derivative is piecewise constant, so a smooth s(t) gives a bounded jerk.
    """

    def __init__(self, curve: PPoly, sectioned: bool = False):
        """`sectioned`: the curve is made of straight spans with pairs of spans in between that round the corners."""
        self.curve, self.sectioned = curve, sectioned
        self.length = float(curve.x[-1])

    @classmethod
    def line(cls, start: ArrayLike, end: ArrayLike) -> SmoothPath:
        """Straight joint line between two (6,) states [rad]."""
        a, b = np.asarray(start, float), np.asarray(end, float)
        length = max(float(np.linalg.norm(b - a)), 1e-12)
        zero = np.zeros(6)
        return cls(PPoly(np.stack([zero, zero, (b - a) / length, a])[:, None], np.array([0.0, length])), True)

    @classmethod
    def through(cls, samples: ArrayLike, parameter: ArrayLike) -> SmoothPath:
        """Cubic spline through dense samples (N, 6) [rad] at increasing parameter values (N,) from 0."""
        return cls(CubicSpline(np.asarray(parameter, float), np.asarray(samples, float)))

    @classmethod
    def rounded(cls, waypoints: ArrayLike, blend: float) -> SmoothPath:
        """Joint polyline (N, 6) with every corner rounded by two cubic spans of a uniform B-spline.

        A corner P between the directions u1 and u2 is replaced from h before to h behind it by
        P + u1 s + h (u2 - u1) ((s + h) / h)^3 / 6 and, behind, P + u2 s + h (u2 - u1) ((h - s) / h)^3 / 6: twice
        continuously differentiable, h |u2 - u1| / 6 away from the corner at most. h is `blend` [rad], or less where
        a neighbouring stretch is short. The stretches in between stay straight, with |dq/ds| = 1.
        """
        points = _corners(np.asarray(waypoints, float).reshape(-1, 6))
        if len(points) < 3:
            return cls.line(points[0], points[-1])
        steps = np.diff(points, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        u, arc = steps / lengths[:, None], np.append(0.0, np.cumsum(lengths))
        h = np.minimum(blend, 0.45 * np.minimum(lengths[:-1], lengths[1:]))
        zero = np.zeros(6)
        starts, spans = [0.0], [(zero, zero, u[0], points[0])]
        for k, (corner, half) in enumerate(zip(points[1:-1], h, strict=True)):
            turn, middle = u[k + 1] - u[k], (u[k] + u[k + 1]) / 2
            bend = turn / (6 * half**2)
            starts += [arc[k + 1] - half, arc[k + 1], arc[k + 1] + half]
            spans += [
                (bend, zero, u[k], corner - half * u[k]),
                (-bend, turn / (2 * half), middle, corner + half * turn / 6),
                (zero, zero, u[k + 1], corner + half * u[k + 1]),
            ]
        return cls(PPoly(np.stack(spans, axis=1), np.append(starts, arc[-1])), True)

    @property
    def is_straight(self) -> NDArray[np.bool_]:
        """(M,) which spans between the breaks `curve.x` are straight."""
        return np.abs(self.curve.c[:2]).max((0, 2)) < 1e-12

    def __call__(self, s: ArrayLike, order: int = 0) -> Array:
        """(..., 6) joints at s [rad], or their derivative of an order with respect to s."""
        return self.curve(np.asarray(s, float), order)


def _corners(points: Array) -> Array:
    """Both ends of (N, 6) points [rad] and what between them is neither repeated nor on the straight line."""
    apart = points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9)]
    steps = np.diff(apart, axis=0)
    turns = np.diff(steps / np.linalg.norm(steps, axis=1)[:, None], axis=0)
    keep = np.linalg.norm(turns, axis=1) > _STRAIGHT
    return apart[[True, *keep, True]] if len(apart) > 1 else points[[0, -1]]
