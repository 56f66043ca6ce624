"""Grasps for clouds in files, without ROS."""
