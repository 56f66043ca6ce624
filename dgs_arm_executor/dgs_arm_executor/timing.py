"""A joint path becomes a trajectory within velocity, acceleration and jerk limits, by Ruckig on its arc length."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import ruckig
from numpy.typing import ArrayLike, NDArray

from dgs_arm_executor.smooth_path import SmoothPath
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.joints import ARM_ACCELERATION, ARM_JERK, ARM_VELOCITY

Array = NDArray[np.float64]

_CHECK_STEP = 0.002
"""Time between the states at which the limits are evaluated [s]."""


@dataclass(frozen=True)
class Limits:
    """Limits of every joint along a trajectory: (6,) [rad/s], [rad/s^2], [rad/s^3]."""

    velocity: Array = field(default_factory=lambda: ARM_VELOCITY.copy())
    acceleration: Array = field(default_factory=lambda: ARM_ACCELERATION.copy())
    jerk: Array = field(default_factory=lambda: ARM_JERK.copy())

    def scaled(self, speed: float) -> Limits:
        """The same limits with the velocities times `speed`.

        Raises:
            DgsError: the speed is not in (0, 1].
        """
        if not 0.0 < speed <= 1.0:
            raise DgsError(ErrorCode.ARM_INTERNAL, f"speed scaling must be in (0, 1], got {speed}")
        return replace(self, velocity=self.velocity * speed)


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
    path: SmoothPath, limits: Limits, rate: float = 50.0, max_path_speed: float = np.inf
) -> Trajectory:
    """Rest-to-rest motion along a path.

    A sectioned path (a line, a rounded polyline) is driven section by section: each straight one with Ruckig's
    time-optimal profile, the roundings at constant speed. A path that is curved throughout (a Cartesian line in joint
    space) gets one bound each on ds/dt, d2s/dt2 and d3s/dt3 from its largest |dq/ds|, |d2q/ds2|, |d3q/ds3|. Either
    way the motion is then checked state by state and stretched in time by the factor that makes the tightest limit
    hold exactly (velocity scales with 1/k, acceleration 1/k^2, jerk 1/k^3).

    Args:
        path: where to go.
        limits: of every joint.
        rate: samples per second; the last one stands exactly at the end.
        max_path_speed: bound on ds/dt, e.g. the TCP's speed where s is a length [m/s].

    Raises:
        DgsError: Ruckig finds no profile.
    """
    if path.length < 1e-9:
        return _hold(path(0.0))
    if path.sectioned:
        profile = _section_profile(path, limits, max_path_speed)
    else:
        profile = Profile([_ruckig(path.length, *_path_limits(path, limits, max_path_speed))])
    return _sample(path, profile, _stretch(path, profile, limits, max_path_speed), rate)


class Profile:
    """s(t) put together from Ruckig's one-dimensional trajectories and stretches of constant speed.

    A part is a `ruckig.Trajectory` that starts at 0, or (length, speed). Both are pieces of constant jerk, which are
    evaluated for all times at once.
    """

    def __init__(self, parts: list[ruckig.Trajectory | tuple[float, float]]):
        tables, offset = [], 0.0
        for part in parts:
            table = _pieces(part)
            table[:, 1] += offset
            offset += part[0] if isinstance(part, tuple) else part.at_time(part.duration)[0][0]
            tables.append(table)
        table = np.concatenate(tables)
        self._starts = np.append(0.0, np.cumsum(table[:, 0]))
        self._pieces = table[:, 1:]
        self.duration = float(self._starts[-1])

    def states(self, times: Array) -> Array:
        """(N, 3) s, ds/dt, d2s/dt2 at the given times."""
        index = np.clip(np.searchsorted(self._starts, times, side="right") - 1, 0, len(self._pieces) - 1)
        s, v, a, j = self._pieces[index].T
        t = times - self._starts[index]
        return np.stack([s + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2), a + t * j], axis=1)


def _pieces(part: ruckig.Trajectory | tuple[float, float]) -> Array:
    """(M, 5) duration, s, ds/dt, d2s/dt2, d3s/dt3 at the start of every piece of constant jerk that takes time."""
    if isinstance(part, tuple):
        return np.array([[part[0] / part[1], 0.0, part[1], 0.0, 0.0]])
    profile = part.profiles[0][0]
    brake, rows = profile.brake, []
    if brake.duration > 0:
        rows += list(zip(brake.t, brake.p, brake.v, brake.a, brake.j, strict=False))
    rows += list(zip(profile.t, profile.p, profile.v, profile.a, profile.j, strict=False))
    table = np.array(rows)
    return table[table[:, 0] > 0.0]


def _hold(q: Array) -> Trajectory:
    """Staying where one is, for 20 ms: a trajectory needs two samples."""
    still = np.zeros((2, 6))
    return Trajectory(np.array([0.0, 0.02]), np.tile(q, (2, 1)), still, still.copy())


def _path_limits(path: SmoothPath, limits: Limits, max_path_speed: float) -> tuple[float, float, float]:
    """Bounds on the first three time derivatives of s, from the path's largest derivatives.

    q'' s_t^2 and the mixed jerk terms take at most half of their limits, the tangential terms get the rest.
    """
    s = _grid(path)
    d1, d2, d3 = (np.abs(derivative(s)).max(0) for derivative in path.derivatives)
    tiny = 1e-12
    v, a, j = limits.velocity, limits.acceleration, limits.jerk
    speed = min(
        float((v / (d1 + tiny)).min()),
        max_path_speed,
        float(np.sqrt(a / (2 * d2 + tiny)).min()),
        float(np.cbrt(j / (4 * d3 + tiny)).min()),
    )
    acceleration = float(((a - d2 * speed**2) / (d1 + tiny)).min())
    acceleration = min(acceleration, float((j / (4 * 3 * d2 * speed + tiny)).min()))
    jerk = float(((j - d3 * speed**3 - 3 * d2 * speed * acceleration) / (d1 + tiny)).min())
    return speed, acceleration, jerk


def _grid(path: SmoothPath) -> Array:
    """Parameter values at which the path's derivatives take their largest values: knots and points in between."""
    knots = path.curve.x
    inner = knots[:-1, None] + np.diff(knots)[:, None] * np.linspace(0.0, 1.0, 9)[:-1]
    return np.append(inner.ravel(), knots[-1])


