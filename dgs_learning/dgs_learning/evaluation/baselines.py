"""Planners by name: DGS-Net and what it is compared with. All share the planner's callable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from dgs_learning import paths
from dgs_learning.evaluation.protocol import PlannerFactory

if TYPE_CHECKING:
    from dgs_grasp_planner.planner import DgsNetPlanner
    from dgs_learning.evaluation.replay import StoredGrasps

PLANNERS = {
    "dgs_net": "the network",
    "top_down": "geometric: segmentation, principal axes, hands from above matched to the width",
    "random_prior": "grasps of the training set dropped at random object points, then the same checks",
    "true_point": "the network's grasps at true reference points (objects of the dataset only)",
    "true_rest": "the network's best point with the nearest validated grasp (objects of the dataset only)",
    "replay": "validated grasps of the dataset on the true poses: measures the harness (objects of the dataset only)",
}


@dataclass(frozen=True)
class PlannerChoice:
    """Which planner an experiment runs.

    Attributes:
        name: one of `PLANNERS`.
        model: name of the network's weights, models_dir: where they lie.
        dataset: dataset file of the planners that replay its grasps.
        without: stages of the network's planner that are left out, of `loss_chain.STAGES`.
    """

    name: str = "dgs_net"
    model: str = "dgs_net"
    models_dir: Path | None = None
    dataset: Path | None = None
    without: tuple[str, ...] = ()

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
        "true_point": _true_point,
        "true_rest": _true_rest,
        "replay": _replay,
    }
    return makers[choice.name](choice)


def _network(choice: PlannerChoice) -> DgsNetPlanner:
    import torch

    from dgs_grasp_planner.planner import DgsNetPlanner, PlannerConfig
    from dgs_learning.evaluation.loss_chain import without

    torch.set_num_threads(1)  # sums of several threads depend on their number
    config = without(PlannerConfig(), choice.without)
    planner = DgsNetPlanner.from_weights(choice.models_dir or paths.models_dir(), choice.model, config)
    planner.warm_up()
    return planner


def _dgs_net(choice: PlannerChoice) -> PlannerFactory:
    planner = _network(choice)
    return lambda truth: planner


def _stored(choice: PlannerChoice) -> StoredGrasps:
    from dgs_learning.dataset import load_dataset
    from dgs_learning.evaluation.replay import StoredGrasps

    return StoredGrasps(load_dataset(choice.dataset or paths.dataset_file()))


def _true_point(choice: PlannerChoice) -> PlannerFactory:
    from dgs_learning.evaluation.loss_chain import TruePointPlanner

    planner, stored = _network(choice), _stored(choice)
    return lambda truth: TruePointPlanner(planner, stored, truth)


def _true_rest(choice: PlannerChoice) -> PlannerFactory:
    from dgs_learning.evaluation.loss_chain import TrueRestPlanner

    planner, stored = _network(choice), _stored(choice)
    return lambda truth: TrueRestPlanner(planner, stored, truth)


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
    from dgs_learning.evaluation.replay import ReplayPlanner

    stored = _stored(choice)
    return lambda truth: ReplayPlanner(stored, truth)
