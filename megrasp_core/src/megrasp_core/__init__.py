"""Grasp synthesis for bin picking with any gripper: the ROS-free core."""

__version__ = "0.1.0"
