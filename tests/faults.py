"""Injects every fault at every stage of real picks in the simulation, and writes what came of it.

    start_suite.sh --mode simulation -- \\
        python -m tests.faults --json docs/results/arm_faults.json --doc docs/arm_executor.md

Grasps come from /predict_grasps; the object and its place are the same in every trial. Exit code 1 if one was wrong.
"""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from dgs_interfaces.action import ClearTable, ExecuteGrasp, GoHome
from dgs_interfaces.msg import SimState
from dgs_interfaces.srv import InjectFault, PredictGrasps, SimReset
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger

from dgs_bringup.ros_session import RosSession, wait_until
from dgs_description.documents import fill_block
from dgs_description.errors import ErrorCode
from dgs_description.hand import HAND
from dgs_description.joints import ARM_JOINTS
from dgs_description.paths import today
from dgs_ros.base_node import LATCHED
from dgs_ros.joint_msgs import has_joints, positions_of
from dgs_ros.trajectory_msgs import seconds
from tests.support.fault_cases import (
    ARM_STAGES,
    CANCEL,
    FREEZE,
    LIMIT,
    STAGES,
    STOP,
    Case,
    Outcome,
    all_cases,
    document_table,
    table,
)

REPEATS = 4
"""Picks that must succeed in a row before faults are tried on a scene, and tries to reach the stage of a fault."""
_SCENES = 20
"""Scenes among which one with such picks is looked for."""
_STANDING, _OPEN, _HOLDING = 2e-3, 0.15, 0.05
"""Arm: way in a step of 0.1 s; hand: every flexion below; flexion may give so much [rad]."""
_TIMEOUT = 240.0
"""Wait for the end of a pick, and for simulated time to pass [s]."""


