"""A joint path becomes a trajectory within velocity, acceleration and jerk limits, by Ruckig on its arc length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ruckig
from numpy.typing import ArrayLike
from scipy.interpolate import PPoly

from dgs_arm_executor.smooth_path import SmoothPath
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array
from dgs_description.joints import ARM_ACCELERATION, ARM_JERK, ARM_VELOCITY

RATE = 50.0
"""Points per second of a trajectory: a controller's quintics exceed speeds by 0.3, accelerations by 0.6 % then [Hz]."""
_BOLDNESS = (1.0, 1.5, 2.2)
"""Of the acceleration along a curved path, against a bound from derivatives that do not fall together."""
_CHECK_STEP = 0.002
"""Twice the time between the states at which the limits are evaluated [s]."""


@dataclass(frozen=True)
class Trajectory:
    """Samples of a motion that starts and ends at rest.

    Attributes:
        times: (N,) from 0, strictly increasing [s].
        positions, velocities, accelerations: (N, 6) [rad], [rad/s], [rad/s^2].
    """

    times: Array
    positions: Array
    velocities: Array
    accelerations: Array

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.times[-1])

    @property
    def end(self) -> Array:
        """(6,) last position [rad]."""
        return self.positions[-1]


def time_path(
    path: SmoothPath, share: float = 1.0, rate: float = RATE, max_path_speed: float = np.inf
) -> Trajectory:
    """Rest-to-rest motion along a path within a share of the arm's velocity limits, its acceleration and jerk limits.

    A sectioned path (a line, a rounded polyline) is driven section by section: each straight one with Ruckig's
    time-optimal profile, the roundings at constant speed. A path that is curved throughout (a Cartesian line in joint
    space) gets one bound each on ds/dt, d2s/dt2 and d3s/dt3 from its largest |dq/ds|, |d2q/ds2|, |d3q/ds3|, and bolder
    ones. The motion is then checked state by state and stretched in time by the factor that makes the tightest limit
    hold exactly (velocity scales with 1/k, acceleration 1/k^2, jerk 1/k^3); the shortest one is taken.

    Args:
        share: of `ARM_VELOCITY` that every joint keeps, in (0, 1].
        rate: samples per second; the last one stands exactly at the end.
        max_path_speed: bound on ds/dt, e.g. the TCP's speed where s is a length [m/s].

    Raises:
        DgsError: the share is out of its range; Ruckig finds no profile.
    """
    if not 0.0 < share <= 1.0:
        raise DgsError(ErrorCode.ARM_INTERNAL, f"the share of the velocity limits is {share}, not in (0, 1]")
    velocity = ARM_VELOCITY * share
    if path.length < 1e-9:
        still = np.zeros((2, 6))  # staying where one is, for 20 ms: a trajectory needs two samples
        return Trajectory(np.array([0.0, 0.02]), np.tile(path(0.0), (2, 1)), still, still)
    if path.sectioned:
        profiles = [_section_profile(path, velocity, max_path_speed)]
    else:
        speed, acceleration, jerk = _bounds(path, velocity, max_path_speed, slice(None))
        profiles = [
            joined_profile([_ruckig(path.length, (speed, acceleration * boldness, jerk))])
            for boldness in _BOLDNESS
        ]
    stretches = [_stretch(path, profile, velocity, max_path_speed) for profile in profiles]
    pairs = zip(profiles, stretches, strict=True)
    profile, stretch = min(pairs, key=lambda pair: pair[0].x[-1] * pair[1])
    count = max(2, int(np.ceil(profile.x[-1] * stretch * rate)))
    times = np.linspace(0.0, profile.x[-1], count + 1)
    s = np.clip(profile(times), 0.0, path.length)
    s_t, s_tt = profile(times, 1)[:, None] / stretch, profile(times, 2)[:, None] / stretch**2
    positions, d1 = path(s), path(s, 1)
    velocities, accelerations = d1 * s_t, path(s, 2) * s_t**2 + d1 * s_tt
    positions[0], positions[-1] = path(0.0), path(path.length)
    velocities[[0, -1]] = 0.0
    accelerations[[0, -1]] = 0.0
    return Trajectory(times * stretch, positions, velocities, accelerations)


