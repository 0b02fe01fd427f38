"""ROS 2 nodes of Megrasp."""
