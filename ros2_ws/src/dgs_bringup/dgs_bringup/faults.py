"""Injects every fault at every stage of real picks in the simulation, and writes what came of it.

    start_suite.sh --mode simulation -- \\
        python -m dgs_bringup.faults --json docs/results/arm_faults.json --doc docs/arm_executor.md

Grasps come from /predict_grasps; the object and its place are the same in every trial. Exit code 1 if one was wrong.
"""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from dgs_interfaces.action import ClearTable, ExecuteGrasp, GoHome
from dgs_interfaces.msg import SimState
from dgs_interfaces.srv import InjectFault, PredictGrasps, SimReset
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger

from dgs_bringup.fault_cases import CANCEL, STAGES, STOP, Case, Outcome, all_cases, document_table, table
from dgs_bringup.ros_session import RosSession, wait_until
from dgs_description.documents import fill_block
from dgs_description.errors import ErrorCode
from dgs_description.joints import ARM_JOINTS, HAND_JOINTS
from dgs_ros.base_node import SafeActionClient
from dgs_ros.joint_msgs import has_joints, positions_of

LIMIT = 2.0
"""Answer and end state must be there within so much simulated time [s]."""
REPEATS = 4
"""Picks that must succeed in a row before faults are tried on a scene, and tries to reach the stage of a fault."""
_STANDING, _OPEN, _HOLDING = 2e-3, 0.15, 0.05
"""Arm: way in a step of 0.1 s; hand: every flexion below; flexion may give so much [rad]."""
_TIMEOUT = 240.0
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Bench:
    """The running suite as the trials see it.

    Attributes:
        seed: of the scene.
        arm, hand: newest joints, (6,) and (20,) [rad].
        truth: newest ground truth.
        cloud_time: stamp of the newest cloud [s].
        camera_code: what the camera node last said about itself, 0 = it works.
    """

    def __init__(self, session: RosSession, seed: int) -> None:
        """Subscribe; `seed` is of the first scene that is tried."""
        self._session, self._node, self.seed = session, session.node, seed
        self.arm, self.hand, self.truth = np.zeros(6), np.zeros(20), SimState()
        self.cloud_time = 0.0
        self.camera_code = 0
        self._grasps: Any = None
        self._clients: dict[str, Any] = {}
        node = self._node
        node.create_subscription(JointState, "/joint_states", self._on_arm, 1)
        node.create_subscription(JointState, "/dexhand/joint_states", self._on_hand, 1)
        node.create_subscription(SimState, "/sim/state", self._on_truth, _LATCHED)
        node.create_subscription(PointCloud2, "/dgs/cloud", self._on_cloud, qos_profile_sensor_data)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._execute = SafeActionClient(node, ExecuteGrasp, "/execute_grasp")
        self._home = SafeActionClient(node, GoHome, "/go_home")
        self._clear = SafeActionClient(node, ClearTable, "/clear_table")

    def _on_arm(self, msg: JointState) -> None:
        if has_joints(msg, ARM_JOINTS):
            self.arm = positions_of(msg, ARM_JOINTS)

    def _on_hand(self, msg: JointState) -> None:
        self.hand = positions_of(msg, HAND_JOINTS)

    def _on_truth(self, msg: SimState) -> None:
        self.truth = msg

    def _on_cloud(self, msg: PointCloud2) -> None:
        self.cloud_time = _seconds(msg.header.stamp)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            if status.name.startswith("camera_node"):
                self.camera_code = int({v.key: v.value for v in status.values}.get("error_code", 0))

    @property
    def time(self) -> float:
        """Simulated [s]."""
        return float(self._node.get_clock().now().nanoseconds * 1e-9)

    def pause(self, seconds: float) -> None:
        """Let simulated time pass."""
        end = self.time + seconds
        if not wait_until(lambda: self.time >= end, _TIMEOUT, 0.01):
            raise TimeoutError("simulated time stands still")

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Answer of a service."""
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, name)
        client = self._clients[name]
        if not wait_until(client.service_is_ready, 30.0):
            raise TimeoutError(f"nobody serves {name}")
        return self._session.wait(client.call_async(request), _TIMEOUT, name)

    def fault(self, name: str, target: str = "") -> None:
        """Inject a fault until `clear`."""
        answer = self.call(InjectFault, "/sim/inject_fault", InjectFault.Request(fault=name, target=target))
        if answer.error_code:
            raise RuntimeError(answer.message)

    def reset(self) -> bool:
        """All faults off, motion allowed again."""
        self.fault("clear")
        return wait_until(lambda: self.call(Trigger, "/reset", Trigger.Request()).success, 10.0, 0.2)

    def fresh_scene(self) -> None:
        """The one object at its place, arm at home, and a cloud of that."""
        answer = self.call(SimReset, "/sim/reset", SimReset.Request(objects=1, seed=self.seed))
        if answer.error_code:
            raise RuntimeError(answer.message)
        since = self.time + 0.3
        if not wait_until(lambda: self.cloud_time >= since, _TIMEOUT):
            raise TimeoutError("no cloud after the reset")
        self.pause(0.2)

    def choose_scene(self, tries: int = 20) -> None:
        """A scene with predicted grasps of which one succeeds `REPEATS` times in a row; every trial uses them."""
        for _ in range(tries):
            self.reset()
            self.fresh_scene()
            answer = self.call(PredictGrasps, "/predict_grasps", PredictGrasps.Request(max_grasps=32, seed=1))
            self._grasps = answer
            if answer.error_code == 0 and all(self._pick_succeeds() for _ in range(REPEATS)):
                return
            self.seed += 1
        raise RuntimeError(f"no {REPEATS} picks in a row succeeded in {tries} scenes")

    def _pick_succeeds(self) -> bool:
        self.fresh_scene()
        result = self.start().end()
        print(f"scene {self.seed}: {result.error_code} {result.message}", flush=True)
        return bool(result.error_code == ErrorCode.SUCCESS)

    def start(self) -> Pick:
        """Begin a pick."""
        return Pick(self._session, self._execute, self._grasps)

    def go_home(self) -> int:
        """Error code of the way home."""
        handle = self._session.wait(self._home.send_goal_async(GoHome.Goal()), 30.0, "/go_home")
        code: int = self._session.wait(handle.get_result_async(), _TIMEOUT, "/go_home").result.error_code
        return code

    def frozen_camera(self) -> dict[str, Any]:
        """What the camera node says, a run of /clear_table without pictures, and one after the camera is back."""
        self.reset()
        self.fresh_scene()
        codes, began, stood = [], time.monotonic(), self.arm.copy()
        self.fault("freeze_camera")
        diagnosed = None
        if wait_until(lambda: self.camera_code == ErrorCode.CAMERA_SILENT, 20.0, 0.02):
            diagnosed = round(time.monotonic() - began, 1)
        began = time.monotonic()
        for _ in range(2):
            goal = ClearTable.Goal(max_attempts=1)
            handle = self._session.wait(self._clear.send_goal_async(goal), 30.0, "/clear_table")
            codes.append(
                self._session.wait(handle.get_result_async(), _TIMEOUT, "/clear_table").result.error_code
            )
            if len(codes) == 1:
                seconds, moved = time.monotonic() - began, float(np.abs(self.arm - stood).max())
                self.fault("clear")
        told = diagnosed is not None and codes[0] == ErrorCode.TASK_NO_CLOUD
        right = told and moved < _STANDING and codes[1] in (0, ErrorCode.TASK_ATTEMPTS_USED_UP)
        return {
            "diagnosed_wall_seconds": diagnosed,
            "code": codes[0],
            "wall_seconds": round(seconds, 1),
            "arm_moved_rad": round(moved, 4),
            "next_run": codes[1],
            "right": right,
        }


class Pick:
    """A goal under way."""

    def __init__(self, session: RosSession, client: Any, grasps: Any) -> None:
        self._session, self._news = session, threading.Condition()
        self._seen: list[str] = []
        self._progress = 0.0
        goal = ExecuteGrasp.Goal(header=grasps.header, grasps=grasps.grasps)
        sent = client.send_goal_async(goal, feedback_callback=self._note)
        self._handle = session.wait(sent, 30.0, "/execute_grasp")
        self._result = self._handle.get_result_async()

    def _note(self, message: Any) -> None:
        with self._news:
            if not self._seen or self._seen[-1] != message.feedback.stage:
                self._seen.append(message.feedback.stage)
            self._progress = message.feedback.progress
            self._news.notify_all()

    def wait_for(self, stage: str) -> bool:
        """True when the stage is under way, False if the pick ends before."""
        end = time.monotonic() + _TIMEOUT
        while time.monotonic() < end and not self._result.done():
            with self._news:
                self._news.wait(0.05)
                under_way = self._progress > 0.1 or stage in ("planning", "pre_grasp", "close", "release")
                if self._seen and self._seen[-1] == stage and under_way:
                    return True
        return False

    @property
    def ended(self) -> bool:
        """Whether the result is there."""
        return bool(self._result.done())

    def cancel(self) -> None:
        """Ask for the end."""
        self._handle.cancel_goal_async()

    def end(self) -> ExecuteGrasp.Result:
        """The result."""
        return self._session.wait(self._result, _TIMEOUT, "/execute_grasp").result


def trial(bench: Bench, case: Case) -> Outcome:
    """One case from a fresh scene to the next pick; a pick that fails before the stage by itself is made again."""
    outcome = Outcome(case)
    for _ in range(REPEATS):
        bench.reset()
        bench.fresh_scene()
        pick = bench.start()
        outcome.reached = pick.wait_for(case.stage)
        if outcome.reached:
            break
        outcome.message = pick.end().message
    else:
        return outcome
    began = bench.time
    _strike(bench, pick, case)
    wait_until(lambda: pick.ended, _TIMEOUT, 0.005)
    outcome.answered = round(bench.time - began, 3)
    result = pick.end()
    outcome.code, outcome.message = result.error_code, result.message
    if case.fault == "drop_joint_states":
        bench.fault("clear")  # or nobody could see the arm
    outcome.settled = _settled(bench, case, began)
    held = bench.arm.copy()
    if case.fault not in (CANCEL, STOP):
        bench.fault("clear")
    refused = not case.latches or bench.go_home() == case.codes[0]
    bench.pause(0.5)
    outcome.stood = refused and float(np.abs(bench.arm - held).max()) < 5 * _STANDING
    outcome.truthful = result.object_released == ("bin" in bench.truth.places)
    bench.reset()
    outcome.home = bench.go_home()
    bench.fresh_scene()
    following = bench.start().end()
    outcome.next_pick, outcome.next_message = following.error_code, following.message
    return outcome


def _strike(bench: Bench, pick: Pick, case: Case) -> None:
    if case.fault == CANCEL:
        pick.cancel()
    elif case.fault == STOP:
        bench.call(Trigger, "/stop", Trigger.Request())
    else:
        bench.fault(case.fault, case.target)


def _settled(bench: Bench, case: Case, began: float) -> float | None:
    """Simulated seconds from `began` until arm and hand were in their end state, None if they never were."""
    while bench.time < began + 3 * LIMIT:
        arm, flexion, now = bench.arm.copy(), _flexion(bench.hand), bench.time
        bench.pause(0.1)
        still = float(np.abs(bench.arm - arm).max()) < _STANDING
        change = float(np.abs(_flexion(bench.hand) - flexion).max())
        is_open = float(_flexion(bench.hand).max()) < _OPEN
        right = {"open": is_open, "holds": not is_open and change < _HOLDING, "any": change < _HOLDING}[
            case.hand
        ]
        if still and right:
            return round(now - began, 3)
    return None


def _flexion(hand: np.ndarray) -> np.ndarray:
    return np.asarray(hand.reshape(5, 4)[:, 1:3])


def _seconds(stamp: Any) -> float:
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def main() -> int:
    """Run the trials, print and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path, help="write the results here")
    parser.add_argument("--doc", type=Path, help="write the table between the marks of this document")
    parser.add_argument("--seed", type=int, default=0, help="of the first scene that is tried")
    parser.add_argument("--repeat", type=int, default=1, help="trials per fault and stage")
    parser.add_argument("--only", default="", help="faults, separated by commas")
    parser.add_argument("--at", default="", help="stages, separated by commas")
    given = parser.parse_args()
    wanted, stages = (set(filter(None, text.split(","))) for text in (given.only, given.at))
    unknown = (wanted - {"freeze_camera", *(case.fault for case in all_cases())}) | (stages - set(STAGES))
    if unknown:
        parser.error(f"no such fault or stage: {', '.join(sorted(unknown))}")
    cases = [
        case
        for case in all_cases()
        if (not wanted or case.fault in wanted) and (not stages or case.stage in stages)
    ] * given.repeat
    outcomes: list[Outcome] = []
    with RosSession("faults", use_sim_time=True) as session:
        bench = Bench(session, given.seed)
        bench.choose_scene()
        for number, case in enumerate(cases, 1):
            outcomes.append(trial(bench, case))
            problems = outcomes[-1].problems(LIMIT) or ["right"]
            print(f"{number}/{len(cases)} {case.name} at {case.stage}: {', '.join(problems)}", flush=True)
        everything = not wanted and not stages
        camera = bench.frozen_camera() if everything or "freeze_camera" in wanted else None
        rows, seed = table(outcomes, LIMIT), bench.seed
    right = sum(not outcome.problems(LIMIT) for outcome in outcomes)
    report = {
        "date": datetime.now(UTC).date().isoformat(),
        "seed": seed,
        "limit_s": LIMIT,
        "trials": len(outcomes),
        "right": right,
        "faults": rows,
        "freeze_camera": camera,
    }
    print(json.dumps(report, indent=2))
    if given.json is not None:
        given.json.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    if given.doc is not None:
        fill_block(given.doc, "faults", document_table(report))
    return int(right < len(outcomes) or (camera is not None and not camera["right"]))


if __name__ == "__main__":
    sys.exit(main())
