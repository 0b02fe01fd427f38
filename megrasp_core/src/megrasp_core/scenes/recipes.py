"""Scene recipes: everything of a scene but its cloud, small enough to be committed; the cloud is
rendered again.

Poses of objects are kept exactly (float32), since the cloud depends on them; grasps are rounded to
0.02 mm and 0.003 degrees.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from megrasp_core.errors import DataError
from megrasp_core.objects import ObjectSet
from megrasp_core.storage import (
    GripperLabels,
    SceneRecord,
    TextCodes,
    bin_fields,
    bin_from_fields,
    open_npz,
    pack_normals,
    pack_positions,
    pack_quaternions,
    split,
    text_array,
    text_of,
    texts_of,
    unpack_poses,
    write_npz,
)

from .layout import Layout, SceneConfig, region_of
from .observing import scene_surface

_FORMAT = "megrasp scene recipes 2"
_READABLE = ("megrasp scene recipes 1", _FORMAT)
"""The first keeps the inner size of a bin and nothing else of it."""
_METRE = 2e-5


def write_recipes(path: str | Path, records: Iterable[SceneRecord]) -> int:
    """Writes the recipes of `records` into one compressed file and returns its size in bytes."""
    records = list(records)
    scenes, poses, obstacles = [], [np.zeros((0, 7), np.float32)], [np.zeros(0, bool)]
    labels: list[GripperLabels] = []
    for record in records:
        grippers = sorted(record.labels)
        scenes.append(
            {
                "name": record.name,
                "seed": record.seed,
                "objects": list(record.object_names),
                "bin": bin_fields(record.bin),
                "grippers": {name: len(record.labels[name]) for name in grippers},
            }
        )
        poses.append(record.object_poses)
        obstacles.append(record.obstacle)
        labels.extend(record.labels[name] for name in grippers)
    joined = GripperLabels.joined(labels)
    reasons = TextCodes.sorted(joined.reason)
    grasp = joined.world_from_tcp.astype(np.float64)
    try:
        position = pack_positions(grasp[:, :3], _METRE)
    except ValueError as error:
        raise DataError(
            f"{error}; expected scenes on or around the origin. Leave that scene out."
        ) from error
    write_npz(
        Path(path),
        {
            "meta": text_array(
                json.dumps({"format": _FORMAT, "reasons": reasons.names, "scenes": scenes})
            ),
            "object_poses": np.concatenate(poses),
            "obstacle": np.concatenate(obstacles),
            "position": position,
            "quaternion": pack_quaternions(grasp[:, 3:]),
            "object": joined.object.astype(np.uint8),
            "label": joined.label,
            "kind": joined.kind,
            "reason": reasons.codes(joined.reason).astype(np.uint8),
            "extra": joined.extra,
            "robust": joined.robust,
        },
    )
    return Path(path).stat().st_size


def read_recipes(path: str | Path) -> list[SceneRecord]:
    """Reads recipes as records without points; `with_cloud` renders them.

    Raises:
        DataError: the file is missing, damaged or something else.
    """
    with open_npz(Path(path)) as file:
        try:
            arrays = {key: file[key] for key in file.files}
            meta = json.loads(text_of(arrays["meta"]))
            grasp = unpack_poses(arrays["position"], arrays["quaternion"], _METRE)
        except (KeyError, ValueError) as error:
            raise DataError(
                f"{path} holds no scene recipes ({error}). Give a recipe file."
            ) from error
    if meta.get("format") not in _READABLE:
        raise DataError(f"{path} has format {meta.get('format')!r}; expected one of {_READABLE}.")
    reason = texts_of(meta["reasons"], arrays["reason"])
    # Recipes made before they were kept have no such arrays.
    extra, robust = (
        arrays.get(name, GripperLabels.not_tried(len(reason))) for name in ("extra", "robust")
    )
    joined = GripperLabels(
        world_from_tcp=grasp.astype(np.float32),
        object=arrays["object"].astype(np.int16),
        label=arrays["label"],
        kind=arrays["kind"],
        reason=reason,
        extra=extra,
        robust=robust,
    )
    records, first, start = [], 0, 0
    for scene in meta["scenes"]:
        last = first + len(scene["objects"])
        count = sum(scene["grippers"].values())
        labels = split(joined.part(slice(start, start + count)), scene["grippers"])
        start += count
        records.append(
            SceneRecord(
                name=scene["name"],
                seed=int(scene["seed"]),
                object_names=tuple(scene["objects"]),
                object_poses=arrays["object_poses"][first:last],
                obstacle=arrays["obstacle"][first:last],
                bin=bin_from_fields(scene["bin"]),
                points=np.zeros((0, 3), np.float16),
                normals=np.zeros((0, 3), np.int8),
                on_plane=np.zeros(0, bool),
                sensor=np.zeros(3, np.float32),
                gravity=np.array([0, 0, -1], np.float32),
                labels=labels,
            )
        )
        first = last
    return records


def with_cloud(recipe: SceneRecord, config: SceneConfig, objects: ObjectSet) -> SceneRecord:
    """The record of a recipe, its cloud rendered from the seed.

    With the same config the cloud is the original's bit for bit on the machine that made it. On
    another processor the last bits of depths differ, and with them some points; in bins the noise
    may be drawn anew: docs/data.md says by how much. Poses, camera and labels are the same.
    """
    layout = Layout(
        recipe.object_names,
        recipe.obstacle,
        recipe.object_poses,
        recipe.bin,
        region_of(recipe.bin, config),
    )
    surface = scene_surface(layout, recipe.seed, config, objects)
    return replace(
        recipe,
        points=surface.points.astype(np.float16),
        normals=pack_normals(surface.normals),
        on_plane=surface.on_plane,
        sensor=np.asarray(surface.sensor, np.float32),
        gravity=np.asarray(surface.gravity, np.float32),
    )
