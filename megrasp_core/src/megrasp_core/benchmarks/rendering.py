"""Seconds to render both clouds of a gripper (`megrasp bench --stage render`)."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from megrasp_core.evaluation.report import hardware
from megrasp_core.grippers import (
    VISUAL_GROUP,
    body_meshes,
    body_poses,
    list_grippers,
    load_gripper,
    make_clouds,
    sample_gripper,
    write_gripper,
)

POINTS = 1024


def bench_rendering(
    *,
    names: Sequence[str] | None = None,
    procedural: int = 50,
    repeats: int = 7,
    on_progress: Callable[[int, int], object] | None = None,
) -> dict[str, Any]:
    """Time the rendering of both postures: meshes, poses and clouds, without loading and cache.

    Args:
        names: registered grippers; all by default.
        procedural: number of procedural grippers besides.
        repeats: timed calls per gripper, after one that is not counted.
        on_progress: called with grippers done and in all.

    Returns:
        Content of the result file. `seconds` are CPU-seconds: the median of a gripper's calls;
        `per_second` is how many grippers are rendered in a CPU-second; `million_triangles` is a
        ring of 10^6 triangles.
    """
    names = list_grippers() if names is None else names
    total = len(names) + procedural + 1
    rows: list[dict[str, Any]] = []

    def measure(name: str, triangles: int, render: Callable[[], object]) -> None:
        seconds = [_seconds(render) for _ in range(repeats + 1)][1:]
        rows.append(
            {
                "gripper": name,
                "triangles": triangles,
                "seconds": round(float(np.median(seconds)), 4),
                "max": round(max(seconds), 4),
            }
        )
        if on_progress is not None:
            on_progress(len(rows), total)

    with tempfile.TemporaryDirectory() as folder:
        drawn = (
            write_gripper(Path(folder), *sample_gripper(seed)) for seed in range(1, 1 + procedural)
        )
        for gripper in map(load_gripper, (*names, *drawn)):
            triangles = sum(len(one.mesh.faces) for one in gripper.body_meshes())
            postures = gripper.qpos("open"), gripper.qpos("closed")
            measure(gripper.name, triangles, partial(_render, gripper.model, *postures))
    ring = _ring()
    measure("ring", ring.nmeshface, lambda: _render(ring, ring.qpos0, ring.qpos0))
    return {
        "stage": "render",
        "points": POINTS,
        "repeats": repeats,
        "registered": _summary(rows[: len(names)]),
        "procedural": _summary(rows[len(names) : -1]),
        "million_triangles": rows[-1],
        "hardware": hardware(),
    }


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what is said of several grippers, and their rows."""
    if not rows:
        return {"rows": []}
    seconds = [row["seconds"] for row in rows]
    slowest = max(rows, key=lambda row: row["seconds"])
    return {
        "median": round(float(np.median(seconds)), 4),
        "slowest": {key: slowest[key] for key in ("gripper", "seconds")},
        "per_second": round(len(rows) / sum(seconds), 1),
        "rows": rows,
    }


def _render(
    model: mujoco.MjModel, opened: NDArray[np.float64], closed: NDArray[np.float64]
) -> None:
    """Render a compiled model at two joint positions (nq,)."""
    poses = body_poses(model, opened), body_poses(model, closed)
    make_clouds(body_meshes(model, "visual"), *poses, POINTS, 0)


def _ring() -> mujoco.MjModel:
    """Return a ring of 10^6 triangles, 22 cm wide."""
    mesh = trimesh.creation.torus(0.08, 0.03, major_sections=1000, minor_sections=500)
    spec = mujoco.MjSpec()
    spec.add_mesh(name="ring", uservert=mesh.vertices.ravel(), userface=mesh.faces.ravel())
    spec.worldbody.add_body().add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname="ring", group=VISUAL_GROUP,
        contype=0, conaffinity=0, mass=1.0,
    )  # fmt: skip
    return spec.compile()


def _seconds(work: Callable[[], object]) -> float:
    """Return the CPU-seconds of a call."""
    start = time.process_time()
    work()
    return time.process_time() - start
