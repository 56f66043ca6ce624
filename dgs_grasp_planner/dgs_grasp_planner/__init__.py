"""DGS-Net: dexterous grasps for every object of a single-view point cloud."""
