"""Planners by the names of their proposers: DGS-Net and what it is compared with. All share the stages that follow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from dgs_grasp_planner.planner import SHIPPED, GraspPlanner, PlannerSettings
from dgs_grasp_planner.propose import Proposer
from dgs_grasp_planner.propose.level_pinch import LevelPinch
from dgs_learning import paths
from dgs_learning.evaluation.protocol import PlannerFactory, Truth

if TYPE_CHECKING:
    from dgs_grasp_planner.propose.dgs_net import DgsNet
    from dgs_learning.dataset import GraspDataset
    from dgs_learning.evaluation.proposers.replay import StoredGrasps

PROPOSERS = {
    "dgs_net": "the network",
    "level_pinch": "geometric: pinches across what is low and long",
    "top_down": "geometric: segmentation, principal axes, hands from above matched to the width",
    "random_prior": "grasps of the training set dropped at random object points",
    "true_point": "the network's grasps at true reference points (objects of the dataset only)",
    "true_rest": "the network's best point with the nearest validated grasp (objects of the dataset only)",
    "replay": "validated grasps of the dataset on the true poses: measures the harness (objects of the dataset only)",
}
ABLATIONS = ("none", "pre_grasp", "offset")


@dataclass(frozen=True)
class PlannerChoice:
    """Which planner an experiment runs.

    Attributes:
        proposers: names, of `PROPOSERS`.
        without: stages that are left out, of `dgs_grasp_planner.planner.STAGES`.
        ablate: what is taken away from every proposal, as in Table II: "pre_grasp" (fixed open hand) or "offset".
        model: name of the network's weights, models_dir: where they lie.
        dataset: dataset file of the proposers that use its grasps.
    """

    proposers: tuple[str, ...] = SHIPPED
    without: tuple[str, ...] = ()
    ablate: str = "none"
    model: str = "dgs_net"
    models_dir: Path | None = None
    dataset: Path | None = None

    def __post_init__(self) -> None:
        for name in self.proposers:
            if name not in PROPOSERS:
                raise ValueError(f"no proposer named {name!r}; there are {', '.join(PROPOSERS)}")
        if not self.proposers:
            raise ValueError("no proposer is named")
        if self.ablate not in ABLATIONS:
            raise ValueError(f"no ablation named {self.ablate!r}; there are {', '.join(ABLATIONS)}")
        PlannerSettings(without=self.without)


@cache
def planner_factory(choice: PlannerChoice) -> PlannerFactory:
    """The factory of a planner; what is loaded stays for the life of the process.

    Raises:
        FileNotFoundError: there is no dataset.
        DgsError: the weights are missing or altered.
    """
    makers = [_maker(name, choice) for name in choice.proposers]
    settings = PlannerSettings(without=choice.without)

    def factory(truth: Truth) -> GraspPlanner:
        return GraspPlanner([_ablated(make(truth), choice.ablate) for make in makers], settings)

    return factory


def _maker(name: str, choice: PlannerChoice) -> Callable[[Truth], Proposer]:
    if name in ("true_point", "true_rest"):
        from dgs_learning.evaluation.proposers import truth

        network, stored = _network(choice), _stored(choice)
        kind = truth.TruePoint if name == "true_point" else truth.TrueRest
        return lambda known: kind(network, stored, known)
    if name == "replay":
        from dgs_learning.evaluation.proposers.replay import Replay

        stored = _stored(choice)
        return lambda known: Replay(stored, known)
    proposer = _unaware(name, choice)
    return lambda _: proposer


def _unaware(name: str, choice: PlannerChoice) -> Proposer:
    """A proposer that does not look at the truth."""
    if name == "dgs_net":
        return _network(choice)
    if name == "level_pinch":
        return LevelPinch()
    if name == "top_down":
        from dgs_learning.evaluation.proposers.top_down import TopDown

        return TopDown()
    from dgs_learning.evaluation.proposers.random_prior import RandomPrior, prior_of

    return RandomPrior(prior_of(_dataset(choice.dataset)))


def _ablated(proposer: Proposer, ablate: str) -> Proposer:
    if ablate == "none":
        return proposer
    from dgs_learning.evaluation.proposers.ablation import Ablated

    return Ablated(proposer, ablate)


def _network(choice: PlannerChoice) -> DgsNet:
    return _loaded(choice.models_dir or paths.models_dir(), choice.model)


@cache
def _loaded(directory: Path, model: str) -> DgsNet:
    import torch

    from dgs_grasp_planner.propose.dgs_net import DgsNet

    torch.set_num_threads(1)  # sums of several threads depend on their number
    network = DgsNet.from_weights(directory, model)
    network.warm_up()
    return network


def _stored(choice: PlannerChoice) -> StoredGrasps:
    from dgs_learning.evaluation.proposers.replay import StoredGrasps

    return StoredGrasps(_dataset(choice.dataset))


@cache
def _dataset(file: Path | None) -> GraspDataset:
    from dgs_learning.dataset import load_dataset

    return load_dataset(file or paths.dataset_file())
