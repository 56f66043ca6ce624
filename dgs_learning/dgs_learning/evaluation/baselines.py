"""Planners by name: DGS-Net and what it is compared with. All share the planner's callable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from dgs_learning import paths
from dgs_learning.evaluation.protocol import PlannerFactory

PLANNERS = {
    "dgs_net": "the network",
    "top_down": "geometric: segmentation, principal axes, hands from above matched to the width",
    "random_prior": "grasps of the training set dropped at random object points, then the same checks",
    "replay": "validated grasps of the dataset on the true poses: measures the harness (objects of the dataset only)",
}


@dataclass(frozen=True)
class PlannerChoice:
    """Which planner an experiment runs.

    Attributes:
        name: one of `PLANNERS`.
        model: name of the network's weights, models_dir: where they lie.
        dataset: dataset file of `random_prior` and `replay`.
    """

    name: str = "dgs_net"
    model: str = "dgs_net"
    models_dir: Path | None = None
    dataset: Path | None = None

    def __post_init__(self) -> None:
        if self.name not in PLANNERS:
            raise ValueError(f"no planner named {self.name!r}; there are {', '.join(PLANNERS)}")


@cache
def planner_factory(choice: PlannerChoice) -> PlannerFactory:
    """The factory of a planner; what is loaded stays for the life of the process.

    Raises:
        FileNotFoundError: there is no dataset.
        DgsError: the weights are missing or altered.
    """
    makers: dict[str, Callable[[PlannerChoice], PlannerFactory]] = {
        "dgs_net": _dgs_net,
        "top_down": _top_down,
        "random_prior": _random_prior,
        "replay": _replay,
    }
    return makers[choice.name](choice)


def _dgs_net(choice: PlannerChoice) -> PlannerFactory:
    import torch

    from dgs_grasp_planner.planner import DgsNetPlanner

    torch.set_num_threads(1)  # sums of several threads depend on their number
    planner = DgsNetPlanner.from_weights(choice.models_dir or paths.models_dir(), choice.model)
    planner.warm_up()
    return lambda truth: planner


def _top_down(choice: PlannerChoice) -> PlannerFactory:
    from dgs_learning.evaluation.top_down import TopDownPlanner

    planner = TopDownPlanner()
    return lambda truth: planner


def _random_prior(choice: PlannerChoice) -> PlannerFactory:
    from dgs_learning.dataset import load_dataset
    from dgs_learning.evaluation.random_prior import RandomPriorPlanner, prior_of

    planner = RandomPriorPlanner(prior_of(load_dataset(choice.dataset or paths.dataset_file())))
    return lambda truth: planner


def _replay(choice: PlannerChoice) -> PlannerFactory:
    from dgs_learning.dataset import load_dataset
    from dgs_learning.evaluation.replay import ReplayPlanner, StoredGrasps

    stored = StoredGrasps(load_dataset(choice.dataset or paths.dataset_file()))
    return lambda truth: ReplayPlanner(stored, truth)
