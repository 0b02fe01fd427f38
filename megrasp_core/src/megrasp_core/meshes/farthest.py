"""Farthest point sampling: an even subset of a cloud."""

from __future__ import annotations

import fpsample
import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import CloudError

FloatArray = NDArray[np.float64]


def farthest_from_centroid(points: FloatArray) -> int:
    """Return the index of the point (N, 3) farthest from the mean: it turns with the cloud."""
    return int(np.argmax(((points - points.mean(axis=0)) ** 2).sum(axis=1)))


def farthest_points(points: FloatArray, count: int, start: int | None = None) -> NDArray[np.intp]:
    """Return the indices of `count` points that lie as far from each other as possible.

    points: (N, 3), finite. start: index of the first one; by default the point farthest from the
    centroid, so that the choice does not depend on the frame. Each next point is the one farthest
    from all before it: the first k indices are themselves an even subset. All N indices come back,
    in this order, when count >= N.

    Raises CloudError without points or with points that are not finite.
    """
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise CloudError(
            f"farthest points need points of shape (N, 3) with N > 0, got {points.shape}."
        )
    if not np.isfinite(points).all():
        raise CloudError(
            "the points hold NaN or infinity; expected finite coordinates. Drop such rows."
        )
    count = min(count, len(points))
    if count <= 0:
        return np.zeros(0, np.intp)
    first = farthest_from_centroid(points) if start is None else int(start)
    # The sampler computes in float32: take off the mean first, or a far-away frame costs digits.
    centred = (points - points.mean(axis=0)).astype(np.float32)
    if len(points) > 256:
        # The bucket sampler counts its start in the order of its own tree and not in ours. It
        # leaves points alone that already stand in that order, so bring them there; whether the
        # start came out right is then checked, never assumed.
        height = 5 if len(points) < 30_000 else 7
        order = _tree_order(centred, height)
        place = int(np.flatnonzero(order == first)[0])
        chosen = order[
            fpsample.bucket_fps_kdline_sampling(centred[order], count, h=height, start_idx=place)
        ]
        if chosen[0] == first:
            return _distinct(chosen, len(points))
    chosen = fpsample.fps_sampling(centred, count, start_idx=first).astype(np.intp)
    return _distinct(chosen, len(points))


def _distinct(chosen: NDArray[np.intp], total: int) -> NDArray[np.intp]:
    """Return the indices without repetition, filled up to the same number from 0..total-1.

    Where points coincide the sampler runs out of distances and repeats itself.
    """
    fresh = np.sort(np.unique(chosen, return_index=True)[1])
    if len(fresh) == len(chosen):
        return chosen
    unused = np.setdiff1d(np.arange(total), chosen)[: len(chosen) - len(fresh)]
    return np.concatenate([chosen[fresh], unused])


def _tree_order(points: NDArray[np.float32], height: int) -> NDArray[np.intp]:
    """Return the order (N,) of points in a tree that halves the widest axis at the mean."""
    columns = np.ascontiguousarray(points.T)
    order = np.arange(len(points))
    parts = [(0, len(points))]
    for _ in range(height):
        halves: list[tuple[int, int]] = []
        for low, high in parts:
            rows = order[low:high]
            members = columns[:, rows]
            axis = int(np.argmax(members.max(axis=1) - members.min(axis=1)))
            left = members[axis] < members[axis].mean()
            middle = low + int(np.count_nonzero(left))
            order[low:high] = np.concatenate([rows[left], rows[~left]])
            halves += [half for half in ((low, middle), (middle, high)) if half[1] > half[0]]
        parts = halves
    return order
