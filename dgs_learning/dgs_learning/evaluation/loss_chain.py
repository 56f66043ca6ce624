"""Where success is lost between a stored grasp and an executed one: the network's answers put in one after another.

Replayed grasps -> the network's grasp at a true reference point -> a stored grasp at the network's point -> the
network alone -> its candidates checked -> moved and closed onto the cloud -> ranked by the evidence -> joined by level
pinches: the planner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STAGES = ("checks", "move", "close", "rank", "propose")
"""What can be left out of the planner."""


@dataclass(frozen=True)
class Step:
    """One link of the chain: its name, the planner that runs it, what that planner leaves out."""

    name: str
    planner: str
    without: tuple[str, ...] = ()
    text: str = ""


CHAIN = (
    Step("replay", "replay", (), "stored grasps, feasible on the true poses"),
    Step(
        "true_point", "true_point", STAGES, "true reference point, the network's rotation, offset and joints"
    ),
    Step("true_rest", "true_rest", STAGES, "the network's best point, the stored grasp nearest to it"),
    Step("predicted", "dgs_net", STAGES, "everything from the network"),
    Step("checked", "dgs_net", ("move", "close", "rank", "propose"), "and checked against table and cloud"),
    Step("closed", "dgs_net", ("rank", "propose"), "and moved and closed onto the cloud"),
    Step("ranked", "dgs_net", ("propose",), "and ranked by the evidence"),
    Step("proposed", "dgs_net", (), "and level pinches for what lies flat: the planner"),
)
