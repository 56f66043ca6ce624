"""Training of DGS-Net from the dataset file alone: needs torch, numpy and scipy, no ROS, no PyBullet, no Open3D."""
