"""The paper's experiments: grasps executed in simulated scenes, metrics, baselines, report."""
