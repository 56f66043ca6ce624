"""Clears a simulated table with the running suite and writes a run folder (see scripts/demo.sh)."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dgs_interfaces.action import ClearTable
from dgs_interfaces.srv import PredictGrasps, SimReset
from PIL import Image
from rich.console import Console

from dgs_bringup.animation import write_gif
from dgs_bringup.prediction_picture import draw_prediction
from dgs_bringup.ros_session import RosSession, wait_until
from dgs_bringup.run_recorder import RunRecorder
from dgs_bringup.summary import Attempt, Refusals, RunSummary, git_revision
from dgs_description.errors import ErrorCode
from dgs_ros.base_node import SafeActionClient

EXIT_OK, EXIT_FAILED, EXIT_TIME = 0, 1, 5
COMPLETED = (ErrorCode.SUCCESS, ErrorCode.TASK_ATTEMPTS_USED_UP)
GRACE = 45.0
"""After the time limit, a running grasp may take so long to be cancelled before the demo gives up [s]."""


@dataclass(frozen=True)
class Settings:
    """What the command line says."""

    seed: int
    objects: int
    catalogue: str
    out: Path
    time_limit: float
    max_attempts: int
    bag: bool


class Demo:
    """One run against nodes that are ready."""

    def __init__(self, settings: Settings, session: RosSession, console: Console) -> None:
        """Create the clients."""
        self.settings = settings
        self.stop = threading.Event()
        self._session = session
        self._console = console
        self._start = time.monotonic()
        self._recorder = RunRecorder(session.node)
        self._task = SafeActionClient(session.node, ClearTable, "/clear_table")
        self._outcomes: list[bool] = []
        self._refusals = Refusals()
        self._last_line = ("", 0)
        self._model = ""

    def run(self) -> int:
        """Do everything; returns the exit code."""
        self._reset()
        self._save("before.png", self._recorder.picture())
        with CloudBag(self.settings.out, self.settings.bag):
            self._predict_once()
            self._recorder.filming = True
            begin, simulated = time.monotonic(), self._recorder.truth.time
            result = self._clear_table()
            seconds, simulated = time.monotonic() - begin, self._recorder.truth.time - simulated
            self._recorder.filming = False
        self._save_last_picture()
        frames = write_gif(self.settings.out / "run.gif", self._recorder.frames)
        self._line("save", f"animation of {frames} frames")
        summary = self._summarise(result, seconds, simulated)
        summary.write(self.settings.out / "summary.json")
        end = f"seed {summary.seed} ended ({summary.error_code}): {summary.message}"
        self._console.print(end, markup=False, highlight=False, soft_wrap=True)
        self._console.print(summary.table())
        self._console.print(f"run folder: {self.settings.out}", soft_wrap=True)
        return EXIT_OK if self._completed(result) else EXIT_FAILED

    def _reset(self) -> None:
        s = self.settings
        request = SimReset.Request(seed=s.seed, objects=s.objects, catalogue=s.catalogue)
        answer = self._call(SimReset, "/sim/reset", request, timeout=60.0)
        if answer.error_code != 0:
            raise RuntimeError(f"/sim/reset refused ({answer.error_code}): {answer.message}")
        truth = self._recorder.truth
        if not wait_until(lambda: set(truth.places) == set(answer.object_names), 20.0):
            raise TimeoutError("/sim/state does not show the new scene within 20 s")
        self._line("reset", f"seed {s.seed}: {', '.join(answer.object_names)}")

    def _predict_once(self) -> None:
        """A prediction for the picture; the task makes its own."""
        cloud, image = self._recorder.cloud(), self._recorder.picture()
        request = PredictGrasps.Request(cloud=cloud, seed=self.settings.seed, max_grasps=200)
        answer = self._call(PredictGrasps, "/predict_grasps", request, timeout=90.0)
        self._model = f"{answer.model_id} {answer.model_sha256[:12]}".strip()
        if answer.error_code == ErrorCode.SUCCESS:
            times = ", ".join(f"{stage.stage} {stage.seconds:.2f} s" for stage in answer.stage_times)
            self._line("predict", f"{len(answer.grasps)} grasps from {answer.points_in} points ({times})")
        else:
            self._line("predict", f"({answer.error_code}) {answer.message}")
        picture, overlay = draw_prediction(cloud, image, self._recorder.intrinsics(), answer.grasps)
        self._save("grasps.png", picture)
        self._save("grasps_camera.png", overlay)

    def _clear_table(self) -> Any:
        if not self._task.wait_for_server(timeout_sec=10.0):
            raise TimeoutError("nobody serves /clear_table")
        goal = ClearTable.Goal(seed=self.settings.seed, max_attempts=self.settings.max_attempts)
        sent = self._task.send_goal_async(goal, feedback_callback=self._on_feedback)
        handle = self._session.wait(sent, 10.0, "/clear_table")
        result = handle.get_result_async()
        wait_until(lambda: result.done() or self.stop.is_set(), self.settings.time_limit, 0.05)
        if not result.done():
            self._line("cancel", "the time is up" if not self.stop.is_set() else "asked to end")
            handle.cancel_goal_async()
        return self._session.wait(result, GRACE, "/clear_table, when cancelled,").result

    def _on_feedback(self, message: Any) -> None:
        feedback = message.feedback
        attempt = feedback.attempts + (feedback.stage != "recorded")
        self._refusals.add(feedback.stage, feedback.message)
        if feedback.stage == "recorded":
            with self._recorder.lock:
                self._outcomes.append(self._recorder.truth.end_attempt())
        if (feedback.stage, attempt) != self._last_line:
            self._last_line = (feedback.stage, attempt)
            self._line(feedback.stage, f"{feedback.message}", attempt)

    def _summarise(self, result: Any, seconds: float, simulated: float) -> RunSummary:
        truth, limit_hit = self._recorder.truth, result.error_code == ErrorCode.TASK_CANCELLED
        outcomes = [*self._outcomes, *[record.success for record in result.records[len(self._outcomes) :]]]
        records = tuple(
            Attempt(
                score=round(record.score, 4),
                success=outcome,
                code=record.error_code,
                message=record.message,
                seconds={stage.stage: round(stage.seconds, 3) for stage in record.stage_times},
                source=record.source,
            )
            for record, outcome in zip(result.records, outcomes, strict=False)
        )
        return RunSummary(
            seed=self.settings.seed,
            objects=truth.objects,
            cleared=truth.cleared,
            records=records,
            total_seconds=seconds,
            simulated_seconds=simulated,
            refusals=self._refusals.ended(),
            error_code=result.error_code,
            message="the time was up" if limit_hit and not self.stop.is_set() else result.message,
            revision=git_revision(Path(__file__).resolve().parent),
            model=self._model,
            places=truth.places,
        )

    def _completed(self, result: Any) -> bool:
        timed_out = result.error_code == ErrorCode.TASK_CANCELLED and not self.stop.is_set()
        return result.error_code in COMPLETED or timed_out

    def _save_last_picture(self) -> None:
        try:
            self._save("after.png", self._recorder.picture(timeout=10.0))
        except TimeoutError as error:  # a dead camera must not cost the summary
            self._line("save", f"no picture after the run: {error}")

    def _save(self, name: str, picture: Any) -> None:
        Image.fromarray(picture).save(self.settings.out / name)

    def _call(self, kind: Any, name: str, request: Any, timeout: float) -> Any:
        client = self._session.node.create_client(kind, name)
        if not client.wait_for_service(timeout_sec=10.0):
            raise TimeoutError(f"nobody serves {name}")
        return self._session.wait(client.call_async(request), timeout, name)

    def _line(self, stage: str, message: str, attempt: int = 0) -> None:
        """One progress line, also written onto the frames of the animation."""
        who = f"attempt {attempt}" if attempt else ""
        self._recorder.label = " ".join(part for part in (who, stage) if part)
        seconds = time.monotonic() - self._start
        self._console.print(
            f"{seconds:7.1f} s  {who:<11} {stage:<10} {message}",
            soft_wrap=True,
            highlight=False,
            markup=False,
        )


class CloudBag:
    """Context manager: cloud_recorder as a process that writes OUT/clouds."""

    def __init__(self, out: Path, wanted: bool) -> None:
        """Nothing is started yet."""
        self._out = out
        self._wanted = wanted
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> None:
        if not self._wanted:
            return
        logs = self._out / "logs"
        logs.mkdir(exist_ok=True)
        command = ["ros2", "run", "dgs_perception", "cloud_recorder", "--ros-args"]
        command += ["-p", f"path:={self._out / 'clouds'}", "-p", "period:=5.0"]
        with (logs / "cloud_recorder.log").open("wb") as log:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def __exit__(self, *exception: object) -> None:
        if self._process is None:
            return
        os.killpg(self._process.pid, signal.SIGINT)
        try:
            self._process.wait(timeout=8.0)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()


def main() -> int:
    """Parse, run, say in one sentence what went wrong if something did."""
    settings = _parse()
    console = Console(width=None if sys.stdout.isatty() else 120)
    settings.out.mkdir(parents=True, exist_ok=True)
    # Whatever hangs, the demo ends: a last resort far beyond every other limit.
    watchdog = threading.Timer(settings.time_limit + 2 * GRACE + 180.0, _give_up)
    watchdog.daemon = True
    watchdog.start()
    with RosSession("demo") as session:
        demo = Demo(settings, session, console)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: demo.stop.set())
        try:
            return demo.run()
        except (TimeoutError, RuntimeError) as error:
            console.print(f"the demo failed: {error}", markup=False)
            return EXIT_FAILED


def _parse() -> Settings:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0, help="of the scene and of all predictions")
    parser.add_argument("--objects", type=int, default=5)
    parser.add_argument("--catalogue", default="novel", help="novel, train, or a folder of objects")
    parser.add_argument("--out", type=Path, required=True, help="run folder")
    parser.add_argument(
        "--time-limit", type=float, default=270.0, help="for clearing the table [s of wall time]"
    )
    parser.add_argument("--max-attempts", type=int, default=0, help="0 = the task node's default")
    parser.add_argument("--no-bag", dest="bag", action="store_false", help="do not record clouds")
    arguments = parser.parse_args()
    if arguments.seed < 0 or arguments.objects < 1:
        parser.error("--seed must not be negative and --objects at least 1")
    return Settings(**vars(arguments))


def _give_up() -> None:
    print("the demo hangs and gives up", file=sys.stderr, flush=True)
    os._exit(EXIT_TIME)


if __name__ == "__main__":
    sys.exit(main())
