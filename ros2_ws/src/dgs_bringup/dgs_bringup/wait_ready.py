"""Waits until the nodes of a mode offer what they should: python -m dgs_bringup.wait_ready --mode simulation."""

from __future__ import annotations

from typing import Annotated

import typer
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from dgs_bringup.nodes import MODES
from dgs_bringup.ros_session import RosSession, wait_until

SETTLING = 4.0
"""So long all nodes may take to say that they are well: they report once a second, a silent camera after 2 s [s]."""

DISCOVERY = 2.0
"""Whoever is in the ROS domain is seen within so long [s]."""


def missing(node: Node, mode: str) -> list[str]:
    """Services, actions and topics of the mode's nodes that nobody offers yet, as seen by `node`."""
    offers = [name for info in MODES[mode] for name in info.offers]
    services = [name for name in offers if node.count_services(name)]
    actions = [name for name in offers if node.count_services(f"{name}/_action/send_goal")]
    return [name for name in offers if name not in (*services, *actions) and not node.count_publishers(name)]


def wait_ready(
    mode: Annotated[str, typer.Option(help="simulation, robot or replay")] = "simulation",
    timeout: Annotated[float, typer.Option(help="Time limit [s].")] = 60.0,
    before: Annotated[bool, typer.Option("--before", help="See that nothing of it is there yet.")] = False,
) -> None:
    """End with 0 when everything is there, with 1 and a list of what is missing after the time limit.

    What nodes that are there complain of is printed, and does not change the exit code. `before`: end with 0 if nothing
    of it is there, else with 1 and a list of what is.
    """
    offers = [name for info in MODES[mode] for name in info.offers]
    statuses: dict[str, DiagnosticStatus] = {}

    def complaints() -> list[DiagnosticStatus]:
        return [status for status in list(statuses.values()) if status.level != DiagnosticStatus.OK]

    def well() -> bool:
        heard = {status.hardware_id for status in list(statuses.values())}
        return heard.issuperset(info.name for info in MODES[mode]) and not complaints()

    def there() -> list[str]:
        still_missing = missing(session.node, mode)
        return [name for name in offers if name not in still_missing]

    with RosSession("wait_ready") as session:
        if before:
            if wait_until(there, DISCOVERY):
                other = "another suite runs in this ROS domain, and both would take every goal"
                cure = "end it, or set another ROS_DOMAIN_ID for one of them"
                typer.echo(f"there already: {', '.join(there())}: {other}; {cure}", err=True)
                raise typer.Exit(1)
            return
        session.node.create_subscription(
            DiagnosticArray,
            "/diagnostics",
            lambda array: statuses.update((status.name, status) for status in array.status),
            10,
        )
        if not wait_until(lambda: not missing(session.node, mode), timeout, period=0.1):
            typer.echo(f"not there after {timeout:g} s: {', '.join(missing(session.node, mode))}", err=True)
            raise typer.Exit(1)
        wait_until(well, SETTLING)
        for status in complaints():
            typer.echo(f"ready, but {status.name}: {status.message}")


if __name__ == "__main__":
    typer.run(wait_ready)
