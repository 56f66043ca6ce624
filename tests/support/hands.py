"""What another hand than that of this process does."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from dgs_description.hand import CHOICE

_BLOCK = """
import numpy as np
from dgs_description.hand import HAND
from dgs_grasp_planner.planner import GraspPlanner
from dgs_learning.evaluation.proposers.top_down import top_down_grasps
rng = np.random.default_rng(0)
table = rng.uniform((-0.2, -0.2, 0.0), (0.2, 0.2, 0.001), (12_000, 3))
block = rng.uniform((-0.02, -0.03, 0.0), (0.02, 0.03, 0.10), (12_000, 3))
block = block[(np.abs(block / (0.02, 0.03, 0.1)) > (0.9, 0.9, 0.95)).any(axis=1)]
cloud = np.concatenate([table, block]).astype(np.float32)
found = GraspPlanner([top_down_grasps])(cloud, (0.47, 0.0, 0.88), rng).grasps
assert found.grasp_joints.shape[1] == HAND.joint_count
print(len(found))
"""


def in_process_of(hand: str | Path, code: str) -> str:
    """What a program prints in a process with that hand (a name or a folder)."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, CHOICE: str(hand)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def grasps_of_a_block(hand: str | Path) -> int:
    """How many grasps of a block on a table the hand finds by geometry alone: proposed, fitted, checked, ranked."""
    return int(in_process_of(hand, _BLOCK).split()[-1])
