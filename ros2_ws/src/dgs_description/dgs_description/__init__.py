"""Names, frames, limits and kinematic models of the arm, the hand, the camera and the table.

No ROS here but in `*_msgs.py` and `base_node.py`.
"""
