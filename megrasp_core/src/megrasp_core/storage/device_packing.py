"""Writes device packs (device_pack.py): thins surfaces, rounds to small integers, joins scenes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.meshes import farthest_points
from megrasp_core.pointcloud import SceneSettings, choose_nodes, node_counts

from .codec import TextCodes, pack_quaternions
from .device_pack import FORMAT, OPTIONAL, digest
from .files import text_array, write_bytes
from .packed_scene import node_choice, pack_octahedral
from .records import NOT_TRIED, GripperLabels, SceneRecord, bin_fields

FINEST_STEP = 2.0**-16
"""Of the lattice (m), up to 1 m across: float16 coordinates beyond 16 mm are multiples of it."""


@dataclass(frozen=True)
class PackSettings:
    """What a pack keeps.

    Attributes:
        points: at most so many of a scene, its nodes of inference among them.
        scene: how nodes are chosen; training from the pack must choose alike.

    Raises:
        InvalidRequestError: fewer points than nodes.
    """

    points: int = 3072
    scene: SceneSettings = field(default_factory=SceneSettings)

    def __post_init__(self) -> None:
        if self.points < self.scene.max_nodes:
            raise InvalidRequestError(
                f"{self.points} points a scene were asked for; expected at least "
                f"{self.scene.max_nodes}, the nodes that inference takes."
            )


@dataclass(frozen=True)
class PackSource:
    """A data set to pack: its name, its manifest, its scenes in order and their number."""

    name: str
    manifest: dict[str, Any]
    scenes: Iterable[SceneRecord]
    count: int


def write_pack(
    path: str | Path,
    sources: Iterable[PackSource],
    settings: PackSettings | None = None,
    on_scene: Callable[[], object] | None = None,
) -> int:
    """Writes the scenes of `sources` into one file, as a whole, and returns its size in bytes;
    equal scenes give equal bytes.

    Args:
        path: of the pack.
        sources: data sets, one after another.
        settings: what is kept.
        on_scene: called after every scene.

    Raises:
        DataError: no scene at all, or one that a pack cannot hold.
    """
    settings = settings or PackSettings()
    reasons, objects = TextCodes(), TextCodes()
    parts: list[dict[str, np.ndarray]] = []
    scenes: list[dict[str, Any]] = []
    origins: list[dict[str, Any]] = []
    hashes: dict[str, set[str]] = {}
    for source in sources:
        for record in source.scenes:
            parts.append({**_surface(record, settings), **_labels(record, reasons)})
            scenes.append(
                {
                    "name": record.name,
                    "seed": record.seed,
                    "objects": [objects.code(name) for name in record.object_names],
                    "bin": bin_fields(record.bin),
                    "grippers": {name: len(record.labels[name]) for name in sorted(record.labels)},
                }
            )
            _to_lattice(record, parts[-1])
            if on_scene is not None:
                on_scene()
        origins.append({"name": source.name, "scenes": source.count, "manifest": source.manifest})
        for name, value in source.manifest.get("grippers", {}).items():
            hashes.setdefault(name, set()).add(value)
    if not parts:
        raise DataError(
            "no scene was given to pack; expected at least one. Make some with `megrasp data "
            "scenes`."
        )
    meta = {
        "nodes": node_choice(settings.scene),
        "grippers": {name: sorted(values) for name, values in sorted(hashes.items())},
        "objects": objects.names,
        "reasons": reasons.names,
        "sources": origins,
        "scenes": scenes,
    }
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    arrays["on_plane"] = np.packbits(arrays["on_plane"], bitorder="little")
    for name, rows in (("point_start", "points"), ("label_start", "outcome")):
        arrays[name] = np.cumsum([0, *(len(part[rows]) for part in parts)], dtype=np.int64)
    optional = {name: arrays.pop(name) for name in OPTIONAL}
    # Equal bytes as ever for scenes without any.
    optional = {name: rows for name, rows in optional.items() if (rows != NOT_TRIED).any()}
    if optional:
        meta["optional"] = {name: digest({name: rows}).hex() for name, rows in optional.items()}
    arrays["meta"] = text_array(json.dumps(meta, sort_keys=True))
    arrays["sha256"] = np.frombuffer(digest(arrays), np.uint8)
    # One entry only: the library writes several in an order that changes from run to run.
    data = save({**arrays, **optional}, metadata={"format": FORMAT})
    write_bytes(Path(path), data)
    return len(data)


def kept_points(
    points: NDArray[np.float64], on_plane: NDArray[np.bool_], settings: PackSettings
) -> tuple[NDArray[np.intp], int]:
    """Which of points (M, 3) a pack keeps, and how many of them, the first, are the nodes of
    inference.

    The others are in the nodes' shares off the plane and on it, and as far from each other as
    possible: with the nodes or without, they cover the surface evenly.
    """
    counts = node_counts(on_plane, settings.scene)
    nodes = choose_nodes(points, on_plane, counts, 0)
    spare = np.ones(len(points), bool)
    spare[nodes] = False
    rest, plane = np.flatnonzero(spare & ~on_plane), np.flatnonzero(spare & on_plane)
    room = settings.points - len(nodes)
    for_rest = min(round(room * counts[0] / sum(counts)), len(rest))
    more = [
        part[farthest_points(points[part], count)]
        for part, count in ((rest, for_rest), (plane, min(room - for_rest, len(plane))))
        if count
    ]
    return np.concatenate([nodes, *more]), len(nodes)


def _surface(record: SceneRecord, settings: PackSettings) -> dict[str, np.ndarray]:
    points, normals = record.surface()
    if not len(points) or not np.isfinite(points).all():
        raise DataError(
            f"{record.name} has {len(points)} points, some of them perhaps not finite; expected a "
            "surface. Run `megrasp data verify`."
        )
    kept, nodes = kept_points(points, record.on_plane, settings)
    return {
        "points": points[kept],
        "normals": pack_octahedral(normals[kept]),
        "on_plane": record.on_plane[kept],
        "inference": np.array([nodes], np.int32),
        "gravity": record.gravity[None].astype(np.float32),
    }


def _labels(record: SceneRecord, reasons: TextCodes) -> dict[str, np.ndarray]:
    joined = GripperLabels.joined([record.labels[name] for name in sorted(record.labels)])
    code = reasons.codes(joined.reason)
    limits = (("object", joined.object, 255), ("reason", code, 255), ("kind", joined.kind, 127))
    for name, values, most in limits:
        if len(values) and not 0 <= values.min() <= values.max() <= most:
            raise DataError(
                f"{record.name} has labels with {name} {values.min()} to {values.max()}; expected "
                f"0 to {most}. Run `megrasp data verify`, or leave the scene out."
            )
    pose = joined.world_from_tcp.astype(np.float64)
    return {
        "position": pose[:, :3],
        "quaternion": pack_quaternions(pose[:, 3:]),
        "object": joined.object.astype(np.uint8),
        "outcome": ((joined.label == 1) | (joined.kind.astype(np.uint8) << 1)).astype(np.uint8),
        "reason": code.astype(np.uint8),
        "robust": joined.robust,
    }


def _to_lattice(record: SceneRecord, part: dict[str, np.ndarray]) -> None:
    """Replaces points and grasp positions (world, m) by numbers of steps from an origin."""
    both = np.concatenate([part["points"], part["position"]])
    low, high = both.min(axis=0), both.max(axis=0)
    step = FINEST_STEP
    while (high - low).max() > 2 * 32766 * step:
        step *= 2
    # A multiple of the step, so that what lies on the lattice of the world stays exact.
    origin = np.rint((low + high) / 2 / step) * step
    part["origin"] = origin[None].astype(np.float32)
    part["step"] = np.array([step], np.float32)
    for name in ("points", "position"):
        part[name] = np.rint((part[name] - origin) / step).astype(np.int16)
