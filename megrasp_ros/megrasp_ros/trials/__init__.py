"""The grasp server put to the test: its speed, hours of work, what no client should send."""
