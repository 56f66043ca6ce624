"""docs/evaluation.md names commands, options, keys and modules that exist."""

from __future__ import annotations

import re

import pytest
import typer

from dgs_learning.cli.app import app
from dgs_learning.evaluation.metrics import FAILURES, summarise
from dgs_learning.evaluation.proposers import PLANNERS
from dgs_learning.evaluation.robot_metrics import ARM_FAILURES, GRASP_FAILURES, UNREACHABLE, summarise_robot
from tests.support.environment import REPO_ROOT

TEXT = (REPO_ROOT / "docs" / "evaluation.md").read_text()
COMMANDS = [
    line.split("#")[0].strip()
    for block in re.findall(r"```\n(.*?)```", TEXT, re.DOTALL)
    for line in block.splitlines()
    if line.startswith("dgs ")
]


def section(title: str) -> str:
    return TEXT.split(f"## {title}")[1].split("\n## ")[0]


def keys_of(text: str) -> set[str]:
    """Words in the first column of a table."""
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    return {name for cell in rows for name in re.findall(r"`(\w+)`", cell)}


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_have_the_options_that_are_named(line: str) -> None:
    known = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    command = line.split()[1]
    options = {
        name for parameter in known[command].params for name in (*parameter.opts, *parameter.secondary_opts)
    }
    assert set(re.findall(r"--[a-z-]+", line)) <= options


def test_keys_of_the_summaries_are_described() -> None:
    free = {*summarise([]), "setting"} - {
        "scenes",
        "objects",
        "cleared",
        "attempts",
        "successes",
        "per_class",
    }
    assert keys_of(section("Numbers")) == free
    counts = {"scenes", "objects", "cleared", "attempts", "successes"}
    robot = {*summarise_robot([]), "per_scene", "suite_failures", "setting"} - counts
    assert keys_of(section("Robot protocol")) == robot


def test_every_kind_of_failure_is_named() -> None:
    assert all(kind in section("Numbers") for kind in FAILURES)
    assert all(kind in section("Robot protocol") for kind in (*GRASP_FAILURES, *ARM_FAILURES, UNREACHABLE))


def test_planners_exist() -> None:
    named = keys_of(section("Planners"))
    assert {"dgs_net", "top_down", "random_prior", "replay"} <= named <= set(PLANNERS)


def test_modules_exist() -> None:
    folder = REPO_ROOT / "dgs_learning" / "dgs_learning" / "evaluation"
    named = re.findall(r"`(?:evaluation/)?(\w+\.py)`", section("Files"))
    assert len(named) > 10
    assert not [name for name in named if not (folder / name).is_file()]
