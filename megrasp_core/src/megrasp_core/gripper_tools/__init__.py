"""What is done with a gripper before and beside grasping.

- `wizard`: from URDF or MJCF to a description.
- `check`: a gripper folder in full; `compare`, `fidelity`: against another model of the same
  gripper; `symmetry`: how exact it is.
- `posture_search`, with `posture_space` and `posture_trials`: the postures of a hand that hold
  most.
- `plain_jaws`: jaws with known answers, which the wizard is scored on.
- `family_check`: grippers of the procedural family put to the test.
"""
