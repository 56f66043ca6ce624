"""Collision-free joint paths: the straight line where it is free, else OMPL's RRT-Connect with shortcuts."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from dgs_arm_executor.planning_scene import CollisionChecker
from dgs_arm_executor.smooth_path import SmoothPath
from dgs_description.joints import ARM_LOWER, ARM_UPPER

Array = NDArray[np.float64]

ou.setLogLevel(ou.LOG_ERROR)
ou.RNG.setSeed(1)  # possible once per process only; the same sequence of queries then has the same answers

_MARGIN = np.pi / 2
"""How far beyond the box of start and goal the planner samples [rad]."""
_BLENDS = (0.6, 0.3, 0.1)
_DENSE_STEP = 0.03


@dataclass(frozen=True)
class PathSettings:
    """Of the sampling planner."""

    timeout: float = 1.0
    """Processor time for one query [s]: a busy machine makes the search slower, not worse."""
    shortcut_tries: int = 60
    seed: int = 1


def plan_path(
    checker: CollisionChecker,
    start: ArrayLike,
    goal: ArrayLike,
    settings: PathSettings | None = None,
) -> SmoothPath | None:
    """A free path between two joint states.

    Args:
        checker: of the situation in which the path is driven.
        start, goal: (6,) [rad].

    Returns:
        The path, checked along its rounded corners; None where an end is not free or no path was found in time.
    """
    settings = settings or PathSettings()
    a, b = np.asarray(start, float), np.asarray(goal, float)
    if checker.in_collision(a) or checker.in_collision(b):
        return None  # OMPL would wait for another goal until the time is up
    if checker.first_collision(np.stack([a, b])) is None:
        return SmoothPath.line(a, b)
    waypoints = _sampled(checker, a, b, settings)
    if waypoints is None:
        return None
    waypoints = shortcut(checker, waypoints, settings)
    for blend in _BLENDS:
        path = SmoothPath.rounded(waypoints, blend)
        if checker.first_collision(path(np.linspace(0.0, path.length, _samples(path)))) is None:
            return path
    return SmoothPath.rounded(waypoints, 1e-3)


def shortcut(checker: CollisionChecker, waypoints: Array, settings: PathSettings) -> Array:
    """Replace parts of a joint polyline (N, 6) by straight lines where those are free."""
    points = _drop_middle_points(checker, waypoints)
    rng = np.random.default_rng(settings.seed)
    for _ in range(settings.shortcut_tries):
        if len(points) < 3:
            break
        arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        low, high = np.sort(rng.uniform(0.0, arc[-1], 2))
        i, j = int(np.searchsorted(arc, low, side="right")), int(np.searchsorted(arc, high, side="left"))
        if i >= j:
            continue
        cut = np.stack([[np.interp(value, arc, points[:, k]) for k in range(6)] for value in (low, high)])
        if checker.first_collision(cut) is None:
            points = np.concatenate([points[:i], cut, points[j:]])
    return _drop_middle_points(checker, points)


def _drop_middle_points(checker: CollisionChecker, points: Array) -> Array:
    """From every point straight on to the farthest one that can be seen from it."""
    kept, k = [points[0]], 0
    while k < len(points) - 1:
        for j in range(len(points) - 1, k, -1):
            if j == k + 1 or checker.first_collision(points[[k, j]]) is None:
                break
        kept.append(points[j])
        k = j
    return np.array(kept)


def _samples(path: SmoothPath) -> int:
    return max(3, int(np.ceil(path.length / _DENSE_STEP)))


def _sampled(checker: CollisionChecker, start: Array, goal: Array, settings: PathSettings) -> Array | None:
    """Polyline (N, 6) of OMPL's RRT-Connect, or None."""
    space = ob.RealVectorStateSpace(6)
    bounds = ob.RealVectorBounds(6)
    lower = np.maximum(np.minimum(start, goal) - _MARGIN, ARM_LOWER)
    upper = np.minimum(np.maximum(start, goal) + _MARGIN, ARM_UPPER)
    for k in range(6):
        bounds.setLow(k, float(lower[k]))
        bounds.setHigh(k, float(upper[k]))
    space.setBounds(bounds)
    setup = og.SimpleSetup(space)
    setup.setStateValidityChecker(_validity(checker))
    info = setup.getSpaceInformation()
    info.setStateValidityCheckingResolution(0.05 / space.getMaximumExtent())
    planner = og.RRTConnect(info)
    planner.setRange(0.8)
    setup.setPlanner(planner)
    setup.setStartAndGoalStates(_state(space, start), _state(space, goal))
    if (
        not setup.solve(ob.PlannerTerminationCondition(_time_is_up(settings.timeout)))
        or not setup.haveExactSolutionPath()
    ):
        return None
    states = setup.getSolutionPath().getStates()
    return np.array([[state[k] for k in range(6)] for state in states])


def _time_is_up(timeout: float) -> Callable[[], bool]:
    """Whether `timeout` seconds of processor time, or ten times as many of wall time, have passed since now."""
    processor, wall = time.thread_time() + timeout, time.perf_counter() + 10 * timeout
    return lambda: time.thread_time() > processor or time.perf_counter() > wall


def _validity(checker: CollisionChecker) -> Callable[[ob.State], bool]:
    def is_free(state: ob.State) -> bool:
        return not checker.in_collision([state[k] for k in range(6)])

    return is_free


def _state(space: ob.StateSpace, q: Array) -> ob.State:
    state = space.allocState()
    for k in range(6):
        state[k] = float(q[k])
    return state
