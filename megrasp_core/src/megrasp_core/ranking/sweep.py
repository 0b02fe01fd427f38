"""What the fingers meet on their way from the opening to the contact.

Fingers on linkages swing forward while they close: tips that start over the floor, or over a
neighbour, end in it, and the gripper jams or closes on nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from megrasp_core.ranges import COUNT, LENGTH, Range, check_ranges

from .contact import Contacts
from .observation import PointState, SceneObservation
from .probe import GripperProbe

__all__ = ["SweepSettings", "sweep_hits", "sweep_points"]


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

    def __post_init__(self) -> None:
        check_ranges(
            self,
            steps=COUNT,
            play=LENGTH,
            edge=LENGTH,
            max_structure=COUNT,
            max_inside=COUNT,
            back_off=Range(0, several=True),
            least_engagement=LENGTH,
        )


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
    if probe.closing is None or probe.volume is None or not len(rows) or not s.steps:
        return hits
    poses = np.asarray(world_from_gripper)[rows]
    _, structure, inside = _swept(observation, probe, poses, contacts.part(rows), s)
    hits[rows] = (structure.sum(axis=2).max(axis=1) > s.max_structure) | (
        inside.sum(axis=2).max(axis=1) > s.max_inside
    )
    return hits


def sweep_points(
    observation: SceneObservation,
    probe: GripperProbe,
    world_from_gripper: np.ndarray,
    contacts: Contacts,
    settings: SweepSettings | None = None,
) -> np.ndarray:
    """Where (K, 3) the fingers of one grasp hit something while they close.

    Args:
        observation: what was seen.
        probe: the gripper at the opening that the grasp starts from.
        world_from_gripper: (4, 4) pre-grasp.
        contacts: of the grasp, arrays of length 1.
        settings: see `SweepSettings`.
    """
    s = settings or SweepSettings()
    if probe.closing is None or probe.volume is None or not np.isfinite(contacts.width).all():
        return np.zeros((0, 3), dtype=np.float32)
    points, structure, inside = _swept(
        observation, probe, np.asarray(world_from_gripper)[None], contacts, s
    )
    return points[structure | inside]


def _swept(
    observation: SceneObservation,
    probe: GripperProbe,
    poses: np.ndarray,
    contacts: Contacts,
    s: SweepSettings,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Finger points (n, steps, P, 3) of poses (n, 4, 4) on their way, and which are in structure
    and in bodies beside the material.
    """
    path, volume = probe.closing, probe.volume
    assert path is not None and volume is not None
    width, offset = contacts.width.astype(float), contacts.offset.astype(float)
    last = np.maximum(path.share_at(width + 2 * s.play), probe.share)
    parts = np.arange(1, s.steps + 1) / s.steps
    fingers = path.points_at(probe.share + (last - probe.share)[:, None] * parts)
    poses = poses.astype(np.float32)
    turned = fingers @ poses[:, None, :3, :3].swapaxes(2, 3)
    points = turned + poses[:, None, None, :3, 3]
    state = observation.classify(points.reshape(-1, 3)).reshape(fingers.shape[:3])
    x = np.abs(fingers[..., 0] - (volume.centre + offset)[:, None, None])
    grasped = x <= (width / 2 + s.edge)[:, None, None]
    return points, state >= PointState.WALL, (state == PointState.INSIDE) & ~grasped
