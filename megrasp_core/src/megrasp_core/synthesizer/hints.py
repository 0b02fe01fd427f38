"""Why so few grasps, in words: what most drawn poses failed for, and what to do about it."""

from __future__ import annotations

import numpy as np

from megrasp_core.ranking import GripperProbe, PointState, SceneObservation

from .request import SynthesisRequest
from .scene_judge import Assessment

__all__ = ["hints"]

WORTH_TELLING = 0.2
"""Share of the drawn poses from which a reason gets a hint."""
CLEARLY = 0.01
"""Poses further than this (m) outside a face of the region are counted to that face."""
AXES = ("x", "y")


def hints(
    parts: list[tuple[Assessment, np.ndarray]],
    observation: SceneObservation,
    probe: GripperProbe,
    request: SynthesisRequest,
) -> tuple[str, ...]:
    """Sentences on the reasons that most poses failed for, the most frequent first.

    Args:
        parts: assessments, and the rows of each that count.
        observation: what was seen.
        probe: of the gripper.
        request: what was asked for.
    """
    reason = np.concatenate([part.check.reason[rows] for part, rows in parts])
    tcp = np.concatenate([part.poses.tcp[rows] for part, rows in parts])
    gripper = np.concatenate([part.poses.gripper[rows] for part, rows in parts])
    total, found = len(reason), []
    for name, count in zip(*np.unique(reason[reason != ""], return_counts=True), strict=True):
        if count < WORTH_TELLING * total:
            continue
        lead = f"{count} of {total} poses "
        rows = reason == name
        if name == "collision":
            found += [
                (n, f"{n} of {total} poses {text}")
                for n, text in _collisions(observation, probe, gripper[rows])
                if n >= WORTH_TELLING * total
            ]
        elif name == "workspace":
            found.append((count, lead + _outside(observation, tcp[rows])))
        elif name in _ADVICE:
            found.append((count, lead + _ADVICE[str(name)].format(request=request)))
    return tuple(text for _, text in sorted(found, key=lambda entry: -entry[0]))


_ADVICE = {
    "tilt": "are steeper than max_tilt {request.max_tilt:.2f} rad. Allow more if the robot can.",
    "unseen": "reach where nothing was seen, behind or under objects. Add a view from another "
    "side, or say assume_empty if the camera misses dark or shiny places.",
    "empty": "close on nothing: what is there is flatter than the fingertips are thick, or wider "
    "than the gripper opens. Try another gripper.",
    "sweep": "would close into the floor or a neighbour: the fingers come forward while they "
    "close. Try a gripper with parallel fingers for low objects.",
    "object": "take another object than target {request.target}: it is covered or too near to "
    "others. Clear those first.",
    "excluded": "repeat grasps that failed before. Make exclude shorter or exclude_radius "
    "{request.exclude_radius:g} m smaller.",
    "score": "pass the check with less than min_score {request.min_score:g}. Look again, or "
    "accept less.",
}


def _collisions(
    observation: SceneObservation, probe: GripperProbe, gripper: np.ndarray
) -> list[tuple[int, str]]:
    """How many poses (N, 4, 4) hit what, and what may be wrong."""
    local = probe.approach_points.astype(np.float64)
    points = (local @ gripper[:, :3, :3].transpose(0, 2, 1) + gripper[:, None, :3, 3]).reshape(
        -1, 3
    )
    state = observation.classify(points).reshape(len(gripper), -1)
    told = []
    floor = int((state == PointState.FLOOR).any(axis=1).sum())
    if floor:
        told.append(
            (floor, "reach below the floor. Check floor, region and gravity if objects are high.")
        )
    body = int((state == PointState.INSIDE).any(axis=1).sum())
    if body:
        told.append(
            (body, "are inside what was seen: too little room for this gripper among the objects.")
        )
    wall = state == PointState.WALL
    if wall.any():
        place = observation.box_coordinates(points).reshape(len(gripper), -1, 3)
        half = np.asarray(observation.half)
        for axis in range(2):
            for sign in (-1.0, 1.0):
                beyond = wall & (sign * place[..., axis] > half[axis])
                count = int(beyond.any(axis=1).sum())
                if count:
                    side = f"{'-' if sign < 0 else '+'}{AXES[axis]}"
                    text = (
                        f"hit the wall on the {side} side of the region. Is the region too small, "
                        "or in the wrong place?"
                    )
                    told.append((count, text))
    return told


def _outside(observation: SceneObservation, tcp: np.ndarray) -> str:
    place = observation.box_coordinates(tcp[:, :3, 3])
    half = np.asarray(observation.half)
    over = place[:, 2] - half[2]
    high = over > CLEARLY
    if high.mean() > 0.5:
        return (
            f"are at objects that stand higher than the region, by {1000 * float(over.max()):.0f} "
            "mm at most. Give a higher region."
        )
    return "lie beside or below the region. Is it too small, or in the wrong place?"