class Bench:
    """The running suite as the trials see it.

    Attributes:
        seed: of the scene.
        arm, hand: newest joints, (6,) and (J,) [rad].
        truth: newest ground truth.
        cloud_time: stamp of the newest cloud [s].
        camera_code: what the camera node last said about itself, 0 = it works.
    """

    def __init__(self, session: RosSession, seed: int) -> None:
        """Subscribe; `seed` is of the first scene that is tried."""
        self.session, self.seed = session, seed
        self.arm, self.hand, self.truth = np.zeros(6), np.zeros(HAND.joint_count), SimState()
        self.cloud_time = 0.0
        self.camera_code = 0
        self._grasps = PredictGrasps.Response()
        subscribe = session.node.create_subscription
        subscribe(JointState, "/joint_states", self._on_joints, 1)
        subscribe(JointState, "/dexhand/joint_states", self._on_joints, 1)
        subscribe(SimState, "/sim/state", self._on_news, LATCHED)
        subscribe(PointCloud2, "/dgs/cloud", self._on_news, qos_profile_sensor_data)
        subscribe(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_joints(self, msg: JointState) -> None:
        if has_joints(msg, ARM_JOINTS):
            self.arm = positions_of(msg, ARM_JOINTS)
        elif has_joints(msg, HAND.joints):
            self.hand = positions_of(msg, HAND.joints)

    def _on_news(self, msg: SimState | PointCloud2) -> None:
        if isinstance(msg, SimState):
            self.truth = msg
        else:
            self.cloud_time = seconds(msg.header.stamp)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            if status.name.startswith("camera_node"):
                self.camera_code = int({v.key: v.value for v in status.values}.get("code", 0))

    @property
    def time(self) -> float:
        """Simulated [s]."""
        return float(self.session.node.get_clock().now().nanoseconds * 1e-9)

    @property
    def flexion(self) -> np.ndarray:
        """(F, 2) pitch and middle joints of the fingers [rad]."""
        return np.asarray(HAND.split(self.hand)[:, 1:3])

    def pause(self, duration: float) -> None:
        """Let simulated time [s] pass."""
        end = self.time + duration
        if not wait_until(lambda: self.time >= end, _TIMEOUT, 0.01):
            raise TimeoutError("simulated time stands still")

    def fault(self, name: str, target: str = "") -> None:
        """Inject a fault until `clear`."""
        self._simulator(InjectFault, "/sim/inject_fault", fault=name, target=target)

    def _simulator(self, kind: Any, name: str, **request: Any) -> None:
        answer = self.session.call(kind, name, kind.Request(**request))
        if answer.error_code:
            raise RuntimeError(answer.message)

    def trigger(self, name: str) -> bool:
        """Whether /stop or /reset worked."""
        return bool(self.session.call(Trigger, name, Trigger.Request()).success)

    def fresh_scene(self) -> None:
        """All faults off, motion allowed, the one object at its place, arm at home, and a cloud of that."""
        self.fault("clear")
        wait_until(lambda: self.trigger("/reset"), 10.0, 0.2)
        self._simulator(SimReset, "/sim/reset", objects=1, seed=self.seed)
        since = self.time + 0.3
        if not wait_until(lambda: self.cloud_time >= since, _TIMEOUT):
            raise TimeoutError("no cloud after the reset")
        self.pause(0.2)

    def choose_scene(self) -> None:
        """A scene with predicted grasps of which one succeeds `REPEATS` times in a row; every trial uses them."""
        request = PredictGrasps.Request(max_grasps=32, seed=1)
        for _ in range(_SCENES):
            self.fresh_scene()
            self._grasps = self.session.call(PredictGrasps, "/predict_grasps", request)
            if self._grasps.error_code == 0 and all(self._pick_succeeds() for _ in range(REPEATS)):
                return
            self.seed += 1
        raise RuntimeError(f"no {REPEATS} picks in a row succeeded in {_SCENES} scenes")

    def _pick_succeeds(self) -> bool:
        self.fresh_scene()
        result = self.pick().end()
        typer.echo(f"scene {self.seed}: {result.error_code} {result.message}")
        return bool(result.error_code == ErrorCode.SUCCESS)

    def pick(self) -> Pick:
        """Begin a pick."""
        goal = ExecuteGrasp.Goal(header=self._grasps.header, grasps=self._grasps.grasps)
        return Pick(self.session, goal)

    def code_of(self, kind: Any, name: str, goal: Any) -> int:
        """Send a goal, wait for its end; the error code."""
        result = self.session.send(kind, name, goal).get_result_async()
        return int(self.session.wait(result, _TIMEOUT, name).result.error_code)


class Pick:
    """A goal of /execute_grasp under way."""

    def __init__(self, session: RosSession, goal: ExecuteGrasp.Goal) -> None:
        self._session, self._news = session, threading.Condition()
        self._seen: list[tuple[str, float]] = []
        self._handle = session.send(ExecuteGrasp, "/execute_grasp", goal, self._note)
        self._result = self._handle.get_result_async()
        self._result.add_done_callback(lambda _: self._wake())
        self.cancel = self._handle.cancel_goal_async

    def _note(self, message: Any) -> None:
        self._seen.append((message.feedback.stage, message.feedback.progress))
        self._wake()

    def _wake(self) -> None:
        with self._news:
            self._news.notify_all()

    def wait_for(self, stage: str) -> bool:
        """True when the stage is under way, False if the pick ends before."""
        least = 0.1 if stage in ARM_STAGES else -1.0

        def under_way() -> bool:
            return bool(self._seen) and self._seen[-1][0] == stage and self._seen[-1][1] > least

        with self._news:
            self._news.wait_for(lambda: under_way() or self._result.done(), _TIMEOUT)
            return under_way() and not self._result.done()

    def end(self) -> ExecuteGrasp.Result:
        """The result."""
        return self._session.wait(self._result, _TIMEOUT, "/execute_grasp").result


def trial(bench: Bench, case: Case) -> Outcome:
    """One case from a fresh scene to the next pick; a pick that fails before the stage by itself is made again."""
    outcome = Outcome(case)
    for _ in range(REPEATS):
        bench.fresh_scene()
        pick = bench.pick()
        outcome.reached = pick.wait_for(case.stage)
        if outcome.reached:
            break
        outcome.message = pick.end().message
    else:
        return outcome
    began = bench.time
    _strike(bench, pick, case)
    result = pick.end()
    outcome.answered = round(bench.time - began, 3)
    outcome.code, outcome.message = result.error_code, result.message
    if case.fault == "drop_joint_states":
        bench.fault("clear")  # or nobody could see the arm
    outcome.settled = _settled(bench, case, began)
    held = bench.arm.copy()
    if case.fault not in (CANCEL, STOP):
        bench.fault("clear")
    refused = not case.latches or bench.code_of(GoHome, "/go_home", GoHome.Goal()) == case.codes[0]
    bench.pause(0.5)
    outcome.stood = refused and float(np.abs(bench.arm - held).max()) < 5 * _STANDING
    outcome.truthful = result.object_released == ("bin" in bench.truth.places)
    bench.fault("clear")
    wait_until(lambda: bench.trigger("/reset"), 10.0, 0.2)
    outcome.home = bench.code_of(GoHome, "/go_home", GoHome.Goal())
    bench.fresh_scene()
    following = bench.pick().end()
    outcome.next_pick, outcome.next_message = following.error_code, following.message
    return outcome


def _strike(bench: Bench, pick: Pick, case: Case) -> None:
    if case.fault == CANCEL:
        pick.cancel()
    elif case.fault == STOP:
        bench.trigger("/stop")
    else:
        bench.fault(case.fault, case.target)


def _settled(bench: Bench, case: Case, began: float) -> float | None:
    """Simulated seconds from `began` until arm and hand were in their end state, None if they never were."""
    while bench.time < began + 3 * LIMIT:
        arm, flexion, now = bench.arm.copy(), bench.flexion.copy(), bench.time
        bench.pause(0.1)
        still = float(np.abs(bench.arm - arm).max()) < _STANDING
        change = float(np.abs(bench.flexion - flexion).max())
        is_open = float(bench.flexion.max()) < _OPEN
        right = {"open": is_open, "holds": not is_open and change < _HOLDING, "any": change < _HOLDING}
        if still and right[case.hand]:
            return round(now - began, 3)
    return None


def frozen_camera(bench: Bench) -> dict[str, Any]:
    """What the camera node says, a run of /clear_table without pictures, and one after the camera is back."""
    bench.fresh_scene()
    began, stood, goal = time.monotonic(), bench.arm.copy(), ClearTable.Goal(max_attempts=1)
    bench.fault(FREEZE)
    told = wait_until(lambda: bench.camera_code == ErrorCode.CAMERA_SILENT, 20.0)
    diagnosed = round(time.monotonic() - began, 1) if told else None
    began = time.monotonic()
    code = bench.code_of(ClearTable, "/clear_table", goal)
    answered, moved = time.monotonic() - began, float(np.abs(bench.arm - stood).max())
    bench.fault("clear")
    following = bench.code_of(ClearTable, "/clear_table", goal)
    right = told and code == ErrorCode.TASK_NO_CLOUD and moved < _STANDING
    return {
        "diagnosed_wall_seconds": diagnosed,
        "code": code,
        "wall_seconds": round(answered, 1),
        "arm_moved_rad": round(moved, 4),
        "next_run": following,
        "right": right and following in (0, ErrorCode.TASK_ATTEMPTS_USED_UP),
    }


def main(
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the results here.")] = None,
    doc: Annotated[Path | None, typer.Option(help="Write the table between this document's marks.")] = None,
    seed: Annotated[int, typer.Option(help="Of the first scene that is tried.")] = 0,
    repeat: Annotated[int, typer.Option(min=1, help="Trials per fault and stage.")] = 1,
    only: Annotated[str, typer.Option(help="Faults, separated by commas.")] = "",
    at: Annotated[str, typer.Option(help="Stages, separated by commas.")] = "",
) -> None:
    """Inject every fault at every stage of real picks; print and write the table."""
    faults, stages = (set(filter(None, text.split(","))) for text in (only, at))
    unknown = (faults - {FREEZE, *(case.fault for case in all_cases())}) | (stages - set(STAGES))
    if unknown:
        raise typer.BadParameter(f"no such fault or stage: {', '.join(sorted(unknown))}")
    wanted = [c for c in all_cases() if c.fault in (faults or {c.fault}) and c.stage in (stages or {c.stage})]
    cases = wanted * repeat
    outcomes: list[Outcome] = []
    with RosSession("faults", use_sim_time=True) as session:
        bench = Bench(session, seed)
        bench.choose_scene()
        for number, case in enumerate(cases, 1):
            outcomes.append(trial(bench, case))
            problems = outcomes[-1].problems() or ["right"]
            typer.echo(f"{number}/{len(cases)} {case.name} at {case.stage}: {', '.join(problems)}")
        camera = frozen_camera(bench) if FREEZE in faults or not faults | stages else None
    right = sum(not outcome.problems() for outcome in outcomes)
    report = {
        "date": today(),
        "seed": bench.seed,
        "limit_s": LIMIT,
        "trials": len(outcomes),
        "right": right,
        "faults": table(outcomes),
        "freeze_camera": camera,
    }
    text = json.dumps(report, indent=2)
    typer.echo(text)
    if json_file is not None:
        json_file.write_text(text + "\n", encoding="utf-8")
    if doc is not None:
        fill_block(doc, "faults", document_table(report))
    raise typer.Exit(int(right < len(outcomes) or (camera is not None and not camera["right"])))


if __name__ == "__main__":
    typer.run(main)
