"""The whole suite for an hour, with faults, restarts and hostile calls: python -m tests.soak --minutes 60 --out FOLDER

Writes `soak.json` (runs with their codes, memory of every node, /dev/shm) and `soak.png`. Exit code 1 if a run ended
otherwise than its disturbance explains, if a run hung, or if the memory of a node kept growing.
"""

from __future__ import annotations

import json
import os
import random
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import matplotlib
import numpy as np
import typer
from dgs_interfaces.action import MoveHand
from dgs_interfaces.srv import InjectFault, PredictGrasps, SimReset
from numpy.typing import NDArray
from scipy.stats import theilslopes
from std_srvs.srv import Trigger

from dgs_description.errors import ErrorCode
from dgs_description.paths import revision
from dgs_ros.cloud_msgs import numpy_to_cloud
from dgs_ros.shared_memory import segments
from tests.support.environment import end_tidily, reserved_domain_id
from tests.support.processes import group_members
from tests.support.ros_client import RosClient
from tests.support.suite import Run, Suite

HANG = 180.0
"""A run of two picks that takes longer hangs [s]."""
GROWTH = 50.0
"""More than this per hour in the second half of a node's life is a leak [MiB]: heaps fill up over dozens of picks.

The median of the slopes between all pairs of floors (Theil and Sen): a leak is steady, one large pick is a step."""
FLOOR = 3.0
"""What a node keeps is the least that it has in so many minutes: a search under way needs more for a moment."""
FINE = {ErrorCode.SUCCESS, ErrorCode.TASK_ATTEMPTS_USED_UP}
FAILED = FINE | {ErrorCode.TASK_ARM_FAILED}
STOPPED = FINE | {ErrorCode.TASK_STOPPED, ErrorCode.TASK_ARM_FAILED}


