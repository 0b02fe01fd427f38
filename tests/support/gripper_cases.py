"""Grippers that several tests use."""

from __future__ import annotations

from pathlib import Path

from megrasp_core.grippers import Gripper

OWN_JAWS = (
    "franka_hand",
    "google_gripper",
    "rethink_gripper",
    "robotiq_2f140",
    "robotiq_2f85",
    "robotiq_3f",
    "schunk_wsg32",
    "vx300s_gripper",
)

SENSIBLE = 'mass="0.02" pos="0 0 0" diaginertia="7e-6 7e-6 1e-6"'

MODEL = """
<mujoco>
  <default><geom type="box" size="0.005 0.01 0.03"/></default>
  <worldbody>
    <body name="palm">
      <inertial mass="0.5" pos="0 0 0.02" diaginertia="4e-4 4e-4 4e-4"/>
      <geom size="0.05 0.02 0.02" pos="0 0 0.02"/>
      {extra}
      <body name="left" pos="-0.04 0 0.07">
        <inertial {left}/>
        <joint name="left" type="slide" axis="1 0 0" range="0 0.04" frictionloss="{friction}"/>
        <geom/>
      </body>
      <body name="right" pos="0.04 0 0.07">
        <inertial mass="0.02" pos="0 0 0" diaginertia="7e-6 7e-6 1e-6"/>
        <joint name="right" type="slide" axis="-1 0 0" range="0 0.04"/>
        <geom/>
      </body>
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
</mujoco>
"""

DESCRIPTION = """
format: 1
name: pair
display_name: Pair of slides
kind: parallel
model: model.xml
mount_from_model: {{xyz: [0, 0, 0], quat: [0, 0, 0, 1]}}
tcp: [0, 0, 0.08]
postures:
  open: {{joints: {{left: {open_left}, right: 0.0}}}}
  closed: {{joints: {{left: 0.035, right: 0.035}}}}
actuation:
  left: {{kp: 2000, force: 40, damping: 20, armature: 0.1}}
  right: {{kp: 2000, force: 40, damping: 20, armature: 0.1}}
max_width: 0.07
min_width: 0.0
fingers: [[left], [right]]
symmetry: 1
licence: Apache-2.0
source: a test
"""


def slide_pair(
    folder: Path,
    *,
    extra: str = "",
    actuators: str = "",
    left: str = SENSIBLE,
    friction: float = 0.0,
    open_left: float = 0.0,
) -> Gripper:
    """Write and load two slides on a palm.

    `extra`: more geoms in the palm; `actuators`: drives in the model file; `left`, `friction`:
    inertia and joint friction of the left slide; `open_left`: its open position (m).
    """
    model = MODEL.format(extra=extra, actuators=actuators, left=left, friction=friction)
    (folder / "model.xml").write_text(model)
    (folder / "gripper.yaml").write_text(DESCRIPTION.format(open_left=open_left))
    return Gripper.from_path(folder)
