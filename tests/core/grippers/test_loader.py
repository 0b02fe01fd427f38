"""What the loader leaves out of a model file, and the drives that it replaces."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from megrasp_core.grippers import Gripper

MODEL = """
<mujoco>
  <default><geom type="box" size="0.005 0.01 0.03"/></default>
  <worldbody>
    <body name="palm">
      <inertial mass="0.5" pos="0 0 0.02" diaginertia="4e-4 4e-4 4e-4"/>
      <geom size="0.05 0.02 0.02" pos="0 0 0.02"/>
      {extra}
      <body name="left" pos="-0.04 0 0.07">
        <inertial mass="0.02" pos="0 0 0" diaginertia="7e-6 7e-6 1e-6"/>
        <joint name="left" type="slide" axis="1 0 0" range="0 0.04"/>
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
mount_from_model: {xyz: [0, 0, 0], quat: [0, 0, 0, 1]}
tcp: [0, 0, 0.08]
postures:
  open: {joints: {left: 0.01, right: 0.0}}
  closed: {joints: {left: 0.035, right: 0.035}}
actuation:
  left: {kp: 2000, force: 40, damping: 20, armature: 0.1}
  right: {kp: 2000, force: 40, damping: 20, armature: 0.1}
max_width: 0.07
min_width: 0.0
fingers: [[left], [right]]
symmetry: 1
licence: Apache-2.0
source: a test
"""


def pair(folder: Path, extra: str = "", actuators: str = "") -> Gripper:
    """Load the pair of slides with more geoms in its palm, and with drives in the file."""
    (folder / "model.xml").write_text(MODEL.format(extra=extra, actuators=actuators))
    (folder / "gripper.yaml").write_text(DESCRIPTION)
    return Gripper.from_path(folder)


@pytest.mark.parametrize(("group", "kept"), [(0, 1), (2, 1), (3, 0), (5, 0)])
def test_hidden_outlines_are_left_out(tmp_path: Path, group: int, kept: int) -> None:
    """A geom that touches nothing is part of the surface only where a viewer would show it."""
    outline = f'<geom size="0.2 0.2 0.2" contype="0" conaffinity="0" mass="0" group="{group}"/>'
    gripper = pair(tmp_path, outline)
    widest = max(float(np.abs(mesh.vertices).max()) for mesh in gripper.body_meshes())
    assert widest == pytest.approx(0.2 if kept else 0.05)
    assert len(gripper.body_meshes("collision")) == 3


def test_hidden_contact_geoms_stay(tmp_path: Path) -> None:
    """What touches is collision geometry, whatever its group."""
    gripper = pair(tmp_path, '<geom size="0.06 0.02 0.02" group="4"/>')
    assert len(gripper.body_meshes("collision")) == 4


@pytest.mark.parametrize(
    "drive",
    [
        '<motor joint="left" gear="100"/>',
        '<velocity joint="left" kv="10"/>',
        '<position joint="left" kp="5"/>',
        "",
    ],
)
def test_named_joints_hold_their_posture(tmp_path: Path, drive: str) -> None:
    """Whatever drove the joint in the file, it is driven once, by position, and rests there."""
    gripper = pair(tmp_path, actuators=drive)
    model = gripper.model
    assert sorted(model.actuator_trnid[:, 0]) == [0, 1]
    np.testing.assert_allclose(model.actuator_biasprm[:, 1], -2000.0)
    np.testing.assert_allclose(model.actuator_forcerange, [[-40.0, 40.0]] * 2)
    data = mujoco.MjData(model)
    data.qpos[:] = gripper.qpos("open")
    data.ctrl[:] = gripper.control("closed")
    for _ in range(500):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qpos, gripper.qpos("closed"), atol=1e-3)
