"""Motions of hand and fingers, and the loop that steps a world through them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .world import World

WATCH_PERIOD = 0.01
"""Contacts are looked at this often, s; gaps of up to 50 ms are five looks."""

Watch = Callable[[], bool]
"""Looks at the world between steps; False ends the motion."""


@dataclass(frozen=True, eq=False)
class Motion:
    """What is commanded at each step of a phase.

    positions: (steps, 3) target of the hand, m, or None to leave it. quaternions: (steps, 4), w
        first, or None.
    shares: (steps,) finger command, 0 open to 1 closed, or None.
    """

    steps: int
    positions: NDArray[np.float64] | None = None
    quaternions: NDArray[np.float64] | None = None
    shares: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Shake:
    """A circle, faded in and out: two axes moved sinusoidally a quarter period apart.

    amplitude: m or rad along each axis; frequency in Hz; duration and fade in s.
    """

    amplitude: float
    frequency: float = 2.0
    duration: float = 1.0
    fade: float = 0.1

    def offsets(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement (n, 2) along the two axes at times (n,) since the start."""
        radius = self.amplitude * smooth(np.minimum(times, self.duration - times) / self.fade)
        phase = 2.0 * np.pi * self.frequency * times
        return radius[:, None] * np.stack([np.cos(phase), np.sin(phase)], axis=1)


def smooth(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Minimum-jerk course from 0 to 1 with zero speed and acceleration at both ends."""
    x = np.clip(share, 0.0, 1.0)
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


def step_times(world: World, duration: float) -> NDArray[np.float64]:
    """Times (n,) in s since the start of a phase at the ends of its steps."""
    timestep = world.model.opt.timestep
    return timestep * np.arange(1, round(duration / timestep) + 1)


def closing(world: World, duration: float, ramp: float, start: float = 0.0) -> Motion:
    """Close the fingers from the share `start` of their way: the command goes to closed within
    `ramp` s and stays until `duration`.
    """
    times = step_times(world, duration)
    return Motion(len(times), shares=start + (1.0 - start) * np.minimum(1.0, times / ramp))


def advance(world: World, motion: Motion, watch: Watch | None = None) -> bool:
    """Step the world through a motion; False when `watch` or an instability ended it early."""
    hand = world.hand
    every = max(1, round(WATCH_PERIOD / world.model.opt.timestep))
    for start in range(0, motion.steps, every):
        stop = min(start + every, motion.steps)
        if motion.positions is None and motion.shares is None:
            world.step(stop - start)
        else:
            for step in range(start, stop):
                if motion.positions is not None:
                    hand.position[:] = motion.positions[step]
                if motion.quaternions is not None:
                    hand.quaternion[:] = motion.quaternions[step]
                if motion.shares is not None:
                    hand.drive(motion.shares[step])
                world.step()
        if world.unstable() or (watch is not None and not watch()):
            return False
    return True


class ContactWatch:
    """Which of some objects stay in contact with the gripper, gaps of up to 50 ms allowed."""

    GAP = 0.05

    def __init__(self, world: World, objects: set[int]) -> None:
        self.world = world
        self.held = set(objects)
        self._last = dict.fromkeys(objects, float(world.data.time))

    def __call__(self) -> bool:
        """Look at the contacts; False once no object is held any more."""
        now = self.world.data.time
        for index in self.world.touched()[0] & self.held:
            self._last[index] = now
        self.held = {i for i in self.held if now - self._last[i] <= self.GAP + 1e-9}
        return bool(self.held)