def _section_profile(path: SmoothPath, limits: Limits, max_path_speed: float) -> Profile:
    """Profile of a path of straight sections, between which roundings are passed at constant speed."""
    lengths, straight = np.diff(path.curve.x), path.is_straight
    corners = [k for k in range(len(lengths) - 1) if not straight[k] and not straight[k + 1]]
    speeds = {k: _corner_speed(path, k, limits, max_path_speed) for k in corners}
    sections = [k for k in range(len(lengths)) if straight[k]]
    # Speed at the start and the end of every straight section; lowered until no section asks for the impossible.
    speed = np.array([0.0, *speeds.values(), 0.0])
    bounds = [_straight_bounds(path, k, limits, max_path_speed) for k in sections]
    parts: list[ruckig.Trajectory | tuple[float, float]] = []
    for _ in range(100):
        runs = [_ruckig(lengths[k], *bounds[i], speed[i], speed[i + 1]) for i, k in enumerate(sections)]
        bad = [i for i, run in enumerate(runs) if not _is_forward(run, bounds[i][0])]
        if not bad:
            for i, run in enumerate(runs):
                parts.append(run)
                if i < len(corners):
                    parts.append((float(lengths[corners[i]] + lengths[corners[i] + 1]), float(speed[i + 1])))
            return Profile(parts)
        for i in bad:
            speed[i + int(speed[i + 1] > speed[i])] *= 0.8
    raise DgsError(ErrorCode.ARM_INTERNAL, "no time profile for a path with rounded corners")


def _straight_bounds(
    path: SmoothPath, k: int, limits: Limits, max_path_speed: float
) -> tuple[float, float, float]:
    """Bounds on the derivatives of s on straight span `k`."""
    direction = np.abs(path.curve.c[2, k]) + 1e-12
    return (
        min(float((limits.velocity / direction).min()), max_path_speed),
        float((limits.acceleration / direction).min()),
        float((limits.jerk / direction).min()),
    )


