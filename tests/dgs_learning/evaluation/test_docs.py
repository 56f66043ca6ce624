"""docs/evaluation.md names commands, options, keys, experiments and modules that exist."""

from __future__ import annotations

import dataclasses
import re

from dgs_grasp_planner.planner import STAGES
from dgs_learning.evaluation.conditions import SPOILS, Condition
from dgs_learning.evaluation.experiment import PROPOSERS, Row, names, read_experiment
from dgs_learning.evaluation.metrics import FAILURES, summarise
from dgs_learning.evaluation.robot_metrics import ARM_FAILURES, GRASP_FAILURES, UNREACHABLE, summarise_robot
from tests.support.environment import REPO_ROOT

TEXT = (REPO_ROOT / "docs" / "evaluation.md").read_text()
COUNTS = {"scenes", "objects", "cleared", "attempts", "successes"}


def section(title: str) -> str:
    return TEXT.split(f"## {title}")[1].split("\n## ")[0]


def keys_of(text: str) -> set[str]:
    """Words in the first column of a table."""
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    return {name for cell in rows for name in re.findall(r"`(\w+)`", cell)}


def test_keys_of_the_summaries_are_described() -> None:
    about_the_run = {"proposers", "stages", "setting"}
    free = {*summarise([]), *about_the_run} - COUNTS - {"per_class"}
    assert keys_of(section("Numbers")) == free
    robot = {*summarise_robot([]), *about_the_run, "per_scene", "suite_failures"} - COUNTS
    assert keys_of(section("Robot protocol")) == robot


def test_every_kind_of_failure_is_named() -> None:
    assert all(kind in section("Numbers") for kind in FAILURES)
    assert all(kind in section("Robot protocol") for kind in (*GRASP_FAILURES, *ARM_FAILURES, UNREACHABLE))


def test_proposers_and_stages_are_those_that_there_are() -> None:
    text = section("Proposers and stages")
    assert keys_of(text) == set(PROPOSERS)
    assert all(f"`{stage}`" in text for stage in STAGES)


def test_keys_of_experiments_and_their_names_are_described() -> None:
    rows, experiments, *_ = section("Experiments").split("| experiment |")
    assert keys_of(rows) == {field.name for field in dataclasses.fields(Row)}
    assert all(f"`{field.name}`" in rows for field in dataclasses.fields(Condition))
    assert all(f"`{name}`" in rows for name in SPOILS)
    assert keys_of(experiments) == set(names())


def test_every_experiment_has_its_place_in_a_document() -> None:
    documents = "".join(page.read_text() for page in (REPO_ROOT / "docs").glob("*.md"))
    for name in names():
        assert f"<!-- {read_experiment(name, {}).mark}:start -->" in documents, name


def test_modules_exist() -> None:
    folder = REPO_ROOT / "dgs_learning" / "dgs_learning" / "evaluation"
    named = re.findall(r"`(?:evaluation/)?(\w+(?:\.py|/))`", section("Modules"))
    assert len(named) > 10
    assert not [name for name in named if not (folder / name).exists()]
