"""Keeps config/suite.yaml complete: its comments, bounds and missing values come from the nodes' own declarations.

    python -m dgs_bringup.suite_file --write      # after a node's parameters changed; values in the file stay

A value in the file wins over the node's default, so the file is the place to tune the suite.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from dgs_bringup.nodes import NODES, NodeInfo
from dgs_ros.base_node import CommonParameters
from dgs_ros.parameters import constraints_of

SUITE_FILE = Path(__file__).resolve().parents[1] / "config" / "suite.yaml"
EVERY_NODE = "/**"
Values = dict[str, dict[str, Any]]

_HEADER = """\
# All parameters of all nodes of the suite, as the simulation uses them. For the real robot start_suite.sh and
# suite.launch.py override a few of them (docs/real_robot.md); your own overrides go into a second file:
#   start_suite.sh --params my_cell.yaml          ros2 launch dgs_bringup suite.launch.py params:=my_cell.yaml
# Change values here as you like. Comments and new entries are written from the nodes' declarations by
#   python -m dgs_bringup.suite_file --write
# A node refuses to start with a parameter that it does not know or a value out of its bounds.
"""
_SIM_TIME = "Time comes from /clock (simulation) instead of the system."


def read(path: Path = SUITE_FILE) -> Values:
    """Values by node and parameter; empty if there is no such file yet."""
    if not path.exists():
        return {}
    return {node: entry["ros__parameters"] for node, entry in yaml.safe_load(path.read_text()).items()}


def render(values: Values) -> str:
    """The file's text: given values where there are some, the nodes' defaults elsewhere.

    Args:
        values: by node and parameter; what no node declares is dropped.
    """
    lines = [_HEADER]
    common = values.get(EVERY_NODE, {"use_sim_time": True})
    lines += [f"{EVERY_NODE}:", "  ros__parameters:"]
    for name, default, comment in [("use_sim_time", False, _SIM_TIME), *_declared(CommonParameters)]:
        lines += _entry(name, common.get(name, default), default, comment)
    for node in NODES:
        lines += ["", *_section(node, values.get(node.name, {}))]
    return "\n".join(lines) + "\n"


def _section(node: NodeInfo, values: dict[str, Any]) -> Iterator[str]:
    yield f"# {node.package} {node.executable}: {node.purpose}"
    yield f"{node.name}:"
    yield "  ros__parameters:"
    for name, default, comment in _declared(node.parameter_class()):
        yield from _entry(name, values.get(name, default), default, comment)


def _declared(kind: type) -> Iterator[tuple[str, Any, str]]:
    """Name, default and comment of every parameter of a dataclass."""
    for field in dataclasses.fields(kind):
        constraints = constraints_of(field)
        bounds = f" ({constraints.text()})" if constraints.text() else ""
        yield field.name, field.default, constraints.description + bounds


def _entry(name: str, value: Any, default: Any, comment: str) -> list[str]:
    shown, usual = _yaml(value), _yaml(default)
    note = "" if shown == usual else f" Changed here from the node's own {usual}."
    wrapped = textwrap.wrap(comment + note, 112)
    return [*(f"    # {line}" for line in wrapped), f"    {name}: {shown}"]


def _yaml(value: Any) -> str:
    plain = list(value) if isinstance(value, tuple) else value
    return yaml.safe_dump(plain, default_flow_style=True, width=1000).removesuffix("\n").removesuffix("\n...")


def main() -> int:
    """Write the file, or say whether it is up to date (exit code 1 if not)."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", action="store_true", help="write the file instead of checking it")
    arguments = parser.parse_args()
    text = render(read())
    if arguments.write:
        SUITE_FILE.write_text(text)
        return 0
    if SUITE_FILE.exists() and SUITE_FILE.read_text() == text:
        return 0
    print(f"{SUITE_FILE} does not fit the nodes' declarations; run with --write", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
