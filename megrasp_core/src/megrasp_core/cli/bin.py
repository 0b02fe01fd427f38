"""`megrasp bin find`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import tyro

from megrasp_core.errors import NoBinError

from .common import Flag, emit, say
from .viewing import Vector, gravity_of, length_factor, sensor_of

if TYPE_CHECKING:
    from megrasp_core.pointcloud import FoundBin

__all__ = ["find"]


def find(
    cloud: tyro.conf.Positional[Path],
    size: Vector = None,
    frame: Literal["world", "optical"] = "world",
    gravity: Vector = None,
    top_down: Flag = False,
    sensor: Vector = None,
    scale: float = 1.0,
    out: Path | None = None,
    picture: Path | None = None,
) -> int:
    """Find a rectangular bin in a cloud: where it is, how large and how full; exit code 1 if none.

    Try:
      megrasp bin find view.ply --sensor 0 0 0.9 --out bin.json --picture bin.png
      megrasp bin find view.npz --frame optical --top-down --size 0.4 0.3 0.15
      megrasp synthesize view.ply --sensor 0 0 0.9 --region bin.json --gripper franka_hand

    Args:
        cloud: .ply, .pcd, .npz (array points, optional viewpoint) or .npy; metres.
        size: inner edges at the rim and depth (m); 0 for a depth that is not known.
        frame: world: z up; optical: the camera's frame, gravity must be given.
        gravity: vector that points down in the frame of the cloud.
        top_down: with --frame optical: the camera looks straight down, gravity is +z.
        sensor: where the camera was. Default: the file's viewpoint; optical: the origin.
        scale: metres per unit of the file: 0.001 for millimetres, 0.0254 for inches.
        out: region file (JSON) that megrasp synthesize --region reads, with what else was found.
        picture: PNG of the cloud, the bin and how full each cell is.
    """
    down = gravity_of(frame, gravity, top_down)
    factor = length_factor(scale)
    from megrasp_core.pointcloud import check_view, find_bin, read_cloud

    points = read_cloud(cloud, optical=frame == "optical").scaled(factor)
    place = sensor_of(points, frame, sensor)
    check_view(points.points, sensor=place, gravity=down, optical=frame == "optical")
    try:
        found = find_bin(points, down, sensor=place, size=size)
    except NoBinError as error:
        say(str(error))
        return 1
    _report(found)
    if out is not None:
        emit(_region(found), out)
    if picture is not None:
        from megrasp_core.drawing.bin_picture import save_bin_picture

        save_bin_picture(picture, points, found, gravity=down)
        say(f"wrote {picture}")
    return 0


def _report(found: FoundBin) -> None:
    x, y, z = found.box.centre
    long, wide, deep = found.box.size
    content = "empty" if found.empty else f"{100 * found.fill_level:.0f} % full"
    say(
        f"bin of {long:.3f} x {wide:.3f} x {deep:.3f} m, {content}; depth from: {found.depth_from}"
    )
    shares = ", ".join(f"{100 * share:.0f}" for share in found.walls_seen)
    say(
        f"centre of the inside {x:.3f} {y:.3f} {z:.3f}; seen of its walls: {shares} %, rim within "
        f"{1000 * found.rim_error:.1f} mm of a plane"
    )


def _region(found: FoundBin) -> dict[str, Any]:
    from megrasp_core.lie import pose7_from_matrix

    cells = [[round(float(cell), 4) if np.isfinite(cell) else None for cell in row]
             for row in found.cells]  # fmt: skip
    level = float(found.fill_level)
    return {
        "pose": pose7_from_matrix(found.box.world_from_box).tolist(),
        "size": found.box.size.tolist(),
        "walls": True,
        "found": {
            "fill_level": round(level, 4) if np.isfinite(level) else None,
            "empty": found.empty,
            "cells": cells,
            "depth_from": found.depth_from,
            "walls_seen": np.round(found.walls_seen, 4).tolist(),
            "rim_error": round(found.rim_error, 6),
        },
    }
