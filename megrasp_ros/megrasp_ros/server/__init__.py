"""The grasp server: clouds in, ranked grasps out."""
