"""Clears a simulated table with the running suite and writes a run folder (see scripts/demo.sh)."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from dgs_interfaces.action import ClearTable
from dgs_interfaces.srv import PredictGrasps, SimReset
from PIL import Image
from rich.console import Console

from dgs_bringup.animation import write_gif
from dgs_bringup.prediction_picture import draw_prediction
from dgs_bringup.ros_session import RosSession, wait_until
from dgs_bringup.run_recorder import RunRecorder
from dgs_bringup.summary import refused_looks, summarise, summary_table, true_records
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.hand import HAND
from dgs_description.paths import revision
from dgs_description.words import plural
from dgs_sim_bridge.render.object_model import find_catalogue
from dgs_sim_bridge.world.scenes import choose_models

EXIT_OK, EXIT_FAILED, EXIT_TIME = 0, 1, 5
COMPLETED = (ErrorCode.SUCCESS, ErrorCode.TASK_ATTEMPTS_USED_UP)
GRACE = 45.0
"""After the time limit, a running grasp may take so long to be cancelled before the demo gives up [s]."""


class Demo:
    """One run against nodes that are ready; an event `stop` ends it before its time."""

    def __init__(self, session: RosSession, console: Console, out: Path, seed: int) -> None:
        """Listen; `out` is the run folder, `seed` of the scene and of all predictions."""
        self.stop = threading.Event()
        self._session, self._console, self._out, self._seed = session, console, out, seed
        self._start = time.monotonic()
        self._recorder = RunRecorder(session.node)
        self._outcomes: dict[int, bool] = {}
        """By the number of the attempt; a push has that of the grasp that follows it."""
        self._feedback: list[tuple[str, str]] = []
        self._timeline: list[dict[str, Any]] = []
        self._last_line = ("", 0)

    def run(self, objects: int, catalogue: str, time_limit: float, max_attempts: int, bag: bool) -> int:
        """Do everything; returns the exit code. The arguments are those of `main`."""
        self._reset(SimReset.Request(seed=self._seed, objects=objects, catalogue=catalogue))
        self._recorder.picture()  # may still show what lay there before the reset
        self._save("before.png", self._recorder.picture())
        with self._cloud_bag() if bag else nullcontext():
            model = self._predict_once()
            self._recorder.filming = True
            begin, simulated = time.monotonic(), self._recorder.truth.time
            goal = ClearTable.Goal(seed=self._seed, max_attempts=max_attempts)
            result = self._clear_table(goal, time_limit)
            seconds, simulated = time.monotonic() - begin, self._recorder.truth.time - simulated
            self._recorder.filming = False
        self._save_pictures()
        timed_out = result.error_code == ErrorCode.TASK_CANCELLED and not self.stop.is_set()
        summary = summarise(
            true_records(result.records, self._outcomes),
            self._recorder.truth.places,
            seconds,
            simulated_seconds=round(simulated, 2),
            refusals=refused_looks(self._feedback),
            hand=HAND.name,
            seed=self._seed,
            error_code=result.error_code,
            message="the time was up" if timed_out else result.message,
            revision=revision(),
            model=model,
            timeline=self._timeline,
        )
        self._write(summary)
        return EXIT_OK if timed_out or result.error_code in COMPLETED else EXIT_FAILED

    def _reset(self, request: SimReset.Request) -> None:
        answer = self._session.call(SimReset, "/sim/reset", request)
        if answer.error_code != 0:
            raise RuntimeError(f"/sim/reset refused ({answer.error_code}): {answer.message}")
        truth = self._recorder.truth
        if not wait_until(lambda: set(truth.places) == set(answer.object_names), 20.0):
            raise TimeoutError("/sim/state does not show the new scene within 20 s")
        self._line("reset", f"seed {self._seed}: {', '.join(answer.object_names)}")

    def _predict_once(self) -> str:
        """A prediction for the picture, the task makes its own; returns the model's name and hash."""
        cloud, image = self._recorder.cloud(), self._recorder.picture()
        request = PredictGrasps.Request(cloud=cloud, seed=self._seed, max_grasps=64)
        answer = self._session.call(PredictGrasps, "/predict_grasps", request)
        if answer.error_code == ErrorCode.SUCCESS:
            times = ", ".join(f"{stage.stage} {stage.seconds:.2f} s" for stage in answer.stage_times)
            count = plural(len(answer.grasps), "grasp")
            self._line("predict", f"{count} from {answer.points_in} points ({times})")
        else:
            self._line("predict", f"({answer.error_code}) {answer.message}")
        picture, overlay = draw_prediction(cloud, image, self._recorder.intrinsics(), answer.grasps)
        self._save("grasps.png", picture)
        self._save("grasps_camera.png", overlay)
        return f"{answer.model_id} {answer.model_sha256[:12]}".strip()

    def _clear_table(self, goal: ClearTable.Goal, time_limit: float) -> ClearTable.Result:
        handle = self._session.send(ClearTable, "/clear_table", goal, self._on_feedback)
        result = handle.get_result_async()
        wait_until(lambda: result.done() or self.stop.is_set(), time_limit, 0.05)
        if not result.done():
            self._line("cancel", "asked to end" if self.stop.is_set() else "the time is up")
            handle.cancel_goal_async()
        return self._session.wait(result, GRACE, "/clear_table, when cancelled,").result

    def _on_feedback(self, message: Any) -> None:
        feedback = message.feedback
        self._feedback.append((feedback.stage, feedback.message))
        self._note_stage(feedback.attempt, feedback.stage)
        if feedback.stage == "recorded":
            self._outcomes[feedback.attempt] = self._recorder.truth.end_attempt()
        if (feedback.stage, feedback.attempt) != self._last_line:
            self._last_line = (feedback.stage, feedback.attempt)
            self._line(feedback.stage, feedback.message, feedback.attempt)

    @contextmanager
    def _cloud_bag(self) -> Iterator[None]:
        """Record clouds to OUT/clouds, with cloud_recorder as a process that is signalled with this one."""
        command = [
            sys.executable,
            "-m",
            "dgs_perception.cloud_recorder_node",
            "--ros-args",
            "-p",
            "period:=5.0",
        ]
        command += ["-p", f"path:={json.dumps(str(self._out / 'clouds'), ensure_ascii=False)}"]
        file = self._out / "logs" / "cloud_recorder.log"
        file.parent.mkdir(exist_ok=True)
        with file.open("wb") as log:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            yield
        finally:
            process.terminate()
            try:
                code = process.wait(timeout=8.0)
            except subprocess.TimeoutExpired:
                process.kill()
                code = process.wait()
            if code != 0:
                self._line("save", f"the clouds were not recorded (exit code {code}), see {file}")

    def _note_stage(self, attempt: int, stage: str) -> None:
        """When a stage of an attempt begins, in simulated time; feedback repeats it while it lasts."""
        earlier = [entry["stage"] for entry in self._timeline if entry["attempt"] == attempt]
        if earlier[-1:] != [stage]:
            now = self._session.node.get_clock().now().nanoseconds * 1e-9
            self._timeline.append({"time": round(now, 2), "attempt": attempt, "stage": stage})

    def _save_pictures(self) -> None:
        try:
            frames = write_gif(self._out / "run.gif", self._recorder.frames)
            self._line("save", f"animation of {frames} frames")
            self._save("after.png", self._recorder.picture(timeout=10.0))
        except OSError as error:  # neither a full disk nor a dead camera (TimeoutError) must cost the summary
            self._line("save", f"not all pictures of the run: {error}")

    def _save(self, name: str, picture: Any) -> None:
        Image.fromarray(picture).save(self._out / name)

    def _write(self, summary: dict[str, Any]) -> None:
        """To the terminal and to the run folder."""
        end = f"seed {self._seed} ended ({summary['error_code']}): {summary['message']}"
        self._console.print(end, markup=False, highlight=False, soft_wrap=True)
        self._console.print(summary_table(summary))
        (self._out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
        self._console.print(f"run folder: {self._out}", markup=False, highlight=False, soft_wrap=True)

    def _line(self, stage: str, message: str, attempt: int = 0) -> None:
        """One progress line, also written onto the frames of the animation."""
        who = f"attempt {attempt}" if attempt else ""
        self._recorder.label = f"{who} {stage}".strip()
        seconds = time.monotonic() - self._start
        line = f"{seconds:7.1f} s  {who:<11} {stage:<10} {message}"
        self._console.print(line, soft_wrap=True, highlight=False, markup=False)


def _unused(out: Path) -> Path:
    """Refuse a folder that holds a run."""
    if any((out / name).exists() for name in ("before.png", "clouds", "summary.json")):
        raise typer.BadParameter(f"{out} holds a run already; name another folder")
    return out


def _seconds(value: float) -> float:
    """Refuse what is no time limit; a range of typer lets nan pass."""
    if not 0.0 < value < math.inf:
        raise typer.BadParameter(f"{value} is no positive number of seconds")
    return value


def main(
    out: Annotated[
        Path, typer.Option(file_okay=False, callback=_unused, help="Run folder; it must not hold a run.")
    ],
    seed: Annotated[int, typer.Option(min=0, max=2**64 - 1, help="Of the scene and of all predictions.")] = 0,
    objects: Annotated[int, typer.Option(min=1, help="Objects on the table.")] = 5,
    catalogue: Annotated[str, typer.Option(help="novel, household, train, or a folder.")] = "novel",
    time_limit: Annotated[
        float, typer.Option(callback=_seconds, help="For clearing the table [s of wall time].")
    ] = 270.0,
    max_attempts: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="0 = the task node's default.")] = 0,
    bag: Annotated[bool, typer.Option(help="Record the clouds.")] = True,
    stay: Annotated[bool, typer.Option(help="Keep the suite running at the end, until Ctrl-C.")] = False,
    check: Annotated[bool, typer.Option("--check", help="Check the options, and end.")] = False,
) -> None:
    """Clear a simulated table with the running suite and write a run folder."""
    if check:
        try:
            choose_models(find_catalogue(catalogue), objects, np.random.default_rng(0))
        except DgsError as error:
            raise typer.BadParameter(error.message) from error
        return
    console = Console(width=None if sys.stdout.isatty() else 120)
    out.mkdir(parents=True, exist_ok=True)
    # Whatever hangs, the demo ends: a last resort far beyond every other limit.
    watchdog = threading.Timer(time_limit + 2 * GRACE + 180.0, _give_up)
    watchdog.daemon = True
    watchdog.start()
    with RosSession("demo", use_sim_time=True) as session:
        demo = Demo(session, console, out, seed)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: demo.stop.set())
        try:
            try:
                code = demo.run(objects, catalogue, time_limit, max_attempts, bag)
            finally:
                watchdog.cancel()
            if stay and not demo.stop.is_set():
                console.print("the suite goes on for the live page; Ctrl-C ends it")
                demo.stop.wait()
        except (OSError, RuntimeError) as error:  # of an OSError also TimeoutError
            console.print(f"the demo failed: {error}", markup=False)
            code = EXIT_FAILED
    raise typer.Exit(code)


def _give_up() -> None:
    print("the demo hangs and gives up", file=sys.stderr, flush=True)
    os._exit(EXIT_TIME)


if __name__ == "__main__":
    typer.run(main)
