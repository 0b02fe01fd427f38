"""`megrasp gripper ...`."""
