"""Where the time of a free-space trial goes: MuJoCo's step, stage by stage, and what is around it.

The stages called one by one give the very states of `mj_step`, so what is timed is what is run.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.simulation import FreeSpaceRig, Reason

STAGES = {
    "links": (
        mujoco.mj_kinematics,
        mujoco.mj_comPos,
        mujoco.mj_tendon,
        mujoco.mj_makeM,
        mujoco.mj_factorM,
    ),
    "collision": (mujoco.mj_collision,),
    "constraints": (
        mujoco.mj_makeConstraint,
        mujoco.mj_transmission,
        mujoco.mj_projectConstraint,
    ),
    "forces": (mujoco.mj_fwdVelocity, mujoco.mj_fwdActuation, mujoco.mj_fwdAcceleration),
    "solver": (mujoco.mj_fwdConstraint,),
    "integration": (mujoco.mj_implicit,),
}
"""Stages of a step in order, for rigid bodies and the integrator of `set_options`."""


def profile_trials(
    rig: FreeSpaceRig, object_from_gripper: Iterable[NDArray[np.float64]]
) -> dict[str, Any]:
    """Run trials and say what share of their time each stage took.

    Args:
        rig: gripper and object; its world steps as before afterwards.
        object_from_gripper: poses (4, 4); those that collide at the start do not count.

    Returns:
        trials, steps a trial, contacts, constraints and solver iterations a step, and `shares` of
        the CPU time by stage; "around" is what is not MuJoCo's step.
    """
    model, data = rig.world.model, rig.world.data
    spent = dict.fromkeys(STAGES, 0.0)
    counts = {"steps": 0, "contacts": 0, "constraints": 0, "iterations": 0}

    def step(count: int = 1) -> None:
        for _ in range(count):
            for stage, functions in STAGES.items():
                start = time.perf_counter()
                for function in functions:
                    function(model, data)
                spent[stage] += time.perf_counter() - start
            counts["steps"] += 1
            counts["contacts"] += data.ncon
            counts["constraints"] += data.nefc
            counts["iterations"] += int(data.solver_niter[0])

    trials, total = 0, 0.0
    rig.world.step = step
    try:
        for pose in object_from_gripper:
            start = time.perf_counter()
            result = rig.trial(pose)
            if result.reason is not Reason.START_COLLISION:
                trials += 1
                total += time.perf_counter() - start
    finally:
        del rig.world.step
    steps = max(counts["steps"], 1)
    shares = {**spent, "around": total - sum(spent.values())}
    return {
        "trials": trials,
        "steps": counts["steps"] / max(trials, 1),
        **{name: counts[name] / steps for name in ("contacts", "constraints", "iterations")},
        "shares": {name: value / max(total, 1e-9) for name, value in shares.items()},
    }
