"""Planners by the names of their proposers: DGS-Net and what it is compared with. All share the stages that follow."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
import torch

from dgs_description.grasp import GraspSet
from dgs_grasp_planner.contact.shape_completion import shape_completion
from dgs_grasp_planner.load import GEOMETRIC
from dgs_grasp_planner.planner import SHIPPED, GraspPlanner, PlannerSettings
from dgs_grasp_planner.propose import Proposer
from dgs_grasp_planner.propose.dgs_net import DgsNet
from dgs_grasp_planner.propose.drag import Drag
from dgs_grasp_planner.propose.push import Push, PushSettings
from dgs_grasp_planner.scene import Scene
from dgs_learning import paths
from dgs_learning.dataset import load_dataset
from dgs_learning.evaluation.proposers.random_prior import RandomPrior, prior_of
from dgs_learning.evaluation.proposers.replay import Replay, StoredGrasps
from dgs_learning.evaluation.proposers.top_down import TopDown
from dgs_learning.evaluation.proposers.truth import TruePoint, TrueRest
from dgs_learning.evaluation.protocol import Truth

PROPOSERS = (*SHIPPED, "top_down", "random_prior", "true_point", "true_rest", "replay")
"""docs/evaluation.md says what each is."""
ABLATIONS = ("none", "pre_grasp", "offset")


@dataclass(frozen=True)
class PlannerChoice:
    """Which planner an experiment runs.

    Attributes:
        proposers: names, of `PROPOSERS`.
        without: stages that are left out, of `dgs_grasp_planner.planner.STAGES`.
        ablate: what is taken away from every proposal, as in Table II: "pre_grasp" (fixed open hand) or "offset".
        model: name of the network's weights; models_dir: where they lie, by default the hand's.
        dataset: dataset file of the proposers that use its grasps, by default the hand's.
        edge: the table is where x is larger [m], frame *table*; None = no edge is known.
        half_width: of the table along its edge; nothing is pushed farther [m].
    """

    proposers: tuple[str, ...] = SHIPPED
    without: tuple[str, ...] = ()
    ablate: str = "none"
    model: str = "dgs_net"
    models_dir: Path = field(default_factory=paths.weights_dir)
    dataset: Path = field(default_factory=paths.dataset_file)
    edge: float | None = None
    half_width: float = np.inf

    def __post_init__(self) -> None:
        for name in self.proposers:
            if name not in PROPOSERS:
                raise ValueError(f"no proposer named {name!r}; there are {', '.join(PROPOSERS)}")
        if not self.proposers:
            raise ValueError("no proposer is named")
        if self.ablate not in ABLATIONS:
            raise ValueError(f"no ablation named {self.ablate!r}; there are {', '.join(ABLATIONS)}")
        PlannerSettings(without=self.without)


def planner_of(choice: PlannerChoice, truth: Truth) -> GraspPlanner:
    """The planner of one scene; what it loads stays for the life of the process.

    Args:
        truth: of the scene; ordinary proposers ignore it.

    Raises:
        DgsError: the dataset cannot be read, or the weights are missing or altered.
    """
    torch.set_num_threads(1)  # sums of several threads depend on their number
    shape_completion()
    proposers = [ablated(_proposer(name, choice, truth), choice.ablate) for name in choice.proposers]
    return GraspPlanner(proposers, PlannerSettings(without=choice.without, edge=choice.edge))


def _proposer(name: str, choice: PlannerChoice, truth: Truth) -> Proposer:
    if name == "dgs_net":
        return _network(choice.models_dir, choice.model)
    if name == "random_prior":
        return _random_prior(choice.dataset)
    if name == "replay":
        return Replay(_stored(choice.dataset), truth)
    if name in ("true_point", "true_rest"):
        kind = TruePoint if name == "true_point" else TrueRest
        return kind(_network(choice.models_dir, choice.model), _stored(choice.dataset), truth)
    if name in ("push", "drag"):
        beside = (-choice.half_width, choice.half_width)
        return (Push if name == "push" else Drag)(PushSettings(free=beside, turning=beside))
    return TopDown() if name == "top_down" else GEOMETRIC[name]()


def ablated(proposer: Proposer, ablate: str) -> Proposer:
    """Table II: the proposer without its pre-grasp ("pre_grasp": a fixed open hand) or its "offset" (zero)."""

    def less(scene: Scene) -> GraspSet:
        grasps = proposer(scene)
        if ablate == "pre_grasp":
            return replace(grasps, pre_grasp_joints=np.zeros_like(grasps.pre_grasp_joints))
        return replace(grasps, position=grasps.reference_point.copy())

    return proposer if ablate == "none" else less


@cache
def _network(directory: Path, model: str) -> DgsNet:
    network = DgsNet.from_weights(directory, model)
    network.warm_up()
    return network


@cache
def _stored(dataset: Path) -> StoredGrasps:
    return StoredGrasps(load_dataset(dataset))


@cache
def _random_prior(dataset: Path) -> RandomPrior:
    return RandomPrior(prior_of(load_dataset(dataset)))
