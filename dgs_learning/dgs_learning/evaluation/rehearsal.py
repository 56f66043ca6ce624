"""The robot protocol without ROS: the suite's own planner, task and executor on a simulated world, in one process.

Much faster than the whole suite, and nearly always the same: to find out what fails, and whether a change cures it.
What counts is the suite (`run_robot`). Missing here are the time that planning takes and all that runs beside it, the
bus and its delays, the arm's controller with its tolerances, and interruptions. What may differ from run to run are the
ways that the sampling planner finds: its random numbers go on from scene to scene of a process, and its time is
limited.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from dgs_arm_executor.execution import Execution
from dgs_arm_executor.executor_parameters import ArmExecutorParameters
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_plan import Wish
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.robot import Robot
from dgs_arm_executor.self_filter import without_robot
from dgs_arm_executor.timing import Trajectory
from dgs_arm_executor.watch import RobotWatch
from dgs_bringup.clear_table import ClearTable, ClearTableParameters, Next, Step
from dgs_bringup.summary import refused_looks, summarise
from dgs_bringup.table_look import MAX_GRASPS
from dgs_bringup.truth import TruthTracker
from dgs_description.cell import CELL, HOME_ARM
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, apply, inverse
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.paths import revision
from dgs_description.pick import closing_limit
from dgs_grasp_planner.cell_planner import predict_in_cell
from dgs_grasp_planner.load import planner_with
from dgs_grasp_planner.planner_parameters import PlannerParameters
from dgs_grasp_planner.propose.dgs_net import DgsNet
from dgs_grasp_planner.scene import Planner, PlanRequest
from dgs_hand_driver.hand_state import HandCommand, HandState
from dgs_hand_driver.move_goal import DEFAULT_SPEED
from dgs_hand_driver.move_monitor import GraspMove, Move, PositionMove
from dgs_learning.evaluation.experiment import Row
from dgs_learning.evaluation.records import claim, follow
from dgs_learning.evaluation.robot import (
    finish_robot,
    scene_folder,
    scene_request,
    todo_and_done,
)
from dgs_learning.evaluation.robot_metrics import summarise_robot
from dgs_learning.parallel import Engine
from dgs_learning.planning.bullet_check import interpolate
from dgs_perception.depth_source import DepthSource
from dgs_perception.edges import cleaned
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.physics import PHYSICS
from dgs_sim_bridge.world.scenes import PlacedObject
from dgs_sim_bridge.world.world import World, random_scene

_STATES, _TRUTHS = 2, 24
"""Physics steps between two states of the robot, and two looks at the truth."""


class RehearsalRobot(Robot):
    """Arm, hand and camera of a simulated world, moved in the caller's thread; attributes as of `Robot`.

    Attributes:
        table_force: most that the robot pressed on table or bin, by stage [N].
    """

    def __init__(self, world: World, given: ArmExecutorParameters, seed: int, depth_from: str):
        """`seed`: of the camera's noise; `depth_from`: see `DepthSource`."""
        watch = RobotWatch(lambda: world.time, max_force=given.max_force, wait=self._wait)
        nobody: Any = None  # serves arm and hand: they are moved here
        super().__init__(given, watch, nobody, nobody, None, lambda _: ObstacleCloud.from_points(self.see()))
        self._source, self._world = DepthSource(depth_from), world
        self.truth = TruthTracker()
        self.table_force: dict[str, float] = {}
        self._stage = ""
        self._rng = np.random.default_rng(seed)
        self._steps = 0
        self._command = HandCommand()
        self._posture = HOME_ARM
        self._step(HOME_ARM, np.zeros(6))

    def enter(self, stage: str) -> None:
        """Nobody listens, but the forces are noted by stage."""
        self._stage = stage

    def see(self) -> Array:
        """(N, 3) points of the camera without the robot, in `base_link` [m]."""
        shot = self._world.snapshot().shot(D455Noise(), self._rng, self._source.imagers)
        depth = self._source(shot.depth, shot.left, shot.right, D455, D455Noise.baseline)
        seen = D455.deproject(cleaned(depth, D455)).astype(np.float64)
        points = apply(CELL.T_base_camera_optical, seen)
        low, high = CELL.cloud_bounds
        inside = np.isfinite(points).all(axis=1) & ((points > low) & (points < high)).all(axis=1)
        situation = self.watch.situation()
        return without_robot(points[inside], situation.arm_joints, situation.hand_joints)

    def move_arm(
        self,
        trajectory: Trajectory,
        *hand_shapes: Array,
        clear_from: float = np.inf,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        """Check and drive one trajectory. Raises DgsError SAFETY_ENVELOPE."""
        motion = self._checked(trajectory, hand_shapes)
        for positions, velocities in zip(*interpolate(motion, PHYSICS.time_step)[:2], strict=True):
            self._step(positions, velocities)
            meanwhile()

    def move_both(self, trajectory: Trajectory, hand_joints: Array) -> None:
        """Drive one trajectory while the hand goes to (J,) joints [rad]."""
        move = self._start_hand(hand_joints)
        self.move_arm(trajectory, self.watch.situation().hand_joints, hand_joints)
        self._finish_hand(move)

    def move_hand(
        self, joints: Array, closing: Any = None, uninterrupted: bool = False, quiet: bool = False
    ) -> None:
        """Bring the hand to (J,) joints [rad]; arguments as of `Robot.move_hand`. Raises DgsError with its codes."""
        self._finish_hand(self._start_hand(joints, closing))

    def _start_hand(self, joints: Array, closing: Any = None) -> Move:
        state, speed = self._hand_state(), self._given.shaping_speed if closing is None else DEFAULT_SPEED
        if closing is None:
            self._send(HandCommand("position", joints, speed))
            return PositionMove(state, joints, speed)
        self._send(HandCommand("admittance", joints, speed, np.asarray(closing)))
        return GraspMove(state, closing_limit(joints, closing), speed, closing)

    def _finish_hand(self, move: Move) -> None:
        while (outcome := move.update(self._hand_state())) is None:
            for _ in range(_STATES):
                self._step(self._posture, np.zeros(6))
        if outcome.code is not ErrorCode.SUCCESS:
            self._send(HandCommand("hold", outcome.state.positions, 1.0))
            raise DgsError(outcome.code, outcome.message)

    def _wait(self, seconds: float) -> None:
        for _ in range(math.ceil(seconds / PHYSICS.time_step)):
            self._step(self._posture, np.zeros(6))

    def _send(self, command: HandCommand) -> None:
        self._command = command
        self._world.hand.take(command)

    def _hand_state(self) -> HandState:
        positions, torques = self._world.hand.state()
        now, forces = self._world.time, self._world.hand.fingertip_forces()
        return HandState(positions, torques, self._command.mode, 0, now, now, self._steps, forces)

    def _step(self, positions: Array, velocities: Array) -> None:
        self._posture = positions
        self._world.arm.command(positions, velocities)
        self._world.step()
        self._steps += 1
        if self._steps % _STATES == 1:
            now = self._world.time
            self.watch.arm_state(self._world.arm_state().positions, now)
            self.watch.hand_state(*self._world.hand.state(), now)
            self.watch.force.measured(self._world.wrench()[:3], now)
            pressing = self._world.table_force()
            self.table_force[self._stage] = max(pressing, self.table_force.get(self._stage, 0.0))
        if self._steps % _TRUTHS == 1:
            states = self._world.object_states()
            self.truth.update(self._world.time, [s.name for s in states], [s.place for s in states])


class Rehearsal:
    """Clears one table as `/clear_table` does, one pick after the other, and home between them."""

    def __init__(
        self, objects: Sequence[PlacedObject], planner: Callable[[], Planner], seed: int, depth_from: str
    ):
        self._world = World(objects)
        self._given, self._planner = ArmExecutorParameters(), planner
        self._robot = RehearsalRobot(self._world, self._given, seed, depth_from)
        self._pick = PickPlanner(settings=self._given, scene_settings=self._given)
        self._task = ClearTable(ClearTableParameters(), seed)
        self._outcomes: dict[int, bool] = {}
        self._told: list[tuple[str, str]] = []
        """Stages and messages, as `/clear_table` has them in its feedback."""

    def run(self, folder: Path) -> dict[str, Any]:
        """Clear it, leave a picture of the end in the folder; the summary is as `dgs_bringup` makes it."""
        begun, started = time.monotonic(), self._world.time
        try:
            end = self._clear()
            snapshot = self._world.snapshot()
            Image.fromarray(snapshot.colour(snapshot.shot().truth)).save(folder / "after.png")
        finally:
            self._world.close()
        records = [
            {
                "score": round(float(record.grasp.score), 4),
                "success": self._outcomes.get(record.attempt, record.success),
                "code": record.code,
                "message": record.message,
                "seconds": record.stage_times,
                "source": str(record.grasp.source),
            }
            for record in self._task.records
        ]
        return summarise(
            records,
            self._robot.truth.places,
            time.monotonic() - begun,
            simulated_seconds=round(self._world.time - started, 2),
            refusals=refused_looks(self._told),
            table_force={stage: round(force, 1) for stage, force in self._robot.table_force.items() if force},
            hand=HAND.name,
            error_code=int(end.code),
            message=end.message,
            revision=revision(),
        )

    def _clear(self) -> Step:
        task = self._task
        while True:
            if (halt := self._bring_home()) is not None:
                return halt
            code, message, candidates = self._predict()
            step = task.after_prediction(code, message, candidates)
            while step.next is Next.EXECUTE:
                step = self._execute(candidates, step.indices)
            if step.next is Next.END:
                last = step.code is ErrorCode.TASK_ATTEMPTS_USED_UP
                return (self._bring_home() if last else None) or step

    def _bring_home(self) -> Step | None:
        home = self._execution().go_home()
        return self._task.after_homing(int(home.code), home.message, home.object_released)

    def _predict(self) -> tuple[int, str, GraspSet]:
        failed = inverse(CELL.T_base_table) @ self._task.failed.poses
        request = PlanRequest(max_grasps=MAX_GRASPS, failed=failed)
        camera = CELL.T_base_camera_optical[:3, 3]
        self._told.append(("capture", ""))
        planner = self._planner()  # one that cannot be loaded makes no result
        try:
            points = self._robot.see()
            found = predict_in_cell(planner, points, camera, self._task.next_seed(), request)
        except DgsError as error:
            return int(error.code), error.message, GraspSet.empty()
        return int(ErrorCode.SUCCESS), "", found.grasps

    def _execute(self, candidates: GraspSet, offered: Sequence[int]) -> Step:
        attempts = self._task.attempts
        report = self._execution().pick(candidates[np.array(offered)], Wish())
        executed = offered[report.executed_index] if report.executed_index >= 0 else -1
        code, times = int(report.code), report.stage_times
        step = self._task.after_execution(code, report.message, executed, times, report.object_released)
        if executed >= 0:  # a push has the number of the grasp that follows it
            self._outcomes[attempts + 1] = self._robot.truth.end_attempt()
        self._told.append(("recorded" if executed >= 0 else "rejected", report.message))
        return step

    def _execution(self) -> Execution:
        return Execution(self._robot, self._pick, self._given)


def run_rehearsal(
    catalogue: Sequence[ObjectModel], row: Row, described: dict[str, Any], folder: Path, workers: int
) -> dict[str, Any]:
    """Run or finish a rehearsal and write `summary.json`; arguments and errors as of `run_robot`.

    Args:
        workers: processes, 0 = one per core.
    """
    described = {"protocol": "robot", "rehearsal": True, **described}
    claim(folder, described)
    todo, done = todo_and_done(folder, row.scenes)
    running = Engine(workers).run(_one, ((catalogue, row, n, folder) for n in todo))
    follow(running, len(todo), done, summarise_robot)
    return finish_robot(folder, described, row.scenes)


def _one(catalogue: Sequence[ObjectModel], row: Row, number: int, folder: Path) -> dict[str, Any]:
    """Clear the scene that the suite has for the same number, and keep what came of it."""
    seed, count = scene_request(row, number)
    planner = partial(_planner, row.models_dir, row.model)
    target = scene_folder(folder, number)
    unfinished = target.with_suffix(".unfinished")
    unfinished.mkdir(parents=True, exist_ok=True)
    placed = random_scene(catalogue, count, seed, row.condition.transparent)
    rehearsal = Rehearsal(placed, planner, seed, row.condition.depth_from)
    summary = rehearsal.run(unfinished) | {"seed": seed}
    (unfinished / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    unfinished.rename(target)
    return summary


@cache
def _planner(models_dir: Path, model: str) -> Any:
    """As the planner's node has it."""
    torch.set_num_threads(1)  # sums of several threads depend on their number
    given = PlannerParameters()
    network = DgsNet.from_weights(models_dir, model, given.score_threshold)
    return planner_with(network, given.proposers, given.settings(), given.push())
