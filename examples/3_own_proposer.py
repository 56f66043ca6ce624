"""3. Plug a planner of your own in as a proposer: the stages that follow make its candidates safe. No ROS needed.

source ros2_ws/setup_env.sh && python examples/3_own_proposer.py
docs/architecture.md, "A proposer of your own", says how it comes into the running suite.
"""

import numpy as np

from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_grasp_planner.planner import GraspPlanner
from dgs_grasp_planner.scene import Scene

CLOSED = HAND.expand(np.tile([0.0, 0.7, 0.6], HAND.finger_count))
"""(J,) all fingers flexed [rad]."""


class FromAbove:
    """Comes straight down onto the middle of what it sees, in eight directions."""

    name = "from_above"

    def __call__(self, scene: Scene) -> GraspSet:
        """Candidates in the frame *table* (z up, origin on the table top)."""
        middle = scene.voxels.mean(axis=0)
        yaw = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
        cos, sin, zero = np.cos(yaw), np.sin(yaw), np.zeros(8)
        # Columns: the hand's x (palmar side), y and z (approach: straight down).
        rotation = np.stack([[cos, sin, zero], [sin, -cos, zero], [zero, zero, zero - 1]]).transpose(2, 0, 1)
        return GraspSet.of(
            self.name,
            position=np.tile(middle, (8, 1)),
            rotation=rotation,
            pre_grasp_joints=np.tile(HAND.pre_grasp(CLOSED), (8, 1)),
            grasp_joints=np.tile(CLOSED, (8, 1)),
            active_fingers=[True] * HAND.finger_count,
        )


def block_on_table(seed: int = 0) -> np.ndarray:
    """(N, 3) float32 points of a table and of a block of 40 x 80 x 60 mm that stands on it [m]."""
    rng = np.random.default_rng(seed)
    table = np.column_stack([rng.uniform((-0.2, -0.4), (0.2, 0.4), (20_000, 2)), np.zeros(20_000)])
    inside = rng.uniform((-0.02, -0.04, 0.0), (0.02, 0.04, 0.06), (12_000, 3))
    seen = (np.abs(inside) > (0.018, 0.038, 0.058)).any(axis=1)
    return np.concatenate([table, inside[seen]]).astype(np.float32)


if __name__ == "__main__":
    planner = GraspPlanner([FromAbove()])
    camera = (0.47, 0.0, 0.88)
    answer = planner(block_on_table(), camera, np.random.default_rng(0))
    print(f"{len(answer.grasps)} of 8 candidates are left; refused: {answer.rejected}")
    for k in range(len(answer.grasps)):
        grasp = answer.grasps[k]
        print(
            f"score {grasp.score:.2f}, contacts {grasp.quality:.2f}, TCP at {np.round(grasp.position, 3)} m"
        )