def joined_profile(parts: list[ruckig.Trajectory | tuple[float, float]]) -> PPoly:
    """s(t) of Ruckig's one-dimensional trajectories that start at 0, and of stretches (length, speed), in a row.

    Both are pieces of constant jerk, that is cubic polynomials, which are evaluated for all times at once.
    """
    tables, offset = [], 0.0
    for part in parts:
        table = _pieces(part)
        table[:, 1] += offset
        offset += part[0] if isinstance(part, tuple) else part.at_time(part.duration)[0][0]
        tables.append(table)
    duration, s, s_t, s_tt, s_ttt = np.concatenate(tables).T
    return PPoly(np.stack([s_ttt / 6, s_tt / 2, s_t, s]), np.append(0.0, np.cumsum(duration)))


def _pieces(part: ruckig.Trajectory | tuple[float, float]) -> Array:
    """(M, F) duration, s, ds/dt, d2s/dt2, d3s/dt3 at the start of every piece of constant jerk that takes time."""
    if isinstance(part, tuple):
        return np.array([[part[0] / part[1], 0.0, part[1], 0.0, 0.0]])
    profile = part.profiles[0][0]
    phases = [profile.brake, profile] if profile.brake.duration > 0 else [profile]
    rows = [row for phase in phases for row in zip(phase.t, phase.p, phase.v, phase.a, phase.j, strict=False)]
    table = np.array(rows)
    return table[table[:, 0] > 0.0]


def _bounds(
    path: SmoothPath, velocity: Array, max_path_speed: float, spans: slice
) -> tuple[float, float, float]:
    """Bounds on the first three time derivatives of s, from the largest derivatives of some spans of the path.

    q'' s_t^2 and the mixed jerk terms take at most half of their limits, the tangential terms get the rest.
    """
    starts, lengths = path.curve.x[:-1][spans], np.diff(path.curve.x)[spans]
    share = np.linspace(0.0, 1.0 - 1e-9, 9)  # an end is the next span's start
    s = starts[:, None] + lengths[:, None] * share
    d1, d2, d3 = (np.abs(path(s, order)).max((0, 1)) + 1e-12 for order in (1, 2, 3))
    v, a, j = velocity, ARM_ACCELERATION, ARM_JERK
    speed = min(max_path_speed, float(np.min([v / d1, np.sqrt(a / (2 * d2)), np.cbrt(j / (4 * d3))])))
    acceleration = float(np.min([(a - d2 * speed**2) / d1, j / (4 * 3 * d2 * speed)]))
    jerk = float(((j - d3 * speed**3 - 3 * d2 * speed * acceleration) / d1).min())
    return speed, acceleration, jerk


def _section_profile(path: SmoothPath, velocity: Array, max_path_speed: float) -> PPoly:
    """Profile of a path of straight sections, between which roundings are passed at constant speed."""
    lengths, straight = np.diff(path.curve.x), path.is_straight
    corners = [k for k in range(len(lengths) - 1) if not straight[k] and not straight[k + 1]]
    speeds = [_corner_speed(path, k, velocity, max_path_speed) for k in corners]
    sections = [k for k in range(len(lengths)) if straight[k]]
    bounds = [_bounds(path, velocity, max_path_speed, slice(k, k + 1)) for k in sections]
    # Speed at the start and the end of every straight section; lowered until no section asks for the impossible.
    speed = np.array([0.0, *speeds, 0.0])
    for _ in range(100):
        runs = [_ruckig(lengths[k], bounds[i], speed[i], speed[i + 1]) for i, k in enumerate(sections)]
        bad = [i for i, run in enumerate(runs) if not _is_forward(run, bounds[i][0])]
        if not bad:
            parts: list[ruckig.Trajectory | tuple[float, float]] = [runs[0]]
            for k, passed, run in zip(corners, speed[1:], runs[1:], strict=False):
                parts += [(float(lengths[k] + lengths[k + 1]), float(passed)), run]
            return joined_profile(parts)
        for i in bad:
            speed[i + int(speed[i + 1] > speed[i])] *= 0.8
    raise DgsError(ErrorCode.ARM_INTERNAL, "no time profile for a path with rounded corners")


