"""Waits until the nodes of a mode offer what they should: python -m dgs_bringup.wait_ready --mode simulation."""

from __future__ import annotations

from typing import Annotated

import typer
from rclpy.node import Node

from dgs_bringup.nodes import MODES
from dgs_bringup.ros_session import RosSession, wait_until


def missing(node: Node, mode: str) -> list[str]:
    """Services, actions and topics of the mode's nodes that nobody offers yet, as seen by `node`."""
    offers = [name for info in MODES[mode] for name in info.offers]
    services = [name for name in offers if node.count_services(name)]
    actions = [name for name in offers if node.count_services(f"{name}/_action/send_goal")]
    return [name for name in offers if name not in (*services, *actions) and not node.count_publishers(name)]


def wait_ready(
    mode: Annotated[str, typer.Option(help="simulation, robot or replay")] = "simulation",
    timeout: Annotated[float, typer.Option(help="Time limit [s].")] = 60.0,
) -> None:
    """End with 0 when everything is there, with 1 and a list of what is missing after the time limit."""
    with RosSession("wait_ready") as session:
        if not wait_until(lambda: not missing(session.node, mode), timeout, period=0.1):
            typer.echo(f"not there after {timeout:g} s: {', '.join(missing(session.node, mode))}", err=True)
            raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(wait_ready)
