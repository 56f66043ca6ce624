"""What the live page costs the picks: the same seed without page, with it, and with a browser that looks at it.

python -m tests.support.viewer_load --seed 4 --json docs/results/viewer_load.json --doc docs/live_page.md
"""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer

from dgs_description.documents import fill_block
from dgs_description.paths import revision
from tests.support.browser import browser
from tests.support.environment import REPO_ROOT, end_tidily, reserved_domain_id, ros_environment
from tests.support.live_page import printed_address, visit

START = REPO_ROOT / "ros2_ws/src/dgs_bringup/scripts/start_suite.sh"
VARIANTS = ("without", "page", "page and browser")
FRAMES = """new Promise(done => {
    const start = performance.now();
    let frames = 0;
    const next = now => {
        if (now - start > 5000) done(frames / (now - start) * 1000);
        else { frames += 1; requestAnimationFrame(next); }
    };
    requestAnimationFrame(next);
})"""
"""Pictures a second that the browser draws, over five seconds."""
_TICKS = os.sysconf("SC_CLK_TCK")


def measure(variant: str, seed: int, attempts: int, folder: Path) -> dict[str, Any]:
    """One run of the demo; seconds per attempt by stage of its picks, and what the page took."""
    view = [] if variant == "without" else ["--view"]
    (folder / "params.yaml").write_text("viewer_node:\n  ros__parameters: {port: 0}\n")
    command = ["bash", str(START), *view, "--params", str(folder / "params.yaml"), "--log", str(folder), "--"]
    command += [
        "python3",
        "-m",
        "dgs_bringup.demo",
        "--seed",
        str(seed),
        "--objects",
        "5",
        "--out",
        str(folder),
    ]
    command += ["--max-attempts", str(attempts), "--no-bag"]
    page: dict[str, Any] = {}
    with reserved_domain_id() as domain, ExitStack() as stack, (folder / "out").open("w") as out:
        environment = {**ros_environment(), "ROS_DOMAIN_ID": str(domain)}
        start = time.monotonic()
        process = subprocess.Popen(command, env=environment, stdout=out, stderr=out, stdin=subprocess.DEVNULL)
        stack.callback(process.wait)
        if view:
            address = printed_address(folder / "out", process)
            begin, used = time.monotonic(), _processor_time(domain)
            if variant == VARIANTS[-1]:
                tab = stack.enter_context(browser(folder / "profile"))
                visit(tab, address)
                page["seconds_from_address_to_picture"] = round(time.monotonic() - begin, 1)
                page["seconds_from_start_to_picture"] = round(time.monotonic() - start, 1)
                page["frames_per_second"] = round(tab.run(FRAMES), 1)
            while process.poll() is None:
                now = _processor_time(domain)
                if now:  # it has not ended yet
                    page["processor_share"] = round((now - used) / (time.monotonic() - begin), 3)
                time.sleep(1.0)
        process.wait()
    summary = json.loads((folder / "summary.json").read_text())
    seconds = [sum(record["seconds"].values()) for record in summary["records"]]
    return {"variant": variant, "seconds": [round(value, 2) for value in seconds], **page}


def _processor_time(domain: int) -> float:
    """Of the page's node in a domain [s]; 0 when it has ended."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            mine = f"ROS_DOMAIN_ID={domain}\0".encode() in (folder / "environ").read_bytes()
            if mine and b"dgs_viewer/viewer_node" in (folder / "cmdline").read_bytes():
                fields = (folder / "stat").read_text().rpartition(")")[2].split()
                return (int(fields[11]) + int(fields[12])) / _TICKS
        except OSError:
            continue
    return 0.0


def table(runs: Sequence[dict[str, Any]]) -> str:
    """Markdown: a row per variant."""
    lines = [
        "| | attempts | seconds an attempt, median (range) | the page's node [cores] | start to picture [s] "
        "| frames a second |",
        "|---|---|---|---|---|---|",
    ]
    for variant in VARIANTS:
        mine = [run for run in runs if run["variant"] == variant]
        seconds = [value for run in mine for value in run["seconds"]]
        cells = [
            variant,
            str(len(seconds)),
            f"{np.median(seconds):.1f} ({min(seconds):.1f} to {max(seconds):.1f})",
        ]
        for key in ("processor_share", "seconds_from_start_to_picture", "frames_per_second"):
            values = [run[key] for run in mine if key in run]
            cells.append(f"{min(values):g} to {max(values):g}" if values else "")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main(
    json_file: Annotated[Path, typer.Option("--json", help="Where the figures go.")],
    seed: Annotated[int, typer.Option(help="Of scene and predictions.")] = 0,
    attempts: Annotated[int, typer.Option(help="Picks per run.")] = 3,
    rounds: Annotated[int, typer.Option(help="Runs of every variant, in turn.")] = 2,
    doc: Annotated[Path | None, typer.Option(help="Document whose table is written anew.")] = None,
) -> None:
    """Measure and write the figures."""
    end_tidily()
    runs = []
    for _ in range(rounds):
        for variant in VARIANTS:
            with TemporaryDirectory() as folder:
                runs.append(measure(variant, seed, attempts, Path(folder)))
                typer.echo(json.dumps(runs[-1]))
    median = {
        variant: round(
            float(np.median([s for run in runs if run["variant"] == variant for s in run["seconds"]])), 2
        )
        for variant in VARIANTS
    }
    result = {
        "seed": seed,
        "load_before": os.getloadavg(),
        "seconds_per_attempt": median,
        "runs": runs,
        "revision": revision(),
    }
    json_file.write_text(json.dumps(result, indent=2) + "\n")
    if doc is not None:
        fill_block(doc, "viewer_load", table(runs))


if __name__ == "__main__":
    typer.run(main)
