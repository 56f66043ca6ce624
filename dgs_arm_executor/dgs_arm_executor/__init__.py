"""Inverse kinematics, planning scene and trajectories: executes a predicted grasp."""
