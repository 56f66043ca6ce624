"""Diversity D of a set of grasps (paper, section VI): the share of the variance that one direction explains."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def diversity(position: ArrayLike, rotation: ArrayLike, pre_grasp: ArrayLike, grasp: ArrayLike) -> float:
    """First eigenvalue of the covariance over the sum of all eigenvalues; the lower, the more diverse.

    The data points are T [m], R as axis times angle [rad], J_init and J_end [rad] side by side, as they are (the paper
    names no scaling).

    Args:
        position: (N, 3), rotation: (N, 3, 3), pre_grasp: (N, 20), grasp: (N, 20).

    Returns:
        in [0, 1]; NaN for fewer than two grasps or grasps that are all alike.
    """
    turn = np.asarray(rotation, dtype=np.float64).reshape(-1, 3, 3)
    if len(turn) < 2:
        return float("nan")
    columns = [
        np.asarray(position),
        Rotation.from_matrix(turn).as_rotvec(),
        np.asarray(pre_grasp),
        np.asarray(grasp),
    ]
    data = np.concatenate([np.asarray(c, dtype=np.float64).reshape(len(turn), -1) for c in columns], axis=1)
    eigenvalues = np.linalg.eigvalsh(np.cov(data.T))
    total = float(eigenvalues.sum())
    return float(eigenvalues[-1]) / total if total > 1e-12 else float("nan")
