"""Why so few grasps, in words: what most drawn poses failed for, and what to do about it."""

from __future__ import annotations

import numpy as np

from megrasp_core.ranking import GraspCheck, GripperProbe, PointState, SceneObservation

from .request import SynthesisRequest
from .scene_judge import Assessment

__all__ = ["hints", "sensor_doubt"]

WORTH_TELLING = 0.2
"""Share of the drawn poses from which a reason gets a hint."""
CLEARLY = 0.01
"""Poses further than this (m) outside a face of the region are counted to that face."""
HIDDEN = 0.15
"""Share of the cloud that cannot have been seen from where the sensor is said to be, from which
that is doubted."""
AXES = ("x", "y")


def hints(
    parts: list[tuple[Assessment, np.ndarray]],
    observation: SceneObservation,
    probe: GripperProbe,
    request: SynthesisRequest,
    offset: np.ndarray | None = None,
) -> tuple[str, ...]:
    """Sentences on the reasons that most poses failed for, the most frequent first; before them
    that the sensor is in the wrong place, where so much speaks for it.

    Args:
        parts: assessments, and the rows of each that count.
        observation: what was seen.
        probe: of the gripper.
        request: what was asked for.
        offset: (3,) from these coordinates to those in which places are told (m); None: the same.
    """
    reason = np.concatenate([part.check.reason[rows] for part, rows in parts])
    total, found = len(reason), []
    names, counts = np.unique(reason[reason != ""], return_counts=True)
    for name, count in zip(names.tolist(), counts.tolist(), strict=True):
        if count < WORTH_TELLING * total:
            continue
        failed = [(part, rows[part.check.reason[rows] == name]) for part, rows in parts]
        gripper, tcp, score, tilt = (
            np.concatenate([values(part)[rows] for part, rows in failed])
            for values in (
                lambda part: part.poses.gripper,
                lambda part: part.poses.tcp,
                lambda part: part.score,
                lambda part: part.check.tilt,
            )
        )
        if name == "collision":
            on_the_way = sum(_only_on_the_way(part.check, rows) for part, rows in failed)
            found += [
                (n, f"{n} of {total} poses {text}")
                for n, text in (
                    *_collisions(observation, probe, gripper),
                    (on_the_way, ON_THE_WAY),
                )
                if n >= WORTH_TELLING * total
            ]
            continue
        if name == "workspace":
            text = _outside(observation, tcp)
        elif name in _ADVICE:
            text = _ADVICE[name].format(
                request=request,
                tilt=float(np.nanmin(tilt, initial=np.inf)) - (request.max_tilt or 0.0),
                score=float(score.max()),
                width="the gripper"
                if probe.max_width is None
                else f"the {1000 * probe.max_width:.0f} mm that the gripper",
            )
        else:
            continue
        found.append((count, f"{count} of {total} poses {text}"))
    told = [text for _, text in sorted(found, key=lambda entry: -entry[0])]
    if {"unseen", "collision"} & set(names[counts >= WORTH_TELLING * total]):
        told = sensor_doubt(observation, offset) + told
    return tuple(told)


ON_THE_WAY = (
    "are free themselves and hit something on the way there. Choose another approach_direction, "
    "or a shorter approach_distance."
)
_ADVICE = {
    "tilt": "are steeper than max_tilt {request.max_tilt:.2f} rad, the least of them by "
    "{tilt:.2f}. Allow more if the robot can.",
    "unseen": "reach where nothing was seen, behind or under objects. Add a view from another "
    "side, or say assume_empty if the camera misses dark or shiny places.",
    "empty": "close on nothing: what is there is flatter than the fingertips are thick, or wider "
    "than {width} opens. Try another gripper.",
    "sweep": "would close into the floor or a neighbour: the fingers come forward while they "
    "close. Try a gripper with parallel fingers for low objects.",
    "object": "take another object than target {request.target}: it is covered or too near to "
    "others. Clear those first.",
    "excluded": "repeat grasps that failed before. Make exclude shorter or exclude_radius "
    "{request.exclude_radius:g} m smaller.",
    "score": "pass the check with less than min_score {request.min_score:g}, the best with "
    "{score:.2f}. Look again, or accept less.",
}


def _only_on_the_way(check: GraspCheck, rows: np.ndarray) -> int:
    return int(np.count_nonzero((check.inside[rows] == 0) & (check.approach_inside[rows] > 0)))


