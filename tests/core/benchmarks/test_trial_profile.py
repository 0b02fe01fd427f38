"""The profile of a trial times what a trial does."""

from __future__ import annotations

import numpy as np
import pytest
from jaw_and_boxes import Jaw, down, make_box

from megrasp_core.benchmarks.trial_profile import STAGES, profile_trials
from megrasp_core.grippers import load_gripper
from megrasp_core.simulation import FreeSpaceRig


@pytest.mark.parametrize("name", ["robotiq_2f85", "shadow_hand"])
def test_the_stages_give_the_states_of_a_step(name):
    """With dense constraint Jacobians, and with the sparse ones of hands."""
    rig = FreeSpaceRig(load_gripper(name), make_box((0.04, 0.04, 0.04)))
    model, data = rig.world.model, rig.world.data
    rig.world.place_gripper(np.eye(4))
    rig.world.hand.drive(1.0)
    start = rig.world.save()
    rig.world.step(20)
    after = data.qpos.copy()
    rig.world.restore(start)
    for _ in range(20):
        for functions in STAGES.values():
            for function in functions:
                function(model, data)
    # mj_step checks the state as well, which changes nothing.
    np.testing.assert_array_equal(data.qpos, after)


def test_a_profile_adds_up_and_leaves_the_rig_as_it_was():
    rig = FreeSpaceRig(Jaw(), make_box((0.03, 0.03, 0.05)))  # type: ignore[arg-type]
    pose = down(0, 0, -0.02)
    before = rig.trial(pose)
    inside = down(0.04, 0, -0.02)
    profile = profile_trials(rig, [pose, inside, pose])
    assert before.success and rig.trial(pose) == before
    assert profile["trials"] == 2
    assert profile["steps"] == pytest.approx(2.6 / rig.world.model.opt.timestep, rel=0.01)
    assert sum(profile["shares"].values()) == pytest.approx(1.0)
    assert set(profile["shares"]) == {*STAGES, "around"}
    assert profile["shares"]["solver"] > 0.02 and profile["contacts"] >= 2
    assert rig.world.step.__func__ is type(rig.world).step
