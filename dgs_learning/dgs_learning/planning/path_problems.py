"""Paths of another arm among other people's obstacles: problems of MotionBenchMaker, solved by the suite's path stage.

The folder is `resources/ur5` of KavrakiLab/vamp: `ur5.urdf` with its meshes, `ur5.srdf`, and the unpacked
`problems/<scene>_ur5/{scene,request}NNNN.yaml` in the format of MoveIt (Chamzas et al., 2022).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import yaml
from scipy.spatial.transform import Rotation

from dgs_arm_executor.paths import plan_path, rrt_connect
from dgs_arm_executor.planning_scene import CollisionChecker, SceneSettings, densify
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, transform
from dgs_description.joints import ARM_JOINTS

Record = dict[str, Any]

FINE_STEP = 0.005
"""Every path is looked at again in so many rad: a sixth of the planner's own step."""


@dataclass(frozen=True)
class PathProblem:
    """From one joint state to another.

    Attributes:
        scene: name of its kind, such as `bookshelf_thin`.
        number: which of that kind.
        start, goal: (6,) [rad].
        contact: of the robot among the scene's obstacles, where they touch.
        clearance: the same for planning: the suite's clearance besides, where both ends keep it.
    """

    scene: str
    number: int
    start: Array
    goal: Array
    contact: CollisionChecker
    clearance: CollisionChecker


class ProblemFolder:
    """A robot and its problems.

    Attributes:
        scenes: names of the kinds of scenes.
    """

    def __init__(self, folder: Path):
        """Read the robot.

        Raises:
            DgsError: REQUEST_INVALID, something is missing in the folder.
        """
        urdf, srdf, requests = folder / "ur5.urdf", folder / "ur5.srdf", "problems/*/request*.yaml"
        for wanted in (urdf.name, srdf.name, requests):
            if not any(folder.glob(wanted)):
                raise DgsError(
                    ErrorCode.REQUEST_INVALID, f"{folder} holds no problems for paths: no {wanted}"
                )
        self._model = pin.buildModelFromUrdf(str(urdf))
        self._robot = pin.buildGeomFromUrdf(
            self._model, str(urdf), pin.GeometryType.COLLISION, package_dirs=[str(folder)]
        )
        self._links = len(self._robot.geometryObjects)
        self._robot.addAllCollisionPairs()
        pin.removeCollisionPairs(self._model, self._robot, str(srdf))
        folders = sorted({path.parent for path in folder.glob(requests)})
        self._folders = {path.name.removesuffix("_ur5"): path for path in folders}
        self.scenes = tuple(self._folders)

    def problems(self, scene: str, limit: int) -> Iterator[PathProblem]:
        """The first problems of a kind, at most so many."""
        for request_file in sorted(self._folders[scene].glob("request*.yaml"))[:limit]:
            digits = request_file.stem.removeprefix("request")
            scene_file = request_file.with_name(f"scene{digits}.yaml")
            world = yaml.safe_load(scene_file.read_text(encoding="utf-8"))["world"]
            request = yaml.safe_load(request_file.read_text(encoding="utf-8"))
            state = request["start_state"]["joint_state"]
            start = dict(zip(state["name"], state["position"], strict=True))
            wanted = request["goal_constraints"][0]["joint_constraints"]
            goal = {joint["joint_name"]: joint["position"] for joint in wanted}
            ends = [np.array([joints[name] for name in ARM_JOINTS], float) for joints in (start, goal)]
            contact, clearance = (
                self._checker(world, margin) for margin in (0.0, SceneSettings().arm_clearance)
            )
            if any(clearance.in_collision(end) for end in ends):
                clearance = contact
            yield PathProblem(scene, int(digits), ends[0], ends[1], contact, clearance)

    def _checker(self, world: dict[str, Any], margin: float) -> CollisionChecker:
        shapes = self._robot.copy()
        own = len(shapes.collisionPairs)
        for shape, T_world_shape in _obstacles(world):
            place = pin.SE3(T_world_shape)
            shapes.addGeometryObject(pin.GeometryObject(f"thing{shapes.ngeoms}", 0, 0, place, shape))
        for thing in range(self._links, shapes.ngeoms):
            for link in range(self._links):
                shapes.addCollisionPair(pin.CollisionPair(link, thing))
        parts = tuple(shape.name for shape in shapes.geometryObjects)
        margins = [0.0] * own + [margin] * (len(shapes.collisionPairs) - own)
        return CollisionChecker(self._model, shapes, parts, margins)


