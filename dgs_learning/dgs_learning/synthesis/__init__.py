"""Stage 1 and 2 of the grasp data generation (paper, section V)."""
