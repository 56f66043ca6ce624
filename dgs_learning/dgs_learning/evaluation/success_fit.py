"""Fits `dgs_grasp_planner.success` to trials, and says how well it tells what will hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import rankdata

from dgs_description.frames import Array
from dgs_grasp_planner.success import EVIDENCE, MOST
from dgs_learning.evaluation.trials import Trials

PRIOR = 10.0
"""Weight of the squares of the model's weights: a normal prior of deviation 0.3."""
FOLDS = 8
"""Of scenes, each predicted by a model that has not seen it."""
BINS = 10


def fit_success(trials: Trials) -> dict[str, Any]:
    """What `success.json` holds: per column of the evidence its mean, deviation and two weights; the bias.

    The model also has weights for worn hardware and for the engine; what is kept is hardware as new, and the mean of
    both engines.
    """
    mean, deviation = trials.evidence.mean(axis=0), trials.evidence.std(axis=0) + 1e-6
    weights = _fit(_design(trials, mean, deviation), trials.held)
    linear, square, rest = np.split(weights, [len(EVIDENCE), 2 * len(EVIDENCE)])
    rows = np.column_stack([mean, deviation, linear, square])
    bias = float(rest @ _condition(np.array([False]), np.array([0.5]))[0])
    return {
        "evidence": {name: np.round(row, 5).tolist() for name, row in zip(EVIDENCE, rows, strict=True)},
        "bias": round(bias, 5),
    }


def judge(trials: Trials) -> dict[str, Any]:
    """How well scenes that a model has not seen are predicted, the trial's hardware and engine being known.

    Returns:
        number of trials and scenes, share that held, area under the ROC curve of all and of parts where some held and
        some did not, and the reliability diagram: per tenth of the probability the number of trials, the mean
        prediction and the share that held.
    """
    mean, deviation = trials.evidence.mean(axis=0), trials.evidence.std(axis=0) + 1e-6
    design, scenes = _design(trials, mean, deviation), np.unique(trials.scene)
    fold = np.random.default_rng(0).permutation(len(scenes)) % FOLDS
    of = fold[np.searchsorted(scenes, trials.scene)]
    said = np.zeros(len(of))
    for k in range(FOLDS):
        said[of == k] = expit(design[of == k] @ _fit(design[of != k], trials.held[of != k]))
    parts = {"all": np.ones(len(of), bool), "new": ~trials.worn, "worn": trials.worn, "mujoco": trials.mujoco}
    place = np.minimum((said * BINS).astype(int), BINS - 1)
    return {
        "trials": len(of),
        "scenes": len(scenes),
        "held": round(float(trials.held.mean()), 4),
        "auc": {
            name: round(area_under_curve(said[m], trials.held[m]), 4)
            for name, m in parts.items()
            if len(np.unique(trials.held[m])) == 2
        },
        "reliability": [
            [int(m.sum()), round(float(said[m].mean()), 3), round(float(trials.held[m].mean()), 3)]
            for m in (place == k for k in range(BINS))
            if m.any()
        ],
    }


def area_under_curve(value: Array, held: NDArray[np.bool_]) -> float:
    """Share of the pairs of one that held and one that did not in which the former has the larger value."""
    good = int(held.sum())
    ranks = rankdata(value)[held].sum()
    return float((ranks - good * (good + 1) / 2) / (good * (len(held) - good)))


def _condition(worn: NDArray, mujoco: NDArray) -> Array:
    return np.column_stack([worn, mujoco, worn * mujoco, np.ones(len(worn))]).astype(np.float64)


def _design(trials: Trials, mean: Array, deviation: Array) -> Array:
    z = np.clip((trials.evidence - mean) / deviation, -MOST, MOST)
    return np.column_stack([z, z**2 - 1, _condition(trials.worn, trials.mujoco)])


def _fit(design: Array, held: NDArray[np.bool_]) -> Array:
    """Weights of the most likely logistic model under the prior; the last one, the bias, is free."""
    sign = 2.0 * held - 1.0
    free = np.append(np.full(design.shape[1] - 1, PRIOR), 0.0)

    def loss(weights: Array) -> tuple[float, Array]:
        margin = sign * (design @ weights)
        slope = -(design.T @ (sign * expit(-margin))) + free * weights
        return float(np.logaddexp(0.0, -margin).sum() + (free * weights**2).sum() / 2), slope

    return np.asarray(minimize(loss, np.zeros(design.shape[1]), jac=True, method="L-BFGS-B").x)
