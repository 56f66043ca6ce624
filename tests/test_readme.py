"""README and guides name only what exists: paths, make targets, nodes, topics, parameters, commands, options."""

from __future__ import annotations

import ast
import dataclasses
import re

import pytest

from dgs_bringup.nodes import NODES, NodeInfo
from tests.support.environment import REPO_ROOT

DOCUMENTS = (
    "README.md",
    "docs/index.md",
    "docs/nodes.md",
    "docs/running.md",
    "docs/live_page.md",
    "docs/real_robot.md",
)
TEXT = {name: (REPO_ROOT / name).read_text() for name in DOCUMENTS}
ALL_TEXT = "\n".join(TEXT.values())
LAUNCH_FILE = REPO_ROOT / "ros2_ws/src/dgs_bringup/launch/suite.launch.py"
INTERFACES = REPO_ROOT / "ros2_ws/src/dgs_interfaces"
TOPIC = re.compile(r"`(/[a-z_/]+[a-z])`")


def node_rows() -> list[tuple[NodeInfo, list[str]]]:
    """Node and remaining cells of every row of the table of nodes."""
    rows = []
    for line in TEXT["docs/nodes.md"].splitlines():
        match = re.match(r"\| `ros2 run (\w+) (\w+)` \|", line)
        if match:
            (node,) = [n for n in NODES if (n.package, n.name) == match.groups()]
            rows.append((node, [cell.strip() for cell in line.split("|")[2:-1]]))
    return rows


def sources(package: str) -> str:
    """All Python text of a package, and what the shared base node adds."""
    folders = [REPO_ROOT / package, REPO_ROOT / "ros2_ws/src" / package]
    folder = next(f for f in folders if f.is_dir() and not f.is_symlink())
    return "\n".join(path.read_text() for path in sorted(folder.rglob("*.py")))


@pytest.mark.parametrize("name", DOCUMENTS)
def test_links_lead_somewhere(name: str) -> None:
    folder = (REPO_ROOT / name).parent
    for target in re.findall(r"\]\(([^)#:]+)\)", TEXT[name]):
        assert (folder / target).exists(), f"{name}: {target}"


def test_folders_and_scripts_exist() -> None:
    named = set(re.findall(r"`((?:dgs_\w+|ros2_ws|models|tests|docs)/[\w./]*)`", ALL_TEXT))
    named |= set(re.findall(r"(?:bash|source) ([\w/.]+\.sh)", ALL_TEXT))
    assert len(named) >= 10
    missing = [path for path in named if not _exists(path) and not path.startswith("dgs_interfaces/")]
    assert not missing


def _exists(path: str) -> bool:
    # A module is named as package/module.py, wherever the package lies.
    roots = (REPO_ROOT, *REPO_ROOT.glob("ros2_ws/src/*"), *REPO_ROOT.glob("dgs_*"))
    return any((root / path).exists() for root in roots)


def test_the_table_has_every_node() -> None:
    assert sorted(node.name for node, _ in node_rows()) == sorted(node.name for node in NODES)


@pytest.mark.parametrize(("node", "cells"), node_rows(), ids=lambda value: getattr(value, "name", ""))
def test_topics_and_services_are_those_of_the_node(node: NodeInfo, cells: list[str]) -> None:
    text = sources(node.package)
    for topic in TOPIC.findall(" ".join(cells)):
        # Names with a prefix that is a parameter are put together in the code.
        tails = [topic, topic.removeprefix("/camera/camera"), "/" + topic.rsplit("/", 1)[-1]]
        assert any(tail in text for tail in tails), f"{node.name}: {topic}"


@pytest.mark.parametrize(("node", "cells"), node_rows(), ids=lambda value: getattr(value, "name", ""))
def test_parameters_are_those_of_the_node(node: NodeInfo, cells: list[str]) -> None:
    declared = {field.name for field in dataclasses.fields(node.parameter_class())}
    assert set(re.findall(r"`(\w+)`", cells[-1])) <= declared


def test_interface_types_exist() -> None:
    named = set(re.findall(r"dgs_interfaces/((?:msg|srv|action)/\w+)", ALL_TEXT))
    assert len(named) >= 6
    assert not [name for name in named if not (INTERFACES / f"{name}.{name.split('/')[0]}").exists()]


def test_launch_arguments_exist() -> None:
    tree = ast.parse(LAUNCH_FILE.read_text())
    (arguments,) = [
        n.value for n in tree.body if isinstance(n, ast.Assign) and n.targets[0].id == "ARGUMENTS"
    ]  # type: ignore[attr-defined]
    declared = {entry.elts[0].value for entry in arguments.elts}  # type: ignore[attr-defined]
    used = {
        name
        for line in re.findall(r"suite\.launch\.py(.*)", ALL_TEXT)
        for name in re.findall(r"(\w+):=", line)
    }
    assert {"mode", "params"} <= used <= declared


def test_results_stand_between_their_marks() -> None:
    text = (REPO_ROOT / "docs/results.md").read_text()
    assert re.search(r"<!-- results:start -->\n.*<!-- results:end -->", text, re.DOTALL)


def test_the_readme_fits_on_two_screens() -> None:
    assert len(TEXT["README.md"].splitlines()) <= 100
