"""Meshes as they come made closed and outward: what mass and convex pieces need."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .mesh import Mesh, joined

if TYPE_CHECKING:
    import trimesh

MERGE_DIGITS = 7
"""Vertices that are equal to so many digits of a metre are one."""
LOOSE = 0.02
"""Parts that hang on nothing and have less than this share of the largest's area are dropped."""


@dataclass(frozen=True, eq=False)
class Repair:
    """A mesh and what was done to it.

    Attributes:
        mesh: faces outward; those of cavities inward.
        closed: whether it bounds a volume.
        done: in words, in order; empty where nothing was.
    """

    mesh: Mesh
    closed: bool
    done: tuple[str, ...]


def repaired(mesh: Mesh) -> Repair:
    """Merge equal vertices, drop what is double, degenerate or loose, close holes and turn faces
    outward.

    A hole is closed by a fan, whatever its size; the share of the surface that fans make up is
    told. A part within the box around a larger one is a cavity where it is wound the other way.
    The result may have no face.
    """
    # A synthesis starts without it.
    import trimesh

    done: list[str] = []

    def tell(count: int, what: str) -> None:
        if count:
            done.append(f"{count} {what.format('' if count == 1 else 's')}")

    whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    whole.remove_infinite_values()
    tell(len(mesh.faces) - len(whole.faces), "face{} with a corner that is not finite dropped")
    whole.remove_unreferenced_vertices()
    count = len(whole.vertices)
    whole.merge_vertices(digits_vertex=MERGE_DIGITS)
    tell(count - len(whole.vertices), "equal vertices merged")
    count = len(whole.faces)
    # Not by area: a thin triangle closes the gap between its neighbours.
    whole.update_faces((np.diff(np.sort(whole.faces, axis=1)) > 0).all(axis=1))
    whole.update_faces(whole.unique_faces())
    tell(count - len(whole.faces), "degenerate or double face{} dropped")
    if len(whole.faces) == 0:
        return Repair(joined([]), False, tuple(done))

    parts = whole.split(only_watertight=False, repair=False)
    least = LOOSE * max(part.area for part in parts)
    large = [part for part in parts if part.area >= least]
    tell(len(parts) - len(large), "loose part{} dropped")
    given, area = [part.faces.copy() for part in large], sum(part.area for part in large)
    for part in large:
        trimesh.repair.fix_winding(part)
        trimesh.repair.fill_holes(part, use_fan=True)
        trimesh.repair.fix_inversion(part)
    total = sum(part.area for part in large)
    if total > area:
        done.append(f"holes closed, {100.0 * (total - area) / total:.2g} % of the surface")
    turned = [(part.faces[: len(faces)] != faces).any(axis=1) for part, faces in zip(large, given)]
    closed = all(part.is_volume for part in large)
    for index in _cavities(large, [bool(flips.mean() > 0.5) for flips in turned]):
        large[index].invert()
        turned[index] = ~turned[index]
    tell(sum(int(flips.sum()) for flips in turned), "face{} turned")
    result = joined(Mesh(np.asarray(part.vertices), np.asarray(part.faces)) for part in large)
    return Repair(result, closed, tuple(done))


def _cavities(parts: list[trimesh.Trimesh], inward: list[bool]) -> list[int]:
    """Which parts lie in the box around a larger one and were wound the other way.

    Of several boxes around each other the outermost counts: what lies in a cavity is a body.
    """
    low, high = np.array([part.bounds for part in parts]).transpose(1, 0, 2)
    holds = (low[:, None] <= low).all(axis=2) & (high <= high[:, None]).all(axis=2)
    size = np.prod(high - low, axis=1)
    outermost = np.argmax(np.where(holds, size[:, None], -1.0), axis=0)
    return [index for index, outer in enumerate(outermost) if inward[outer] != inward[index]]