def _collisions(
    observation: SceneObservation, probe: GripperProbe, gripper: np.ndarray
) -> list[tuple[int, str]]:
    """How many poses (N, 4, 4) hit what, by how much, and what may be wrong."""
    local = probe.approach_points.astype(np.float64)
    points = (local @ gripper[:, :3, :3].transpose(0, 2, 1) + gripper[:, None, :3, 3]).reshape(
        -1, 3
    )
    state = observation.classify(points).reshape(len(gripper), -1)
    told = []
    floor = state == PointState.FLOOR
    if floor.any():
        depth = -observation.floor_height(points).reshape(floor.shape)
        text = (
            f"reach below the floor, half of them by more than {_middle(depth, floor)} mm. Is the "
            "floor too high? Check floor, region and gravity if objects are high."
        )
        told.append((_poses(floor), text))
    wall, body = state == PointState.WALL, state == PointState.INSIDE
    if observation.walls:
        place = observation.box_coordinates(points).reshape(len(gripper), -1, 3)
        # The walls are seen bodies too.
        near_wall = np.abs(place[..., :2]) - observation.half[:2] > -CLEARLY
        at_wall = body & near_wall.any(axis=-1)
        wall, body = wall | at_wall, body & ~at_wall
        for axis, name in enumerate(AXES):
            told += _walls(place[..., axis], wall, float(observation.half[axis]), name)
    if body.any():
        text = "are inside what was seen: too little room for this gripper among the objects."
        told.append((_poses(body), text))
    return told


def _walls(place: np.ndarray, wall: np.ndarray, half: float, axis: str) -> list[tuple[int, str]]:
    """Hits (N, P) of the two walls across an axis of the region, `place` (N, P) along it (m)."""
    sides = [(sign, wall & (sign * place > half - CLEARLY)) for sign in (-1.0, 1.0)]
    both = np.logical_and.reduce([hits.any(axis=1) for _, hits in sides])
    told = []
    if both.any():
        ends = np.where(wall[both], place[both], np.nan)
        width = np.median(np.nanmax(ends, axis=1) - np.nanmin(ends, axis=1))
        text = (
            f"hit the walls on both sides along {axis}: half of them are more than "
            f"{1000 * width:.0f} mm wide there, and the region is {2000 * half:.0f} mm. The "
            "gripper is too wide for it, or the region too small."
        )
        told.append((int(both.sum()), text))
    for sign, hits in sides:
        hits = hits & ~both[:, None]
        if hits.any():
            text = (
                f"hit the wall on the {'-' if sign < 0 else '+'}{axis} side of the region, half "
                f"of them by more than {_middle(sign * place - half, hits)} mm: what is there "
                "lies too near to it for this gripper, or the region is too small or in the wrong "
                "place."
            )
            told.append((_poses(hits), text))
    return told


def _poses(hits: np.ndarray) -> int:
    return int(hits.any(axis=1).sum())


def _middle(depth: np.ndarray, hits: np.ndarray) -> str:
    """Median over the poses that hit of how deep (N, P) the deepest of their points is, in mm."""
    deepest = np.where(hits, depth, -np.inf).max(axis=1)[hits.any(axis=1)]
    return f"{1000 * float(np.median(deepest)):.0f}"


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
    beyond = np.concatenate([-place - half, (place - half)[:, :2]], axis=1)
    face = beyond.argmax(axis=1)
    most = int(np.bincount(face, minlength=5).argmax())
    by = 1000 * float(np.median(beyond[face == most, most]))
    side = ("beyond its -x side", "beyond its -y side", "below its bottom",
            "beyond its +x side", "beyond its +y side")[most]  # fmt: skip
    return (
        f"lie beside or below the region, most of them {side}, half of those by {by:.0f} mm or "
        "more. Is it too small, or in the wrong place?"
    )


def sensor_doubt(observation: SceneObservation, offset: np.ndarray | None = None) -> list[str]:
    """A sentence where much of the cloud hides behind the rest, seen from where the sensor is said
    to be; else none.

    Args:
        observation: what was seen.
        offset: (3,) from its coordinates to those in which the sensor is told (m); None: the same.
    """
    hidden = float(
        np.mean(observation.signed_depth(observation.surface_points) > observation.settings.shell)
    )
    if hidden < HIDDEN:
        return []
    places = "; ".join(
        " ".join(f"{value:.2f}" for value in image.sensor + (0.0 if offset is None else offset))
        for image in observation.images
    )
    return [
        f"{100 * hidden:.0f} % of the cloud cannot have been seen from the sensor at {places}: "
        "other points stand before them. Say where the camera was in the frame of the cloud "
        "(sensor), for several views one by one."
    ]