def _obstacles(world: dict[str, Any]) -> Iterator[tuple[coal.ShapeBase, Array]]:
    """Shapes and their (4, 4) poses in the frame of the world; MoveIt's `dimensions`."""
    for thing in world["collision_objects"]:
        T_world_thing = _pose(thing["pose"]) if "pose" in thing else np.eye(4)
        for primitive, pose in zip(thing["primitives"], thing["primitive_poses"], strict=True):
            size = primitive["dimensions"]
            shape = {
                "box": lambda size: coal.Box(*size),
                "cylinder": lambda size: coal.Cylinder(size[1], size[0]),
                "sphere": lambda size: coal.Sphere(size[0]),
            }[primitive["type"]](size)
            yield shape, T_world_thing @ _pose(pose)


def _pose(pose: dict[str, list[float]]) -> Array:
    return transform(Rotation.from_quat(pose["orientation"]).as_matrix(), pose["position"])


def solve(problem: PathProblem, timeout: float) -> Record:
    """One problem with the suite's path stage, and with RRT-Connect as OMPL sets it.

    `timeout` is processor time [s]. What was found counts as solved if it is free in steps of `FINE_STEP`.
    """
    checker, start, goal = problem.clearance, problem.start, problem.goal
    possible = not checker.in_collision(start) and not checker.in_collision(goal)

    def ours() -> Array | None:
        path = plan_path(checker, start, goal, timeout)
        return None if path is None else path(np.linspace(0.0, path.length, int(path.length / FINE_STEP) + 2))

    def plain() -> Array | None:  # with an end that is not free OMPL would wait for another one
        return rrt_connect(checker, start, goal, timeout=timeout) if possible else None

    return {
        "scene": problem.scene,
        "number": problem.number,
        "possible": possible,
        "ours": _measured(ours, problem.contact),
        "rrt_connect": _measured(plain, problem.contact),
    }


def _measured(work: Callable[[], Array | None], checker: CollisionChecker) -> Record:
    begin = time.thread_time()
    path = work()
    record: Record = {"ms": round(1e3 * (time.thread_time() - begin), 2), "found": path is not None}
    if path is None:
        return record | {"solved": False}
    states = densify(path, FINE_STEP)
    free = not any(checker.in_collision(state) for state in states)
    within = bool(((states >= checker.lower - 1e-9) & (states <= checker.upper + 1e-9)).all())
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    return record | {"solved": free and within, "length_rad": round(length, 3)}


def summarise(records: list[Record]) -> list[Record]:
    """One row per kind of scene, and one for all: share solved, processor time, length where both solved it."""
    names = [*dict.fromkeys(record["scene"] for record in records), "all"]
    return [
        {"scene": name, **_row([record for record in records if name in ("all", record["scene"])])}
        for name in names
    ]


def _row(records: list[Record]) -> Record:
    row: Record = {"problems": len(records), "possible": sum(record["possible"] for record in records)}
    both = [record for record in records if record["ours"]["solved"] and record["rrt_connect"]["solved"]]
    for method in ("ours", "rrt_connect"):
        spread = np.percentile([record[method]["ms"] for record in records], (50, 95))
        row[method] = {
            "solved": sum(record[method]["solved"] for record in records),
            "not_free": sum(record[method]["found"] and not record[method]["solved"] for record in records),
            "median_ms": round(float(spread[0]), 1),
            "p95_ms": round(float(spread[1]), 1),
            "length_rad": round(float(np.mean([r[method]["length_rad"] for r in both])), 2) if both else None,
        }
    return row
