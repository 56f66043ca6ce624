"""Proposers: from a scene to candidate grasps."""
