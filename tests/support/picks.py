"""Clouds of single things for the pick planner, and what must hold of every plan."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dgs_arm_executor.obstacle_cloud import CarriedBox, ObstacleCloud
from dgs_arm_executor.pick_plan import PickPlan
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.planning_scene import PlanningScene, SceneSettings
from dgs_arm_executor.safety import check_trajectory
from dgs_arm_executor.situation import ArmSituation
from dgs_description.cell import CELL, HOME_ARM
from dgs_description.frames import transform
from dgs_description.hand import HAND

PLACE = np.array([0.3, 0.1, -0.09])
NOTHING = ObstacleCloud()
EDGE = CELL.table_edge - CELL.workspace_centre[0]


def at_home(cloud: ObstacleCloud = NOTHING) -> ArmSituation:
    return ArmSituation(HOME_ARM, HAND.open_hand, cloud=cloud)


def carried_box(low: ArrayLike, high: ArrayLike) -> CarriedBox:
    """Between two corners (3,), along the axes of `hand_tcp`."""
    lower, upper = np.asarray(low, float), np.asarray(high, float)
    return CarriedBox(transform(position=(lower + upper) / 2), upper - lower)


def cylinder(x: float, y: float, height: float = 0.09, radius: float = 0.025) -> np.ndarray:
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, 3000)
    z = CELL.table_height + rng.uniform(0, height, 3000)
    return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), z], axis=1)


def slab(x: float, y: float, height: float = 0.015) -> np.ndarray:
    """The top of a flat thing of 0.12 x 0.18 m."""
    rng = np.random.default_rng(0)
    low, high = (x - 0.06, y - 0.09, height), (x + 0.06, y + 0.09, height)
    return rng.uniform(low, high, (20_000, 3)) + (0, 0, CELL.table_height)


def in_frame_table(points: np.ndarray) -> np.ndarray:
    return points - CELL.T_base_table[:3, 3]


def verify(planner: PickPlanner, plan: PickPlan, start: np.ndarray, cloud: ObstacleCloud) -> None:
    """The stages join, each passes the safety check, and each is free at every sample, by fresh checkers."""
    nearer = SceneSettings(arm_clearance=0.003)  # the planner looks every 0.03 rad
    scene, chosen = PlanningScene(cloud, nearer), plan.grasp
    released, gone = cloud.target_mask(chosen), cloud.carried_mask(chosen)
    hands = {
        "transfer": chosen.pre_grasp_joints,
        "approach": chosen.pre_grasp_joints,
        "advance": chosen.grasp_joints if chosen.drags else chosen.pre_grasp_joints,
        "retreat": chosen.grasp_joints,
        "lift": chosen.grasp_joints,
        "carry": chosen.grasp_joints,
        "home": HAND.open_hand if chosen.holds else chosen.pre_grasp_joints,
    }
    checkers = {stage: scene.checker(hand, released=released) for stage, hand in hands.items()}
    checkers["carry"] = scene.checker(hands["carry"], released=released, carried=plan.load.box, own=gone)
    checkers["transfer"] = scene.checker(chosen.pre_grasp_joints, cloud_clearance=0.005)
    checkers["retreat"] = checkers["lift"] = scene.checker(
        chosen.grasp_joints, released=released, hand_on_table=True
    )
    here = start
    for stage, trajectory in plan.trajectories.items():
        np.testing.assert_allclose(trajectory.positions[0], here, atol=1e-9)
        check_trajectory(trajectory.times, trajectory.positions, trajectory.velocities, here, hands[stage])
        assert checkers[stage].first_collision(trajectory.positions) is None, stage
        here = trajectory.end
    np.testing.assert_allclose(planner.ik.tcp(plan.trajectories["approach"].end), chosen.pose, atol=1e-8)
    lifted = planner.ik.tcp(plan.trajectories["lift"].end)
    up = lifted[:3, 3] - chosen.closing_pose[:3, 3]
    back = 0.0 if chosen.holds or chosen.drags else 0.05 * chosen.motion / np.linalg.norm(chosen.motion)
    np.testing.assert_allclose(up, np.array([0, 0, planner.settings.lift]) - back, atol=1e-8)
