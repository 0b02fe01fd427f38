"""How far a turning finger leans: from the way most of its outer faces look."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from megrasp_core.grippers import body_meshes

from .axes import Axes
from .fingers import Finger, joint_axes
from .mechanism import Mechanism
from .motion import DriveMotion

BINS = 90
"""Bins of a quarter turn: faces of a finger look along its pads or across them."""

SMOOTH = 2
CLEAR = 0.15
"""Share of the faces' area within the peak below which a finger has no faces of one direction."""

EDGE_ON = 0.2
"""Faces that look this little (sine) along the hinge count."""

OUTER = 0.5


def leans(
    mechanism: Mechanism,
    motion: DriveMotion,
    finger: Finger,
    axes: Axes,
    closed: NDArray[np.float64],
    open: NDArray[np.float64],
) -> float | None:
    """Return the angle (rad) about Y of the gripper by which a finger's faces are turned from the
    closing axis in the open posture, None where its faces look in no clear direction.

    Faces look alike after a quarter turn, so the angle is read off where the finger is most
    upright, in the closed posture (lengths (n,)), and carried over to the open one.
    """
    up, down = motion.poses(open), motion.poses(closed)
    body = finger.tip_body
    turned = up[body, :3, :3] @ down[body, :3, :3].T
    ahead = axes.rotation() @ turned @ axes.approach
    lean = _lean(mechanism, motion, finger, axes, closed)
    return None if lean is None else float(np.arctan2(ahead[0], ahead[2])) + lean


def _lean(
    mechanism: Mechanism,
    motion: DriveMotion,
    finger: Finger,
    axes: Axes,
    lengths: NDArray[np.float64],
) -> float | None:
    """Return the lean in a posture, within an eighth of a turn; None without a clear direction."""
    poses = motion.poses(lengths)
    anchor = joint_axes(motion, lengths)[0][finger.moving[-1]]
    rotation = axes.rotation()
    angles, areas = [np.zeros(0)], [np.zeros(0)]
    for which in ("collision", "visual"):
        for item in body_meshes(mechanism.model, which):
            if item.body not in finger.tip:
                continue
            pose = poses[item.body]
            corners = item.mesh.vertices[item.mesh.faces] @ pose[:3, :3].T + pose[:3, 3]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            size = np.linalg.norm(normals, axis=1)
            far = np.linalg.norm(corners.mean(axis=1) - anchor, axis=1)
            local = normals @ rotation.T / np.maximum(size, 1e-12)[:, None]
            kept = (np.abs(local[:, 1]) < EDGE_ON) & (far > OUTER * far.max(initial=0.0))
            angles.append(np.arctan2(-local[kept, 2], local[kept, 0]))
            areas.append(size[kept])
        if len(angles) > 1:
            break
    angle, area = np.concatenate(angles), np.concatenate(areas)
    if not area.sum() > 0.0:
        return None
    quarter = np.pi / 2.0
    folded = np.mod(angle, quarter)
    histogram = np.histogram(folded, BINS, (0.0, quarter), weights=area)[0]
    shifts = range(-SMOOTH, SMOOTH + 1)
    window = np.sum([np.roll(histogram, shift) for shift in shifts], axis=0)
    peak = int(np.argmax(window))
    if window[peak] < CLEAR * area.sum():
        return None
    middle = (peak + 0.5) * quarter / BINS
    near = np.abs(np.mod(folded - middle + quarter / 2.0, quarter) - quarter / 2.0)
    chosen = near <= (SMOOTH + 0.5) * quarter / BINS
    offset = np.mod(folded[chosen] - middle + quarter / 2.0, quarter) - quarter / 2.0
    found = middle + float(np.average(offset, weights=area[chosen]))
    return found if found <= quarter / 2.0 else found - quarter
