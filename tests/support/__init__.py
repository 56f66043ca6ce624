"""Helpers shared by the tests: node processes, ROS environment, domain ids, a spinning client node."""