class Soak:
    """One soak: `step` until the time is up, then `report`. In its second half no node is started again."""

    def __init__(self, suite: Suite, seed: int, minutes: float) -> None:
        self._suite, self._rng = suite, random.Random(seed)
        self._begin = time.monotonic()
        self._calm_from = self._begin + 30 * minutes
        self.runs: list[dict[str, Any]] = []
        self.memory: list[dict[str, Any]] = []
        self._seen: dict[tuple[str, int], list[float]] = {}
        threading.Thread(target=self._watch_memory, name="memory", daemon=True).start()
        self._disturbances: list[tuple[str, set[ErrorCode], Callable[[], None]]] = [
            ("none", FINE, lambda: None),
            *(
                (f"restart {name}", codes, lambda name=name: self._restart(name))
                for name, codes in RESTARTS.items()
            ),
            *((fault, codes, lambda fault=fault: self._fault(fault)) for fault, codes in FAULTS.items()),
            ("/stop", STOPPED, lambda: self._trigger("/stop")),
            ("hostile calls", FINE, self._be_hostile),
        ]

    def step(self) -> None:
        """One table, with one disturbance at a random moment."""
        calm = time.monotonic() > self._calm_from
        possible = [d for d in self._disturbances if not (calm and d[0].startswith("restart"))]
        name, codes, disturb = self._rng.choice(possible)
        seed, objects = self._rng.randrange(2**32), self._rng.randint(1, 6)
        self._suite.wait_ready()
        self._fault("clear")
        end = time.monotonic() + HANG
        while not self._trigger(
            "/reset"
        ).success:  # until the executor has heard that the robot is well again
            assert time.monotonic() < end, "motion is not allowed again"
        self._suite.reset(seed, objects)
        run, begun = self._suite.clear(max_attempts=2, seed=seed), time.monotonic()
        time.sleep(self._rng.uniform(0.0, 12.0))
        disturbed = time.monotonic()
        disturb()
        code, message = self._end(run)
        ended = time.monotonic()
        entry = {"disturbance": name, "seed": seed, "objects": objects, "code": code, "message": message}
        entry |= {"seconds": round(ended - begun, 1), "after disturbance": round(ended - disturbed, 1)}
        self.runs.append(
            {**entry, "explained": code in codes or (code is None and name == "restart clear_table")}
        )
        self._measure()
        print(json.dumps(self.runs[-1]), flush=True)

    def _end(self, run: Run) -> tuple[int | None, str]:
        """Code and message; None for a task that was killed."""
        task = self._suite.nodes["clear_table"]
        begin = time.monotonic()
        while not run.future.done() and time.monotonic() - begin < HANG:
            if self._suite.nodes["clear_table"] is not task or run.server.lost():
                return None, "the task went"
            time.sleep(0.05)
        if not run.future.done():
            return -1, f"no end within {HANG:g} s"
        result = run.end()
        return int(result.error_code), result.message

    def _restart(self, name: str) -> None:
        self._suite.nodes[name].kill()
        time.sleep(self._rng.uniform(0.0, 3.0))
        self._suite.start(name)

    def _fault(self, fault: str) -> None:
        target = "index" if fault == "jam_finger" else ""
        request = InjectFault.Request(fault=fault, target=target, duration=self._rng.uniform(0.5, 5.0))
        self._suite.client.call(InjectFault, "/sim/inject_fault", request)

    def _trigger(self, name: str) -> Trigger.Response:
        return self._suite.client.call(Trigger, name, Trigger.Request())

    def _be_hostile(self) -> None:
        client, rng = self._suite.client, self._rng
        for cloud in (
            np.full((100, 3), np.nan),
            np.zeros((0, 3)),
            np.random.default_rng(1).normal(size=(50_000, 3)),
        ):
            request = PredictGrasps.Request(
                cloud=numpy_to_cloud(cloud, rng.choice(["base_link", "x" * 10**6]))
            )
            client.call(PredictGrasps, "/predict_grasps", request)
        for catalogue in ("/etc/passwd", "~nobody/x", "x" * 10_000):
            answer = client.call(SimReset, "/sim/reset", SimReset.Request(objects=3, catalogue=catalogue))
            assert answer.error_code == ErrorCode.SIM_CATALOGUE, answer
        names = [f"joint{k % 100}" for k in range(20_000)]
        result = client.run_action(
            MoveHand, "/dexhand/move", MoveHand.Goal(joint_names=names, positions=[0.0] * 20_000)
        )
        assert result.result.error_code == ErrorCode.HAND_JOINT_NAMES

    def _watch_memory(self) -> None:
        """Note what every node has: the least of a run, right after a trim, is what it really keeps."""
        while True:
            for name, node in list(self._suite.nodes.items()):
                with suppress(OSError):  # it has just ended
                    used = sum(_resident(pid) for pid in group_members(node.process.pid))
                    self._seen.setdefault((name, node.process.pid), []).append(round(used, 1))
            time.sleep(0.5)

    def _measure(self) -> None:
        minute = (time.monotonic() - self._begin) / 60
        for name, node in self._suite.nodes.items():
            self._note(minute, name, node.process.pid, self._seen.pop((name, node.process.pid), []))
        used = sum(path.stat().st_blocks * 512 for path in segments()) / 2**20
        self._note(minute, "/dev/shm", 0, [round(used, 1)])

    def _note(self, minute: float, name: str, pid: int, used: list[float]) -> None:
        if used:
            entry = {"minute": minute, "node": name, "pid": pid, "MiB": min(used), "most": max(used)}
            self.memory.append(entry)

    def report(self, folder: Path) -> bool:
        """Write JSON and picture; whether all was well."""
        growth = {}
        for key in {(entry["node"], entry["pid"]) for entry in self.memory}:
            series = [(e["minute"], e["MiB"]) for e in self.memory if (e["node"], e["pid"]) == key]
            middle = (series[0][0] + series[-1][0]) / 2
            late = _floors([point for point in series if point[0] > middle])
            if len(late) >= 4:
                growth[f"{key[0]} {key[1]}"] = round(60 * float(theilslopes(late[:, 1], late[:, 0])[0]), 1)
        most = {
            name: max(e["most"] for e in self.memory if e["node"] == name) for name in _nodes(self.memory)
        }
        unexplained = [run for run in self.runs if not run["explained"]]
        summary = {
            "revision": revision(),
            "runs": len(self.runs),
            "codes": Counter(str(run["code"]) for run in self.runs),
            "unexplained": unexplained,
            "most memory [MiB]": most,
            "growth [MiB per hour]": growth,
        }
        details = {"run": self.runs, "memory": self.memory}
        (folder / "soak.json").write_text(json.dumps({**summary, **details}, indent=1) + "\n")
        _draw(self.memory, self.runs, folder / "soak.png")
        print(json.dumps(summary, indent=1))
        return not unexplained and all(rate < GROWTH for rate in growth.values())


