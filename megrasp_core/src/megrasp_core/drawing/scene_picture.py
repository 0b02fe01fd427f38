"""Pictures of labelled scenes, to look at before anything is trained on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import InvalidRequestError
from megrasp_core.grippers import Gripper
from megrasp_core.lie import matrix_from_pose7
from megrasp_core.storage import SceneRecord

_COLOURS = ("#d62728", "#1f77b4", "#2ca02c", "#ff7f0e", "#9467bd", "#17becf", "#e377c2", "#8c564b")


def scene_picture(
    record: SceneRecord,
    gripper: Gripper,
    path: str | Path,
    *,
    count: int = 4,
    label: int = 1,
    points: int = 500,
) -> Path:
    """Draws the scene's cloud from above and from two sides with the open gripper at some labelled
    grasps.

    Args:
        record: the scene, with its cloud.
        gripper: whose labels to draw.
        path: picture to write.
        count: grasps drawn, spread evenly over the labels.
        label: 1 draws successes, 0 failures.
        points: surface points drawn of each gripper.

    Raises:
        InvalidRequestError: the scene has no labels of the gripper.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if gripper.name not in record.labels:
        raise InvalidRequestError(
            f"scene {record.name} has no labels of {gripper.name}; expected one of "
            f"{', '.join(record.labels)}."
        )
    labels = record.labels[gripper.name]
    wanted = np.flatnonzero(labels.label == label)
    wanted = wanted[np.linspace(0, len(wanted) - 1, min(count, len(wanted))).astype(int)]
    world_from_gripper = matrix_from_pose7(labels.world_from_tcp[wanted]) @ np.linalg.inv(
        gripper.gripper_from_tcp
    )
    surface = gripper.clouds(points).open_points
    scene = record.points.astype(np.float64)
    figure = Figure(figsize=(18, 6), dpi=90)
    FigureCanvasAgg(figure)
    for panel, (first, second, depth) in enumerate(((0, 1, 2), (0, 2, 1), (1, 2, 0))):
        axes = figure.add_subplot(1, 3, panel + 1)
        order = np.argsort(scene[:, depth] * (1 if depth == 2 else -1))
        shade = scene[order, 2]
        axes.scatter(scene[order, first], scene[order, second], c=shade, s=1, cmap="Greys_r")
        for index, pose in enumerate(world_from_gripper):
            _draw(axes, surface @ pose[:3, :3].T + pose[:3, 3], first, second, index)
        axes.set_aspect("equal")
        axes.set_xlabel("xyz"[first] + " (m)")
        axes.set_ylabel("xyz"[second] + " (m)")
    figure.suptitle(f"{record.name}  {gripper.name}  {'success' if label else 'failure'}")
    figure.tight_layout()
    figure.savefig(path)
    return Path(path)


def _draw(axes: object, points: NDArray[np.float64], first: int, second: int, index: int) -> None:
    axes.scatter(  # type: ignore[attr-defined]
        points[:, first], points[:, second], s=2, c=_COLOURS[index % len(_COLOURS)], alpha=0.6
    )
