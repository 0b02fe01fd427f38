"""What the fingers meet on their way from the opening to the contact.

Fingers on linkages swing forward while they close: tips that start over the floor, or over a
neighbour, end in it, and the gripper jams or closes on nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .contact import Contacts
from .observation import PointState, SceneObservation
from .probe import GripperProbe

__all__ = ["SweepSettings", "sweep_hits"]


@dataclass(frozen=True)
class SweepSettings:
    """How the way of the fingers is checked.

    Attributes:
        steps: postures tested between the opening and the contact, the latter included; 0: none.
        play: the pads stop so far from what is between them, on either side (m).
        edge: what is seen up to here beside the material is part of it (m): its steep sides, and
            what a camera smears over an edge.
        max_structure: so many finger points in floor or walls are tolerated.
        max_inside: so many in seen bodies beside the material; of those with less, as many succeed
            as of those with none.
        back_off: a grasp that hits is tried again so far back along its approach (m), nearest
            first.
        least_engagement: the fingertips have to reach so far past the top of the material after
            that (m).
    """

    steps: int = 5
    play: float = 0.003
    edge: float = 0.010
    max_structure: int = 0
    max_inside: int = 8
    back_off: tuple[float, ...] = (0.003, 0.006, 0.009, 0.012, 0.015)
    least_engagement: float = 0.008


def sweep_hits(
    observation: SceneObservation,
    probe: GripperProbe,
    world_from_gripper: np.ndarray,
    contacts: Contacts,
    settings: SweepSettings | None = None,
) -> np.ndarray:
    """Whether (N,) the fingers hit floor, walls, or seen bodies beside the grasped material
    between the opening of the probe and the contact.

    Args:
        observation: what was seen.
        probe: the gripper at the opening that the grasps start from.
        world_from_gripper: (N, 4, 4) pre-grasps.
        contacts: of the same grasps; false where nothing is between the fingers.
        settings: see `SweepSettings`.
    """
    s = settings or SweepSettings()
    hits = np.zeros(len(world_from_gripper), dtype=bool)
    rows = np.flatnonzero(np.isfinite(contacts.width))
    path, volume = probe.closing, probe.volume
    if path is None or volume is None or not len(rows) or not s.steps:
        return hits
    width, offset = contacts.width[rows].astype(float), contacts.offset[rows].astype(float)
    last = np.maximum(path.share_at(width + 2 * s.play), probe.share)
    parts = np.arange(1, s.steps + 1) / s.steps
    fingers = path.points_at(probe.share + (last - probe.share)[:, None] * parts)
    poses = np.asarray(world_from_gripper)[rows].astype(np.float32)
    turned = fingers @ poses[:, None, :3, :3].swapaxes(2, 3)
    state = observation.classify((turned + poses[:, None, None, :3, 3]).reshape(-1, 3))
    state = state.reshape(fingers.shape[:3])
    x = np.abs(fingers[..., 0] - (volume.centre + offset)[:, None, None])
    grasped = x <= (width / 2 + s.edge)[:, None, None]
    structure = (state >= PointState.WALL).sum(axis=2).max(axis=1)
    inside = ((state == PointState.INSIDE) & ~grasped).sum(axis=2).max(axis=1)
    hits[rows] = (structure > s.max_structure) | (inside > s.max_inside)
    return hits
