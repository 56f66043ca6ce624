"""Collision-free joint paths: the straight line where it is free, else OMPL's RRT-Connect, simplified and rounded."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from dgs_arm_executor.planning_scene import PATH_STEP, CollisionChecker, densify
from dgs_arm_executor.smooth_path import SmoothPath
from dgs_description.frames import Array

ou.setLogLevel(ou.LOG_ERROR)
ou.RNG.setSeed(1)  # possible once per process only; the same sequence of queries then has the same answers

_MARGIN = np.pi / 2
"""How far beyond the box of start and goal the planner samples [rad]."""
_RANGE = 0.8
"""Longest edge of the planner's trees [rad]."""
_SHORTCUTS = (60, 20, 0.5, 0.005)
"""Shortcuts tried, in vain at most, how far apart their ends are, and from how near these go to a waypoint (shares)."""
_BLENDS = (0.6, 0.3, 0.1, 1e-3)
"""Sizes of the rounded corners that are tried, the largest that is free wins [rad]."""
_FINER, _FINE = PATH_STEP / 3, PATH_STEP / 6
"""Steps in which a straight line, and a way around, are looked at in the end: in those of the search one line in a
hundred grazes something, and one way around in four [rad]."""


def plan_path(
    checker: CollisionChecker, start: ArrayLike, goal: ArrayLike, timeout: float
) -> SmoothPath | None:
    """A free path between two joint states.

    Args:
        checker: of the situation in which the path is driven.
        start, goal: (6,) [rad].
        timeout: processor time for the search [s]: a busy machine makes it slower, not worse; 0 = the straight line
            or nothing.

    Returns:
        The path, checked along its rounded corners; None where an end is not free or no path was found in time.
    """
    a, b = np.asarray(start, float), np.asarray(goal, float)
    if checker.first_collision(densify(np.stack([a, b]), _FINER)) is None:
        return SmoothPath.line(a, b)
    if not timeout or checker.in_collision(a) or checker.in_collision(b):
        return None  # OMPL would wait for another goal until the time is up
    begun = time.thread_time()
    while (left := timeout - (time.thread_time() - begun)) > 0:
        waypoints = rrt_connect(checker, a, b, left, tuned=True)
        if waypoints is None:
            return None
        for blend in _BLENDS:
            path = SmoothPath.rounded(waypoints, blend)
            samples = max(3, int(np.ceil(path.length / _FINE)))
            if checker.first_collision(path(np.linspace(0.0, path.length, samples))) is None:
                return path
        # Between the states that the search has looked at it grazes something: another one will not.
    return None


def rrt_connect(
    checker: CollisionChecker, start: Array, goal: Array, timeout: float, tuned: bool = False
) -> Array | None:
    """OMPL's RRT-Connect, and the path that was found shortened.

    Args:
        checker, start, goal: as for `plan_path`.
        timeout: processor time [s], or ten times as much wall time.
        tuned: with this suite's box of states, range, resolution and simplification instead of OMPL's own.

    Returns:
        (N, 6) joint polyline [rad]; None where none was found in time.
    """
    space = ob.RealVectorStateSpace(6)
    box = ob.RealVectorBounds(6)
    margin = _MARGIN if tuned else np.inf
    lower = np.maximum(np.minimum(start, goal) - margin, checker.lower)
    upper = np.minimum(np.maximum(start, goal) + margin, checker.upper)
    for k in range(6):
        box.setLow(k, float(lower[k]))
        box.setHigh(k, float(upper[k]))
    space.setBounds(box)
    setup = og.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: not checker.in_collision(_joints(state)))
    planner = og.RRTConnect(setup.getSpaceInformation())
    if tuned:
        planner.setRange(_RANGE)
        setup.getSpaceInformation().setStateValidityCheckingResolution(PATH_STEP / space.getMaximumExtent())
    setup.setPlanner(planner)
    setup.setStartAndGoalStates(_state(space, start), _state(space, goal))
    solved = setup.solve(ob.PlannerTerminationCondition(_time_is_up(timeout)))
    if not solved or not setup.haveExactSolutionPath():
        return None
    if tuned:
        _shorten(og.PathSimplifier(setup.getSpaceInformation()), setup.getSolutionPath())
    else:
        setup.simplifySolution()
    return np.array([_joints(state) for state in setup.getSolutionPath().getStates()])


def _shorten(simplifier: og.PathSimplifier, path: og.PathGeometric) -> None:
    """Half as many checks as OMPL's own choice, 2 % longer; its B-spline would be rounded again (`_BLENDS`)."""
    simplifier.reduceVertices(path)
    simplifier.partialShortcutPath(path, *_SHORTCUTS)
    simplifier.reduceVertices(path)


def _time_is_up(timeout: float) -> Callable[[], bool]:
    """Whether `timeout` seconds of processor time, or ten times as many of wall time, have passed since now."""
    processor, wall = time.thread_time() + timeout, time.perf_counter() + 10 * timeout
    return lambda: time.thread_time() > processor or time.perf_counter() > wall


def _joints(state: ob.State) -> list[float]:
    return [state[k] for k in range(6)]


def _state(space: ob.StateSpace, q: Array) -> ob.State:
    state = space.allocState()
    for k in range(6):
        state[k] = float(q[k])
    return state
