"""Depth camera, depth topics or a bag to one clean point cloud."""
