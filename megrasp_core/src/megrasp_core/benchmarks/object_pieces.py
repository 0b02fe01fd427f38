"""Convex pieces of objects held against those of other objects of the same names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from megrasp_core.errors import ObjectError
from megrasp_core.evaluation.report import hardware
from megrasp_core.meshes import sample_uniform
from megrasp_core.objects import find_objects, load_object, volume_of

SAMPLES, NEAR = 5000, 0.002
"""Points on the surface; a piece covers those that lie no farther outside of it (m)."""


def compare_pieces(prepared: Path, reference: Path, seed: int = 0) -> dict[str, Any]:
    """Return figures of the objects whose folder names are below both, in pairs (prepared,
    reference): `pieces`, `covered` (share of the object's own surface), `litres` (of all pieces).

    Raises ObjectError where a folder is missing or no name is below both.
    """
    ours, theirs = ({p.name: p for _, p in find_objects(r)} for r in (prepared, reference))
    objects: dict[str, Any] = {}
    for name in sorted(ours.keys() & theirs.keys()):
        pair = [_figures(path, seed) for path in (ours[name], theirs[name])]
        objects[name] = {key: [figures[key] for figures in pair] for key in pair[0]}
    if not objects:
        raise ObjectError(
            f"no object of {prepared} has the name of one of {reference}; expected objects that "
            "were prepared from the same meshes. Check the paths."
        )
    return {"samples": SAMPLES, "near": NEAR, "objects": objects, "hardware": hardware()}


def _figures(folder: Path, seed: int) -> dict[str, float]:
    model = load_object(folder)
    points, _ = sample_uniform(model.mesh, SAMPLES, np.random.default_rng(seed))
    covered = np.zeros(len(points), dtype=bool)
    for vertices, _ in model.pieces:
        planes = ConvexHull(vertices).equations
        covered |= (points @ planes[:, :3].T + planes[:, 3] <= NEAR).all(axis=1)
    litres = round(1000.0 * sum(volume_of(*piece) for piece in model.pieces), 5)
    share = round(float(covered.mean()), 4)
    return {"pieces": len(model.pieces), "covered": share, "litres": litres}