RESTARTS = {
    "camera_node": FINE,
    "grasp_planner_node": FINE,
    "arm_executor_node": FINE | {ErrorCode.TASK_ARM_UNAVAILABLE},
    "hand_driver_node": FAILED,
    "sim_bridge_node": FAILED | {ErrorCode.TASK_NO_CLOUD},
    "clear_table": FINE,
}
"""Which codes a run may end with, by the node that is killed and started again meanwhile."""
FAULTS = {
    "freeze_camera": FINE | {ErrorCode.TASK_NO_CLOUD},
    "drop_joint_states": FAILED,
    "protective_stop": STOPPED,
    "emergency_stop": STOPPED,
    "jam_finger": FAILED,
    "abort_arm_goal": FAILED,
}


def _resident(pid: int) -> float:
    """Memory that belongs to a process alone [MiB]: Fast DDS's shared segments are counted once, in /dev/shm."""
    pages = Path(f"/proc/{pid}/statm").read_text().split()
    return (int(pages[1]) - int(pages[2])) * os.sysconf("SC_PAGE_SIZE") / 2**20


def _floors(series: list[tuple[float, float]]) -> NDArray:
    """(N, 2): the least value of every `FLOOR` minutes, beside its time."""
    spans: dict[int, list[tuple[float, float]]] = {}
    for point in series:
        spans.setdefault(int(point[0] / FLOOR), []).append(point)
    return np.array([min(points, key=lambda point: point[1]) for points in spans.values()])


def _nodes(memory: list[dict[str, Any]]) -> list[str]:
    return sorted({entry["node"] for entry in memory})


def _draw(memory: list[dict[str, Any]], runs: list[dict[str, Any]], path: Path) -> None:
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (above, below) = plt.subplots(2, 1, figsize=(9, 7))
    for name in _nodes(memory):
        points = [(e["minute"], e["MiB"]) for e in memory if e["node"] == name]
        above.plot(*zip(*points, strict=True), ".-", label=name)
    above.set(xlabel="time [min]", ylabel="memory [MiB]")
    above.legend(fontsize=8)
    counts = Counter((run["disturbance"], str(run["code"])) for run in runs)
    labels = [f"{disturbance}: {code}" for disturbance, code in sorted(counts)]
    below.barh(labels, [counts[key] for key in sorted(counts)])
    below.set(xlabel="runs by disturbance and code")
    below.tick_params(labelsize=6)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main(
    minutes: Annotated[float, typer.Option(help="How long.")] = 60.0,
    out: Annotated[Path, typer.Option(help="Folder for soak.json, soak.png and the logs.")] = Path(
        "runs/soak"
    ),
    seed: Annotated[int, typer.Option(help="Of scenes and disturbances.")] = 0,
) -> None:
    """Exit code 0 if every run ended as its disturbance explains and no node's memory kept growing."""
    end_tidily()
    out.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + 60 * minutes
    parameters = {"clear_table": {"restart_timeout": 90.0}}
    with (
        reserved_domain_id() as domain_id,
        RosClient(domain_id, "soak") as client,
        Suite(domain_id, client, out, parameters) as suite,
    ):
        soak = Soak(suite, seed, minutes)
        try:
            while time.monotonic() < end:
                soak.step()
        finally:
            well = soak.report(out)
    raise typer.Exit(0 if well else 1)


if __name__ == "__main__":
    typer.run(main)
