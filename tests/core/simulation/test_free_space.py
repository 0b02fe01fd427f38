"""The free-space trial of labels."""

from __future__ import annotations

import numpy as np
import pytest
from jaw_and_boxes import Jaw, make_box

from megrasp_core.simulation import FreeSpaceRig, Reason

BOX = (0.04, 0.06, 0.05)


def from_above(shift: tuple[float, float] = (0.0, 0.0), tip: float = -0.015) -> np.ndarray:
    """Object-from-gripper with the jaw's tips at height `tip` over the box's centre."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = *shift, tip + Jaw.tip
    return pose


@pytest.mark.parametrize("timestep", [0.002, 0.004])
def test_box_is_held(jaw: Jaw, timestep: float) -> None:
    result = FreeSpaceRig(jaw, make_box(BOX), timestep=timestep).trial(from_above())
    assert result.success and result.reason is Reason.SUCCESS and result.depth == 0.0
    assert result.slip < 0.005 and 0.5 < result.quality <= 1.0


@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        (from_above((0.03, 0.0)), Reason.START_COLLISION),
        (from_above((0.0, 0.06)), Reason.NO_CONTACT),
        (from_above(tip=0.03), Reason.NO_CONTACT),
    ],
)
def test_misses(jaw: Jaw, pose: np.ndarray, reason: Reason) -> None:
    result = FreeSpaceRig(jaw, make_box(BOX)).trial(pose)
    assert not result.success and result.reason is reason


def test_slippery_or_heavy_box_is_shaken_off(jaw: Jaw) -> None:
    slippery = FreeSpaceRig(jaw, make_box(BOX), friction=0.01).trial(from_above())
    assert slippery.reason is Reason.SLIPPED
    heavy = FreeSpaceRig(jaw, make_box(BOX, mass=20.0)).trial(from_above())
    assert heavy.reason is Reason.SLIPPED


def test_trials_do_not_depend_on_those_before(jaw: Jaw) -> None:
    rig = FreeSpaceRig(jaw, make_box(BOX))
    rig.trial(from_above())
    after_first = rig.world.object_poses()
    rig.trial(from_above((0.0, 0.025)))
    rig.trial(from_above())
    assert np.array_equal(rig.world.object_poses(), after_first)


def test_object_follows_the_shakes_and_comes_back(jaw: Jaw) -> None:
    rig = FreeSpaceRig(jaw, make_box(BOX), timestep=0.002)
    pose = from_above()
    assert rig.trial(pose).success
    slip = rig.world.object_poses()[0] @ pose
    assert np.linalg.norm(slip[:3, 3]) < 0.004
