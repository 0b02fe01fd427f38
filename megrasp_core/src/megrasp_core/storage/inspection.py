"""Counts of labelled scenes, and what is wrong with a record."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from .packed_scene import PackedScene
from .records import NOT_TRIED, ROBUST_TRIALS, GripperLabels, Kind, SceneRecord
from .robust_stats import Held, counted_as, held_counts, joined_counts, robust_stats


def scene_stats(
    records: Iterable[SceneRecord | PackedScene],
    runs: Sequence[dict[str, Any]] = (),
    on_progress: Callable[[int], object] | None = None,
) -> dict[str, Any]:
    """Counts of labelled scenes.

    Args:
        records: of data sets, device packs or recipes; read one after another.
        runs: what making them took, as in `runs.jsonl`.
        on_progress: called with the number of scenes done.

    Returns:
        scenes, runs, in_bin, mean_objects, mean_points (0 of recipes, which have none); per
        gripper, all procedural ones together: grasps by kind and label, the success rate of the
        judged library grasps, the reasons of failure, of how many successes it is known what came
        along and with how many something did, the share of scenes with any success, and successes
        per scene; per object that grasps were made for: scenes, successes, and for how many
        grippers there are any; and `robust_stats` as `robust`, where there are any.
    """
    grippers: dict[str, dict[str, Any]] = {}
    seen: Counter[str] = Counter()
    held_by: dict[str, Counter[str]] = {}
    objects, points, bins = [], [], 0
    held: dict[str, list[Held]] = {}
    for record in records:
        objects.append(len(record.object_names))
        points.append(len(record.points))
        bins += record.bin is not None
        tried: set[int] = set()
        for gripper, labels in record.labels.items():
            name = counted_as(gripper)
            entry = grippers.setdefault(
                name,
                {
                    "count": Counter(),
                    "reasons": Counter(),
                    **dict.fromkeys(("scenes", "any", "success", "watched", "along"), 0),
                },
            )
            held.setdefault(name, []).append(held_counts(labels))
            success = labels.label == 1
            tried.update(np.unique(labels.object).tolist())
            entry["scenes"] += 1
            entry["any"] += bool(success.any())
            entry["success"] += int(success.sum())
            for kind, label in zip(labels.kind, labels.label):
                entry["count"][
                    f"{Kind(int(kind)).name.lower()}_{'success' if label else 'failure'}"
                ] += 1
            for place in labels.object[success].tolist():
                held_by.setdefault(record.object_names[place], Counter())[name] += 1
            watched = success & (labels.extra != NOT_TRIED)
            entry["watched"] += int(watched.sum())
            entry["along"] += int((watched & (labels.extra > 0)).sum())
            judged = (labels.kind == Kind.JUDGED) & (labels.label == 0)
            entry["reasons"].update(str(reason) for reason in labels.reason[judged])
        seen.update({record.object_names[place] for place in tried})
        if on_progress is not None:
            on_progress(len(objects))
    robust = robust_stats({name: joined_counts(parts) for name, parts in held.items()}, runs)
    return {
        "scenes": len(objects),
        # What the runs of robust labels took is told with the labels.
        "runs": [{key: run[key] for key in run if key != "robust"} for run in runs],
        "in_bin": bins,
        "mean_objects": float(np.mean(objects)) if objects else 0.0,
        "mean_points": float(np.mean(points)) if points else 0.0,
        "grippers": {name: _summary(entry) for name, entry in sorted(grippers.items())},
        "objects": {
            name: {"scenes": count, "successes": by.total(), "grippers": len(by)}
            for name, count in sorted(seen.items())
            for by in [held_by.get(name, Counter())]
        },
        **({"robust": robust} if robust else {}),
    }


def _summary(entry: dict[str, Any]) -> dict[str, Any]:
    count = entry["count"]
    held, lost = count["judged_success"], count["judged_failure"]
    return {
        "labels": dict(sorted(count.items())),
        "judged_success_rate": held / (held + lost) if held + lost else None,
        "judged_failures": dict(entry["reasons"].most_common()),
        "successes_watched": entry["watched"],
        "successes_with_others_along": entry["along"],
        "scenes_with_success": entry["any"] / max(1, entry["scenes"]),
        "successes_per_scene": entry["success"] / max(1, entry["scenes"]),
    }


def record_problems(record: SceneRecord, grippers: set[str] | None = None) -> list[str]:
    """What is wrong with a record, in words; empty when nothing is."""
    problems: list[str] = []
    count, objects = len(record.points), len(record.object_names)
    if record.points.shape != (count, 3) or count == 0:
        problems.append(f"points have shape {record.points.shape}; expected (M, 3) with M > 0")
    elif not np.isfinite(record.points.astype(np.float32)).all():
        problems.append("some points are not finite")
    if record.normals.shape != record.points.shape or record.on_plane.shape != (count,):
        problems.append("normals or plane flags do not match the points")
    elif (
        np.abs(np.linalg.norm(record.normals.astype(np.float32) / 127.0, axis=1) - 1).max() > 0.02
    ):
        problems.append("some normals are not of unit length")
    if record.object_poses.shape != (objects, 7) or record.obstacle.shape != (objects,):
        problems.append("object poses or obstacle flags do not match the object names")
    if grippers and not set(record.labels) <= grippers:
        problems.append(f"labels for {sorted(record.labels)}; expected some of {sorted(grippers)}")
    if not record.labels:
        problems.append("no labels of any gripper")
    for name, labels in record.labels.items():
        problems.extend(f"{name}: {problem}" for problem in _label_problems(labels, objects))
    return problems


def _label_problems(labels: GripperLabels, objects: int) -> list[str]:
    count = len(labels.label)
    if not count:
        return []
    problems: list[str] = []
    if labels.world_from_tcp.shape != (count, 7) or not np.isfinite(labels.world_from_tcp).all():
        problems.append("poses are not (K, 7) finite numbers")
    elif np.abs(np.linalg.norm(labels.world_from_tcp[:, 3:], axis=1) - 1).max() > 1e-3:
        problems.append("some quaternions are not of unit length")
    if labels.object.min() < 0 or labels.object.max() >= objects:
        problems.append("a grasp belongs to no object of the scene")
    if not set(np.unique(labels.label)) <= {0, 1}:
        problems.append("labels other than 0 and 1")
    if not set(np.unique(labels.kind)) <= {int(kind) for kind in Kind}:
        problems.append("unknown kinds of label")
    if ((labels.label == 1) & (labels.kind == Kind.COLLISION)).any():
        problems.append("a colliding grasp is labelled a success")
    if labels.extra.shape != (count,) or not (
        NOT_TRIED <= labels.extra.min() <= labels.extra.max() <= objects
    ):
        problems.append(f"extra objects are not {count} numbers from {NOT_TRIED} to {objects}")
    if labels.robust.shape != (count,) or not (
        NOT_TRIED <= labels.robust.min() <= labels.robust.max() <= ROBUST_TRIALS
    ):
        problems.append(
            f"robust trials held are not {count} numbers from {NOT_TRIED} to {ROBUST_TRIALS}"
        )
    elif (labels.robust[labels.kind == Kind.COLLISION] > 0).any():
        problems.append("a colliding grasp held when tried again")
    return problems
