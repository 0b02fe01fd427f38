"""Clutter removal as VGN, GIGA and Edge-Grasp describe it: rounds of five objects, packed or in a
pile, one view from the side, one grasp at a time (docs/evaluation.md, "Packed and pile").

- `protocol`: the rounds and their end; `report`: many rounds, result file; `table`: beside
  published rates; `picture`: one round.
- `world`: what a round needs of a physics engine; `bullet_world`, `bullet_hand`: PyBullet;
  `mujoco_world`: the project's own.
- `scenes`: how the objects come to lie there; `side_view`: what the camera sees, and its noise.
- `object_files`: objects from a folder, URDF files among them, and which of them fit a gripper.
"""