def _corner_speed(path: SmoothPath, k: int, velocity: Array, max_path_speed: float) -> float:
    """Constant speed at which the rounding of spans `k` and `k + 1` stays within the limits."""
    s = np.linspace(path.curve.x[k], path.curve.x[k + 2], 21)
    d1, d2, d3 = (np.abs(path(s, order)).max(0) + 1e-12 for order in (1, 2, 3))
    bounds = (velocity / d1, np.sqrt(ARM_ACCELERATION / d2), np.cbrt(ARM_JERK / d3))
    return min(max_path_speed, float(np.min(bounds)))


def _is_forward(run: ruckig.Trajectory, speed: float) -> bool:
    """Whether a run between two speeds neither goes backwards nor exceeds the speed."""
    velocities = joined_profile([run])(np.linspace(0.0, run.duration, 40), 1)
    return bool((velocities > -1e-9).all() and (velocities < speed * (1 + 1e-6)).all())


def _ruckig(
    length: float, bounds: tuple[float, float, float], start_speed: float = 0.0, end_speed: float = 0.0
) -> ruckig.Trajectory:
    """Time-optimal s(t) from 0 to `length` between two speeds, unaccelerated at both ends."""
    request, run = ruckig.InputParameter(1), ruckig.Trajectory(1)
    request.current_position, request.target_position = [0.0], [float(length)]
    request.current_velocity, request.target_velocity = [float(start_speed)], [float(end_speed)]
    request.max_velocity, request.max_acceleration, request.max_jerk = ([bound] for bound in bounds)
    result = ruckig.Ruckig(1).calculate(request, run)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise DgsError(ErrorCode.ARM_INTERNAL, f"no time profile for a path of length {length:.4f}: {result}")
    return run


def _stretch(path: SmoothPath, profile: PPoly, velocity: Array, max_path_speed: float) -> float:
    """Time factor after which the tightest limit holds exactly; below 1 where the bounds were too careful."""
    count = 2 * int(np.clip(np.ceil(profile.x[-1] / _CHECK_STEP), 50, 4000))
    times = np.linspace(0.0, profile.x[-1], count + 1)
    s = np.clip(profile(times), 0.0, path.length)
    s_t, s_tt, s_ttt = (profile(times, order)[:, None] for order in (1, 2, 3))
    d1, d2, d3 = (path(s, order) for order in (1, 2, 3))
    jerk = np.abs(d3) * s_t**3 + np.abs(3 * d2 * s_t * s_tt) + np.abs(d1 * s_ttt)
    ratios = (
        (np.abs(d1 * s_t) / velocity).max(),
        s_t.max() / max_path_speed,
        np.sqrt((np.abs(d2 * s_t**2 + d1 * s_tt) / ARM_ACCELERATION).max()),
        np.cbrt((jerk / ARM_JERK).max()),
    )
    return float(max(ratios)) * (1 + 1e-3)


def anchored(trajectory: Trajectory, measured: ArrayLike) -> Trajectory:
    """The trajectory started at the measured state (6,) [rad] instead of a few milliradians beside it.

    The offset fades out over the whole duration by the quintic 10 x^3 - 15 x^4 + 6 x^5, so that velocity and
    acceleration stay zero at both ends.
    """
    offset = np.asarray(measured, float) - trajectory.positions[0]
    x = (trajectory.times / trajectory.duration)[:, None]
    fade = 1 - x**3 * (10 - 15 * x + 6 * x**2)
    fade_t = -30 * x**2 * (1 - x) ** 2 / trajectory.duration
    fade_tt = -60 * x * (1 - x) * (1 - 2 * x) / trajectory.duration**2
    position, velocity = trajectory.positions + offset * fade, trajectory.velocities + offset * fade_t
    return Trajectory(trajectory.times, position, velocity, trajectory.accelerations + offset * fade_tt)
