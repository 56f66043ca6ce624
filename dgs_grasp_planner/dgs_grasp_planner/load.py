"""The planner that ships, made from a weights file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dgs_description.errors import DgsError, ErrorCode
from dgs_grasp_planner.contact.shape_completion import shape_completion
from dgs_grasp_planner.planner import SHIPPED, GraspPlanner, PlannerSettings
from dgs_grasp_planner.propose import Proposer
from dgs_grasp_planner.propose.dgs_net import DgsNet
from dgs_grasp_planner.propose.drag import Drag
from dgs_grasp_planner.propose.edge_pinch import EdgePinch
from dgs_grasp_planner.propose.level_pinch import LevelPinch
from dgs_grasp_planner.propose.part import Part
from dgs_grasp_planner.propose.push import Push, PushSettings
from dgs_grasp_planner.propose.turn_over import TurnOver


def geometric(push: PushSettings) -> dict[str, Proposer]:
    """Proposers of the planner that need no weights, by name; `push`: of pushes and drags."""
    every = (LevelPinch(), EdgePinch(), TurnOver(), Drag(push), Push(push), Part())
    return {proposer.name: proposer for proposer in every}


def planner_with(
    network: DgsNet | None,
    proposers: Sequence[str] = SHIPPED,
    settings: PlannerSettings = PlannerSettings(),
    push: PushSettings = PushSettings(),
) -> GraspPlanner:
    """A planner of named proposers.

    Args:
        network: loaded; None where `proposers` does not name it.
        proposers: names, of `SHIPPED`.
        settings: of all stages; whether table points are kept is the network's to say.
        push: of pushes and drags.

    Raises:
        DgsError: PARAMETER_INVALID, with the names that there are; WEIGHTS_MISSING or WEIGHTS_ALTERED of the
            network that guesses hidden sides.
    """
    shape_completion()
    made = geometric(push)
    if network is not None:
        made[DgsNet.name] = network
        settings = replace(settings, keep_table=network.net.config.keep_table)
    unknown = [name for name in proposers if name not in made]
    if unknown or not proposers:
        raise DgsError(
            ErrorCode.PARAMETER_INVALID, f"proposers are {list(proposers)}, choose from {', '.join(made)}"
        )
    return GraspPlanner([made[name] for name in proposers], settings)


def load_planner(
    directory: Path | str,
    model: str = "dgs_net",
    device: str = "cpu",
    precision: str = "auto",
    proposers: Sequence[str] = SHIPPED,
) -> GraspPlanner:
    """The shipped planner, warmed up; arguments and errors as of `DgsNet.from_weights` and `planner_with`."""
    network = DgsNet.from_weights(directory, model, device=device, precision=precision)
    network.warm_up()
    return planner_with(network, proposers)
