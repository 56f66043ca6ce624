"""config/suite.yaml names exactly the parameters that the nodes declare, with values that they accept."""

from __future__ import annotations

from pathlib import Path

import pytest

from dgs_bringup import suite_file
from dgs_bringup.nodes import NODES, NodeInfo
from dgs_description.parameters import constraints_of, declared, from_values

VALUES = suite_file.read()


@pytest.mark.parametrize("node", NODES, ids=lambda node: node.name)
def test_the_values_are_accepted(node: NodeInfo):
    values = dict(VALUES[node.name])
    if node.name == "cloud_recorder":
        values["path"] = "given on the command line"
    from_values(node.parameter_class(), values)


@pytest.mark.parametrize("node", NODES, ids=lambda node: node.name)
def test_a_topic_that_may_be_empty_says_so_to_people_and_to_the_node(node: NodeInfo):
    for name, field in declared(node.parameter_class()).items():
        if name.endswith(("_topic", "_service")):
            known = constraints_of(field)
            assert known.optional == ("; empty" in known.description), name


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("arm_executor: {ros__parameters: {speed: 0.2}}", "names the node 'arm_executor', which is none of"),
        ("- speed", "it must name nodes"),
        ("a: [", "cannot be read"),
        ("\xff", "cannot be read"),
        (None, "cannot be read"),
    ],
)
def test_a_file_of_ones_own_that_names_no_node_is_refused(
    text: str | None, words: str, tmp_path: Path
) -> None:
    if text is not None:
        (tmp_path / "own.yaml").write_text(text, encoding="latin-1")
    with pytest.raises(ValueError, match=words):
        suite_file.check(tmp_path / "own.yaml")


def test_a_file_of_ones_own_may_name_some_nodes_or_all(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(
        "/**: {ros__parameters: {}}\n/arm_executor_node: {ros__parameters: {speed: 0.2}}\n/a/clear_table: {}\n"
    )
    suite_file.check(own)
    suite_file.check(suite_file.SUITE_FILE)


def test_names_and_comments_are_those_of_the_declarations():
    assert suite_file.SUITE_FILE.read_text() == suite_file.render(VALUES), (
        "run: python -m dgs_bringup.suite_file --write"
    )


def test_values_changed_by_hand_survive_and_unknown_ones_go(tmp_path: Path):
    values = {"clear_table": {"max_attempts": 7, "no_such_parameter": 1}}
    path = tmp_path / "suite.yaml"
    path.write_text(suite_file.render(values))
    again = suite_file.read(path)
    assert again["clear_table"]["max_attempts"] == 7
    assert "no_such_parameter" not in again["clear_table"]
    assert suite_file.render(again) == path.read_text()
