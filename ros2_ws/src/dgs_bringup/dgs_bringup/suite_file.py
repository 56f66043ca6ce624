"""Keeps config/suite.yaml complete: its comments, bounds and missing values come from the nodes' own declarations.

    python -m dgs_bringup.suite_file --write      # after a node's parameters changed; values in the file stay

A value in the file wins over the node's default, so the file is the place to tune the suite.
"""

from __future__ import annotations

import dataclasses
import textwrap
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from dgs_bringup.nodes import NODES
from dgs_description.parameters import constraints_of, declared
from dgs_description.yaml_text import load_yaml

SUITE_FILE = Path(__file__).resolve().parents[1] / "config" / "suite.yaml"
WIDTH = 120

_HEADER = """\
# All parameters of all nodes of the suite, as the simulation uses them. For the real robot start_suite.sh and
# suite.launch.py override a few of them (docs/real_robot.md); your own overrides go into a second file:
#   start_suite.sh --params my_robot.yaml          ros2 launch dgs_bringup suite.launch.py params:=my_robot.yaml
# Change values here as you like. Comments and new entries are written from the nodes' declarations by
#   python -m dgs_bringup.suite_file --write
# A node refuses to start with a parameter that it does not know or a value out of its bounds.

/**:
  ros__parameters:
    use_sim_time: true  # time comes from /clock (simulation) instead of the system
"""


def read(path: Path = SUITE_FILE) -> dict[str, dict[str, Any]]:
    """Values by node and parameter."""
    return {node: entry["ros__parameters"] for node, entry in yaml.safe_load(path.read_text()).items()}


def check(path: Path) -> None:
    """Refuse a parameter file of one's own that names a node which the suite does not have: ROS would say nothing.

    Raises:
        ValueError: it does, or it cannot be read.
    """
    try:
        entries = load_yaml(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    if not isinstance(entries, dict):
        raise ValueError(f"{path} is no parameter file: it must name nodes, with ros__parameters below each")
    known = [node.name for node in NODES]
    for name in map(str, entries):
        if "*" not in name and name.strip("/").rpartition("/")[2] not in known:
            raise ValueError(f"{path} names the node {name!r}, which is none of {', '.join(known)}, nor /**")


def render(values: dict[str, dict[str, Any]]) -> str:
    """The file's text: values by node and parameter where given and declared, the nodes' defaults elsewhere."""
    lines = [_HEADER]
    for node in NODES:
        lines += [f"{node.name}:  # of {node.package}", "  ros__parameters:"]
        given = values.get(node.name, {})
        for name, field in declared(node.parameter_class()).items():
            lines += _entry(field, given.get(name, field.default))
        lines.append("")
    return "\n".join(lines)


def _entry(field: dataclasses.Field, value: Any) -> list[str]:
    """Name, value, and what the parameter is about behind it, or above it where the line would be too long."""
    constraints = constraints_of(field)
    shown, usual = _yaml(value), _yaml(field.default)
    comment = constraints.description + (f" ({constraints.text()})" if constraints.text() else "")
    if shown != usual:
        comment += f" Changed here from the node's own {usual}."
    line = f"    {field.name}: {shown}"
    if len(line) + len(comment) + 4 <= WIDTH:
        return [f"{line}  # {comment}"]
    return [*textwrap.wrap(comment, WIDTH, initial_indent="    # ", subsequent_indent="    # "), line]


def _yaml(value: Any) -> str:
    return yaml.safe_dump(value, default_flow_style=True, width=1000).removesuffix("\n").removesuffix("\n...")


def main(
    write: Annotated[bool, typer.Option("--write", help="Write the file instead of checking it.")] = False,
    own: Annotated[
        Path | None, typer.Option("--check", help="A file of overrides: does it name the nodes?")
    ] = None,
) -> None:
    """Write config/suite.yaml, or say whether it fits the nodes' declarations (exit code 1 if not)."""
    if own is not None:
        try:
            return check(own)
        except ValueError as error:
            typer.echo(error, err=True)
            raise typer.Exit(2) from None
    text = render(read())
    if write:
        SUITE_FILE.write_text(text)
    elif SUITE_FILE.read_text() != text:
        typer.echo(f"{SUITE_FILE} does not fit the nodes' declarations; run with --write", err=True)
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
