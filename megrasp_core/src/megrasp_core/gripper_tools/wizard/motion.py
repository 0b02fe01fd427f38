"""Moving the joints: from driven lengths to joint positions, by couplings or by simulation."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.grippers import SETTLE_DAMPING

from .drives import Drive, joint_followers, joint_range, transmission

NEWTON_STEPS = 20
CONVERGED = 1e-9
SETTLE_TIME = 3.0
CALM = 1e-3
WARM_UP = 50
REACH_SAMPLES = 61
REACH_HALVINGS = 12
COUPLED = 5e-5
"""Coupled joints are at most so far (m or rad) from where the coupling puts them."""

STIFFNESS_SLIDE, STIFFNESS_HINGE = 5000.0, 20.0


class DriveMotion:
    """Positions of all joints for the lengths of the drives.

    A model whose couplings are joint equalities alone is solved directly; closed loops and tendon
    couplings are settled in simulation, without gravity and contacts, from where the last call
    ended.

    Args:
        model: compiled model.
        drives: its drives.
    """

    def __init__(self, model: mujoco.MjModel, drives: Sequence[Drive]) -> None:
        self.model = model
        self.drives = list(drives)
        self.followers = joint_followers(model)
        joint_equality = model.eq_type == mujoco.mjtEq.mjEQ_JOINT
        self.simulated = bool((~joint_equality & (model.eq_active0 == 1)).any()) or any(
            transmission(model, i) is None for i in range(model.nu)
        )
        self.ranges = np.array([joint_range(model, i) for i in range(model.njnt)]).reshape(-1, 2)
        self._data = mujoco.MjData(model)
        self._cache: dict[tuple[float, ...], NDArray[np.float64]] = {}
        if self.simulated:
            self._sim = self._simulation()
            self._sim_data = mujoco.MjData(self._sim)
            self._sim_data.qpos[:] = np.clip(model.qpos0, *self._bounds())
        else:
            self.drives = [self._reachable(index) for index in range(len(self.drives))]

    def rest(self) -> NDArray[np.float64]:
        """Return the lengths (n,) nearest to zero, which is where modellers put a joint's middle.

        The default positions of a model are none: some lie outside the limits.
        """
        return np.clip(np.zeros(len(self.drives)), self.low, self.high)

    def within(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> DriveMotion:
        """Return the same motion with other ranges (n,) of the drives."""
        out = copy.copy(self)
        out.drives = [
            replace(drive, low=float(a), high=float(b))
            for drive, a, b in zip(self.drives, low, high, strict=True)
        ]
        return out

    @property
    def low(self) -> NDArray[np.float64]:
        """Lowest lengths (n,)."""
        return np.array([drive.low for drive in self.drives])

    @property
    def high(self) -> NDArray[np.float64]:
        """Highest lengths (n,)."""
        return np.array([drive.high for drive in self.drives])

    def qpos(self, lengths: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return joint positions (nq,) for driven lengths (n,)."""
        key = tuple(np.round(lengths, 9))
        if key not in self._cache:
            solve = self._settle if self.simulated else self._solve
            self._cache[key] = solve(np.asarray(lengths, float))
        return self._cache[key].copy()

    def poses(self, lengths: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return model_from_body (nbody, 4, 4) for driven lengths (n,)."""
        self._data.qpos[:] = self.qpos(lengths)
        mujoco.mj_kinematics(self.model, self._data)
        out = np.tile(np.eye(4), (self.model.nbody, 1, 1))
        out[:, :3, :3] = self._data.xmat.reshape(-1, 3, 3)
        out[:, :3, 3] = self._data.xpos
        return out

    def _bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        low, high = np.full(self.model.nq, -np.inf), np.full(self.model.nq, np.inf)
        low[self.model.jnt_qposadr], high[self.model.jnt_qposadr] = self.ranges.T
        return low, high

    def _solve(self, lengths: NDArray[np.float64]) -> NDArray[np.float64]:
        """Newton steps of least norm on drives and joint equalities, inside the limits."""
        model = self.model
        q0 = model.qpos0[model.jnt_qposadr]
        # What no drive moves rests where its spring does.
        held = np.where(model.jnt_stiffness > 0.0, model.qpos_spring[model.jnt_qposadr], q0)
        q = np.clip(held, *self.ranges.T)
        coefs = np.array([drive.coefs for drive in self.drives]).reshape(-1, model.njnt)
        for _ in range(NEWTON_STEPS):
            rows, errors = [coefs], [lengths - coefs @ q]
            for index in np.flatnonzero(model.eq_active0 == 1):
                row, error = self._equality(int(index), q, q0)
                rows.append(row[None])
                errors.append(np.array([error]))
            step = np.linalg.lstsq(np.concatenate(rows), np.concatenate(errors), rcond=None)[0]
            moved = np.clip(q + step, *self.ranges.T) - q
            q = q + moved
            if np.abs(moved).max(initial=0.0) < CONVERGED:
                break
        out = model.qpos0.copy()
        out[model.jnt_qposadr] = q
        return out

    def _reachable(self, index: int) -> Drive:
        """Return a drive with its range cut to where the joints coupled to it keep their limits;
        as it is where they never do.
        """
        drive = self.drives[index]
        if not set(drive.joints) & set(self.followers.values()):
            return drive
        times = np.linspace(drive.low, drive.high, REACH_SAMPLES)
        if self._fits(index, drive.low) and self._fits(index, drive.high):
            return drive
        fits = np.array([self._fits(index, float(length)) for length in times])
        if not fits.any():
            return drive
        borders = np.flatnonzero(np.diff(np.concatenate([[0], fits, [0]]).astype(int)))
        runs = borders.reshape(-1, 2)
        first, last = runs[int(np.argmax(runs[:, 1] - runs[:, 0]))]
        ends = []
        for inner, outer in ((first, first - 1), (last - 1, last)):
            good, bad = float(times[inner]), float(times[np.clip(outer, 0, len(times) - 1)])
            for _ in range(REACH_HALVINGS):
                half = (good + bad) / 2.0
                good, bad = (half, bad) if self._fits(index, half) else (good, half)
            ends.append(good)
        return replace(drive, low=ends[0], high=ends[1])

    def _fits(self, index: int, length: float) -> bool:
        """Whether a drive gets to a length, the others at rest, with all couplings kept."""
        lengths = self.rest()
        lengths[index] = length
        model = self.model
        qpos = self._solve(lengths)
        q, q0 = qpos[model.jnt_qposadr], model.qpos0[model.jnt_qposadr]
        off = [float(self.drives[index].coefs @ q) - length]
        off += [self._equality(int(i), q, q0)[1] for i in np.flatnonzero(model.eq_active0 == 1)]
        return float(np.abs(off).max()) <= COUPLED

    def _equality(
        self, index: int, q: NDArray[np.float64], q0: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], float]:
        """Return gradient (njnt,) and missing amount of one joint equality at q (njnt,)."""
        model = self.model
        first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        poly = np.polynomial.Polynomial(model.eq_data[index, :5])
        x = 0.0 if second < 0 else q[second] - q0[second]
        row = np.zeros(model.njnt)
        row[first] = 1.0
        if second >= 0:
            row[second] = -poly.deriv()(x)
        return row, float(poly(x) - (q[first] - q0[first]))

    def _simulation(self) -> mujoco.MjModel:
        """Return a copy of the model in which every drive is a servo and nothing touches."""
        sim = copy.copy(self.model)
        sim.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        sim.opt.gravity[:] = 0.0
        sim.dof_damping[:] += SETTLE_DAMPING * sim.dof_M0
        return sim

    def _settle(self, lengths: NDArray[np.float64]) -> NDArray[np.float64]:
        sim, data = self._sim, self._sim_data
        data.qvel[:] = 0.0
        if sim.na:
            data.act[:] = 0.0
        for step in range(int(SETTLE_TIME / sim.opt.timestep)):
            for drive, length in zip(self.drives, lengths, strict=True):
                if drive.actuator >= 0:
                    data.ctrl[drive.actuator] = drive.control(length)
                    continue
                joint = drive.joints[0]
                slide = sim.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
                stiffness = STIFFNESS_SLIDE if slide else STIFFNESS_HINGE
                error = length - data.qpos[sim.jnt_qposadr[joint]]
                data.qfrc_applied[sim.jnt_dofadr[joint]] = stiffness * error
            mujoco.mj_step(sim, data)
            if step > WARM_UP and np.abs(data.qvel).max(initial=0.0) < CALM:
                break
        return data.qpos.copy()
