"""What the loader leaves out of a model file, and the drives that it replaces."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from gripper_cases import slide_pair

from megrasp_core.grippers import Gripper


def pair(folder: Path, extra: str = "", actuators: str = "") -> Gripper:
    """Load the pair of slides with more geoms in its palm, and with drives in the file."""
    return slide_pair(folder, extra=extra, actuators=actuators, open_left=0.01)


@pytest.mark.parametrize(("group", "kept"), [(0, 1), (2, 1), (3, 0), (5, 0)])
def test_hidden_outlines_are_left_out(tmp_path: Path, group: int, kept: int) -> None:
    """A geom that touches nothing is part of the surface only where a viewer would show it."""
    outline = f'<geom size="0.2 0.2 0.2" contype="0" conaffinity="0" mass="0" group="{group}"/>'
    gripper = pair(tmp_path, outline)
    widest = max(float(np.abs(one.mesh.vertices).max()) for one in gripper.body_meshes())
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
