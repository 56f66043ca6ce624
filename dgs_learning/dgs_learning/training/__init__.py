"""Training of DGS-Net from the dataset file alone: needs torch, numpy, scipy and PyYAML, but no ROS, no simulator."""
