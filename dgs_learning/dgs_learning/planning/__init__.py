"""Measurement of the arm's pick planner: random cells, an OMPL baseline, exhaustive search, a check in PyBullet."""