def _corner_speed(path: SmoothPath, k: int, limits: Limits, max_path_speed: float) -> float:
    """Constant speed at which the rounding of spans `k` and `k + 1` stays within the limits."""
    s = np.linspace(path.curve.x[k], path.curve.x[k + 2], 21)
    d1, d2, d3 = (np.abs(derivative(s)).max(0) + 1e-12 for derivative in path.derivatives)
    bounds = (limits.velocity / d1, np.sqrt(limits.acceleration / d2), np.cbrt(limits.jerk / d3))
    return min(max_path_speed, *(float(bound.min()) for bound in bounds))


def _is_forward(run: ruckig.Trajectory, speed: float) -> bool:
    """Whether a run between two speeds neither goes backwards nor exceeds the speed."""
    velocities = Profile([run]).states(np.linspace(0.0, run.duration, 40))[:, 1]
    return bool((velocities > -1e-9).all() and (velocities < speed * (1 + 1e-6)).all())


def _ruckig(
    length: float,
    speed: float,
    acceleration: float,
    jerk: float,
    start_speed: float = 0.0,
    end_speed: float = 0.0,
) -> ruckig.Trajectory:
    """Time-optimal s(t) from 0 to `length` between two speeds, unaccelerated at both ends."""
    otg = ruckig.Ruckig(1)
    request = ruckig.InputParameter(1)
    request.current_position, request.target_position = [0.0], [float(length)]
    request.current_velocity, request.target_velocity = [float(start_speed)], [float(end_speed)]
    request.max_velocity, request.max_acceleration, request.max_jerk = [speed], [acceleration], [jerk]
    run = ruckig.Trajectory(1)
    result = otg.calculate(request, run)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise DgsError(ErrorCode.ARM_INTERNAL, f"no time profile for a path of length {length:.4f}: {result}")
    return run


def _joint_states(path: SmoothPath, states: Array) -> tuple[Array, Array, Array]:
    """(N, 6) positions, velocities, accelerations of path states (N, 3)."""
    s, s_t, s_tt = np.clip(states[:, 0], 0.0, path.length), states[:, 1:2], states[:, 2:3]
    d1, d2 = path.derivatives[0](s), path.derivatives[1](s)
    return path(s), d1 * s_t, d2 * s_t**2 + d1 * s_tt


def _stretch(path: SmoothPath, profile: Profile, limits: Limits, max_path_speed: float) -> float:
    """Time factor after which the tightest limit holds exactly; below 1 where the bounds were too careful."""
    count = int(np.clip(np.ceil(profile.duration / _CHECK_STEP), 50, 4000))
    times = np.linspace(0.0, profile.duration, 2 * count + 1)
    states = profile.states(times)
    # States in the middles of the intervals; their ends give d3s/dt3, which is constant in nearly all of them.
    s_ttt = np.abs(np.diff(states[::2, 2]) / np.diff(times[::2]))[:, None]
    _, velocity, acceleration = _joint_states(path, states)
    s, s_t, s_tt = np.clip(states[1::2, 0], 0.0, path.length), states[1::2, 1:2], states[1::2, 2:3]
    d1, d2, d3 = (derivative(s) for derivative in path.derivatives)
    jerk = np.abs(d3) * s_t**3 + np.abs(3 * d2 * s_t * s_tt) + np.abs(d1) * s_ttt
    ratios = (
        (np.abs(velocity) / limits.velocity).max(),
        s_t.max() / max_path_speed,
        np.sqrt((np.abs(acceleration) / limits.acceleration).max()),
        np.cbrt((jerk / limits.jerk).max()),
    )
    return float(max(ratios)) * (1 + 1e-3)


def _sample(path: SmoothPath, profile: Profile, stretch: float, rate: float) -> Trajectory:
    duration = profile.duration * stretch
    count = max(2, int(np.ceil(duration * rate)))
    times = np.linspace(0.0, duration, count + 1)
    states = profile.states(times / stretch) / np.array([1.0, stretch, stretch**2])
    positions, velocities, accelerations = _joint_states(path, states)
    positions[0], positions[-1] = path(0.0), path(path.length)
    velocities[[0, -1]] = 0.0
    accelerations[[0, -1]] = 0.0
    return Trajectory(times, positions, velocities, accelerations)


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
    return Trajectory(
        trajectory.times,
        trajectory.positions + offset * fade,
        trajectory.velocities + offset * fade_t,
        trajectory.accelerations + offset * fade_tt,
    )
