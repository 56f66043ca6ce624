"""Planners by the names of their proposers (`experiment.PROPOSERS`): DGS-Net and what it is compared with.

All share the stages that follow.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import torch

from dgs_description.grasp import GraspSet
from dgs_grasp_planner.contact.shape_completion import shape_completion
from dgs_grasp_planner.load import geometric
from dgs_grasp_planner.planner import GraspPlanner, PlannerSettings
from dgs_grasp_planner.propose import Proposer
from dgs_grasp_planner.propose.dgs_net import DgsNet
from dgs_grasp_planner.propose.push import PushSettings
from dgs_grasp_planner.scene import Scene
from dgs_learning.dataset import load_dataset
from dgs_learning.evaluation.experiment import WITH_NETWORK, Row
from dgs_learning.evaluation.proposers.random_prior import RandomPrior, prior_of
from dgs_learning.evaluation.proposers.replay import Replay, StoredGrasps
from dgs_learning.evaluation.proposers.top_down import top_down_grasps
from dgs_learning.evaluation.proposers.truth import TruePoint, TrueRest
from dgs_learning.evaluation.protocol import EDGE, Truth


def planner_of(row: Row, truth: Truth) -> GraspPlanner:
    """The planner of one scene of a row; what it loads stays for the life of the process.

    Args:
        truth: of the scene; ordinary proposers ignore it.

    Raises:
        DgsError: the dataset cannot be read, or the weights are missing or altered.
    """
    torch.set_num_threads(1)  # sums of several threads depend on their number
    shape_completion()
    proposers = [ablated(_proposer(name, row, truth), row.ablate) for name in row.proposers]
    with_network = any(name in WITH_NETWORK for name in row.proposers)
    keep_table = with_network and _network(row.models_dir, row.model).net.config.keep_table
    settings = PlannerSettings(keep_table=keep_table, edge=row.setting.edge, without=row.without)
    return GraspPlanner(proposers, settings)


def _proposer(name: str, row: Row, truth: Truth) -> Proposer:
    if name == "dgs_net":
        return _network(row.models_dir, row.model)
    if name == "random_prior":
        return _random_prior(row.dataset_file)
    if name == "replay":
        return Replay(_stored(row.dataset_file), truth)
    if name in ("true_point", "true_rest"):
        kind = TruePoint if name == "true_point" else TrueRest
        return kind(_network(row.models_dir, row.model), _stored(row.dataset_file), truth)
    if name == "top_down":
        return top_down_grasps
    half = row.workspace[1] / 2 + EDGE  # of the table along its edge: nothing is pushed farther
    return geometric(PushSettings(free=(-half, half), turning=(-half, half)))[name]


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
