"""Planners by the names of their proposers: DGS-Net and what it is compared with. All share the stages that follow."""

from __future__ import annotations

from collections.abc import Callable
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
from dgs_learning.evaluation.protocol import PlannerFactory, Truth

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


@cache
def planner_factory(choice: PlannerChoice) -> PlannerFactory:
    """The factory of a planner; what is loaded stays for the life of the process.

    Raises:
        DgsError: the dataset cannot be read, or the weights are missing or altered.
    """
    torch.set_num_threads(1)  # sums of several threads depend on their number
    shape_completion()
    makers = [_maker(name, choice) for name in choice.proposers]
    settings = PlannerSettings(without=choice.without, edge=choice.edge)

    def factory(truth: Truth) -> GraspPlanner:
        return GraspPlanner([ablated(make(truth), choice.ablate) for make in makers], settings)

    return factory


def _maker(name: str, choice: PlannerChoice) -> Callable[[Truth], Proposer]:
    """Makes the proposer of a scene; what it needs is loaded here."""
    if name in ("true_point", "true_rest"):
        network, stored = _network(choice.models_dir, choice.model), StoredGrasps(_dataset(choice.dataset))
        kind = TruePoint if name == "true_point" else TrueRest
        return lambda known: kind(network, stored, known)
    if name == "replay":
        stored = StoredGrasps(_dataset(choice.dataset))
        return lambda known: Replay(stored, known)
    proposer: Proposer  # one that does not look at the truth
    if name == "dgs_net":
        proposer = _network(choice.models_dir, choice.model)
    elif name == "random_prior":
        proposer = RandomPrior(prior_of(_dataset(choice.dataset)))
    elif name in ("push", "drag"):
        beside = (-choice.half_width, choice.half_width)
        proposer = (Push if name == "push" else Drag)(PushSettings(free=beside, turning=beside))
    else:
        proposer = (GEOMETRIC | {"top_down": TopDown})[name]()
    return lambda _: proposer


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


_dataset = cache(load_dataset)
