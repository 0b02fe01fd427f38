"""Labels of what a model itself proposes, for its confidence.

- `samples`: raw samples in stored scenes.
- `rollouts`: bins that the model clears, stage by stage.
- `attempts`: what a real cell recorded, as scenes.
"""
