"""Grasp synthesis for bin picking with any gripper: the ROS-free core."""
