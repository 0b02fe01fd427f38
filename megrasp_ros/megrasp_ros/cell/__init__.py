"""The simulated robot cell as a node."""
