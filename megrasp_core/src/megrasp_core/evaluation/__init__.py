"""Success rates in simulation.

- `protocols`: binpick, declutter and single, scene by scene; `outcome`: what came of one;
  `report`: many scenes, result file; `kept_scenes`: so that a stopped run goes on.
- `clutter_removal`: packed and pile, the rounds that others report, in PyBullet or MuJoCo.
- `planners`: what is evaluated, the model or the analytic baseline; `ceiling`: a planner that
  knows the true geometry, the most that a protocol allows; `search`: what it searches with.
- `statistics`: rates with intervals.
- `object_pool`: which objects are drawn, and which a gripper can hold at all.
- `calibration`: scores that are probabilities; `attempts`: from what a real cell recorded.
- `sample_rates`: raw samples of several models compared; `collision_causes`: why they collide.
"""
