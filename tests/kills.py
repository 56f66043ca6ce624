"""Every node killed at every stage of a run: python -m tests.kills --repeats 5 --json FILE [--doc FILE]

Each trial clears a table, kills one node with SIGKILL when a stage begins, starts it again, and then asks for another
run. Files are written after every trial; one that is there is gone on with. Exit code 1 if a trial went otherwise than
promised: the run ends within `ENDS` with a code that says what happened, or goes on; the next run does its work.
A trial that cannot be played to its end counts as such, and the whole suite is started anew.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from dgs_bringup.nodes import MODES
from dgs_description.documents import fill_block
from dgs_description.paths import revision
from tests.soak import FINE, RESTARTS
from tests.support.environment import end_tidily, reserved_domain_id
from tests.support.ros_client import RosClient
from tests.support.suite import Suite

STAGES = ("capture", "predict", "transfer", "approach", "close", "lift", "carry", "release")
USED_AGAIN = ("camera_node", "grasp_planner_node")
"""The run waits for these, and goes on."""
ENDS = 10.0
"""A run that does not go on has ended after so long [s]."""
OBJECTS = 4


def trial(suite: Suite, node: str, stage: str, seed: int) -> dict[str, Any]:
    """Kill `node` when `stage` begins; where no pick gets so far, in another scene.

    `code` is None where the task itself was killed: its client has no result.
    """
    suite.wait_ready()
    suite.reset(seed, OBJECTS)
    while not (run := suite.clear(max_attempts=2, seed=seed)).reaches(stage, suite.nodes["clear_table"]):
        assert run.end().error_code in FINE, run.end().message
        seed += len(STAGES)
        suite.reset(seed, OBJECTS)
    suite.nodes[node].kill()
    killed = time.monotonic()
    if node in USED_AGAIN:
        suite.start(node)
    code, message = None, "the task went"
    if node == "clear_table":
        while not run.server.lost():
            time.sleep(0.05)
    else:
        result = run.end()
        code, message = int(result.error_code), result.message
    seconds = time.monotonic() - killed
    if node not in USED_AGAIN:
        suite.start(node)
    suite.wait_ready()
    following = suite.clear(max_attempts=1, seed=seed).end()
    right = code is None or code in RESTARTS[node]
    right &= node in USED_AGAIN or seconds < ENDS
    return {
        "node": node,
        "stage": stage,
        "code": code,
        "message": message,
        "seconds": round(seconds, 2),
        "next": int(following.error_code),
        "next_message": following.message,
        "right": bool(right and following.error_code in FINE),
    }


def tried(suite: Suite, node: str, stage: str, repeat: int) -> dict[str, Any]:
    """A trial's record; `next` is None where it could not be played to its end."""
    record = {"revision": revision(), "repeat": repeat, "node": node, "stage": stage}
    try:
        return record | trial(suite, node, stage, seed=STAGES.index(stage) + 1)
    except (AssertionError, TimeoutError, RuntimeError) as error:
        return record | {"code": None, "message": str(error), "seconds": 0.0, "next": None, "right": False}


def table(trials: Sequence[dict[str, Any]]) -> str:
    """Markdown: a row per node."""
    lines = ["| killed | trials | as promised | codes | to the end of the run [s] |", "|---|---|---|---|---|"]
    for node in dict.fromkeys(t["node"] for t in trials):
        mine = [t for t in trials if t["node"] == node]
        codes = sorted({"none" if t["code"] is None else str(t["code"]) for t in mine})
        times = sorted(t["seconds"] for t in mine)
        goes_on = " (goes on with it)" if node in USED_AGAIN else ""
        lines.append(
            f"| `{node}` | {len(mine)} | {sum(t['right'] for t in mine)} | {', '.join(codes)} "
            f"| {times[len(times) // 2]:.1f}, at most {times[-1]:.1f}{goes_on} |"
        )
    return "\n".join(lines)


def main(
    json_file: Annotated[Path, typer.Option("--json", help="Result; gone on with if it is there.")],
    repeats: Annotated[int, typer.Option(min=1, help="Trials of every node and stage.")] = 5,
    doc: Annotated[Path | None, typer.Option(help="Document whose table is written anew.")] = None,
) -> None:
    """Exit code 0 if all trials went as promised."""
    end_tidily()
    done = json.loads(json_file.read_text())["trials"] if json_file.is_file() else []
    known = {(t["node"], t["stage"], t["repeat"]) for t in done}
    names = [info.name for info in MODES["simulation"]]
    todo = [(n, s, r) for r in range(repeats) for s in STAGES for n in names if (n, s, r) not in known]
    parameters = {"clear_table": {"restart_timeout": 90.0}}
    with reserved_domain_id() as domain_id, RosClient(domain_id, "kills") as client:
        while todo:
            logs = Path(tempfile.mkdtemp(prefix="dgs_kills_"))
            print(f"logs in {logs}", flush=True)
            with Suite(domain_id, client, logs, parameters) as suite:
                while todo:
                    done.append(tried(suite, *todo.pop(0)))
                    print(json.dumps(done[-1]), flush=True)
                    json_file.write_text(json.dumps({"trials": done}, indent=1) + "\n")
                    if doc is not None:
                        fill_block(doc, "kills", table(done))
                    if done[-1]["next"] is None:
                        break
    wrong = [t for t in done if not t["right"]]
    print(f"{len(done)} trials, {len(wrong)} otherwise than promised")
    raise typer.Exit(1 if wrong else 0)


if __name__ == "__main__":
    typer.run(main)
