"""Offline side of the suite: objects, grasp synthesis, scenes, training, evaluation. No ROS."""
