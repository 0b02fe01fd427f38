"""Mesh files of objects: which there are, what they hold, and whether their unit is the metre."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from megrasp_core.errors import ObjectError
from megrasp_core.meshes import Mesh

SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".off")
SMALLEST, LARGEST = 0.003, 1.0
"""Longest edge of the box around what may be an object to grasp (m)."""
UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "metres": 1.0}
LIKELY = 0.01, 0.5
"""Sizes (m) at which a unit is named as the likely one."""

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class MeshFile:
    """A mesh file and the name of the object that it becomes."""

    name: str
    path: Path

    def __str__(self) -> str:
        return self.name


def mesh_files(source: str | Path) -> list[MeshFile]:
    """Return the mesh files of a folder, sorted by name; of a file, itself.

    Files lie in the folder, and are named after themselves, or one in each of its sub-folders,
    named after these.

    Raises:
        ObjectError: the folder is missing or holds no mesh, a sub-folder holds several, or two
            have one name.
    """
    source, kinds = Path(source), ", ".join(SUFFIXES)
    if source.is_file() and source.suffix.lower() in SUFFIXES:
        return [MeshFile(source.stem, source)]
    if not source.is_dir():
        raise ObjectError(
            f"{source} is no folder and no mesh file; expected a file of {kinds}, or a folder "
            "with such files or with a sub-folder for each. Check the path."
        )
    found = [MeshFile(path.stem, path) for path in _meshes_in(source)]
    for folder in (path for path in source.iterdir() if path.is_dir()):
        inside = _meshes_in(folder)
        if len(inside) > 1:
            raise ObjectError(
                f"{folder} holds {len(inside)} meshes ({inside[0].name}, {inside[1].name}"
                f"{', ...' if len(inside) > 2 else ''}); expected one in each sub-folder. Leave "
                "one there, or give the sub-folder itself."
            )
        found += [MeshFile(folder.name, path) for path in inside]
    if not found:
        raise ObjectError(
            f"{source} holds no mesh; expected {kinds} in it, or one in each of its sub-folders. "
            "Check the path."
        )
    found.sort(key=lambda file: (file.name, file.path))
    for one, other in itertools.pairwise(found):
        if one.name == other.name:
            raise ObjectError(
                f"{one.path} and {other.path} would both become the object {one.name}; expected "
                "a name for each. Rename one."
            )
    return found


def _meshes_in(folder: Path) -> list[Path]:
    return sorted(
        path for path in folder.iterdir() if path.is_file() and path.suffix.lower() in SUFFIXES
    )


def read_mesh(path: Path, scale: float | None = None) -> tuple[Mesh, Colour | None]:
    """Read a mesh file: its bodies as one mesh in metres, and their mean colour in 0..1, None
    where there is none.

    Args:
        path: .obj, .ply, .stl, .glb or .off.
        scale: what its numbers are multiplied by to be metres; None: 1.

    Raises:
        ObjectError: it cannot be read, holds no triangle, or its size is none of an object to
            grasp; the units that would explain it are named.
    """
    try:
        found = trimesh.load_scene(path, process=False).to_mesh()
        vertices, faces = np.asarray(found.vertices, np.float64), np.asarray(found.faces, np.int64)
        corners = vertices[faces].reshape(-1, 3)
    except Exception as error:
        # The loaders raise whatever a damaged file makes them stumble over.
        told = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise ObjectError(
            f"{path} cannot be read ({told}); expected a {path.suffix} mesh. Export it again."
        ) from error
    corners = corners[np.isfinite(corners).all(axis=1)]
    if len(corners) == 0:
        raise ObjectError(f"{path} holds no triangle; expected a mesh. Export it again.")
    _check_size(path, float(np.ptp(corners, axis=0).max()), scale)
    return Mesh(vertices * (scale or 1.0), faces), _colour(found)


def _check_size(path: Path, size: float, scale: float | None) -> None:
    metres = size * (scale or 1.0)
    if SMALLEST <= metres <= LARGEST:
        return
    likely = [
        f"{name} it would be {_length(size * unit)} (--scale {unit:g})"
        for name, unit in UNITS.items()
        if LIKELY[0] <= size * unit <= LIKELY[1] and unit != (scale or 1.0)
    ]
    given = "" if scale is None else f" with the scale {scale:g}"
    advice = f"In {', in '.join(likely)}." if likely else "Give --scale: metres for each unit."
    raise ObjectError(
        f"{path} is {_length(metres)} long{given}; expected metres, from {_length(SMALLEST)} to "
        f"{_length(LARGEST)}. {advice}"
    )


def _length(metres: float) -> str:
    return f"{1000 * metres:.3g} mm" if metres < 1.0 else f"{metres:.3g} m"


def _colour(mesh: trimesh.Trimesh) -> Colour | None:
    """Mean over the area of the colours of faces, vertices, materials or pictures."""
    try:
        visual: Any = mesh.visual
        if not visual.defined:
            return None
        colours = (visual.to_color() if visual.kind == "texture" else visual).face_colors[:, :3]
        mean = np.average(colours / 255.0, axis=0, weights=np.nan_to_num(mesh.area_faces))
    except Exception:
        # A picture that is missing or odd is no reason to have no object.
        return None
    return (float(mean[0]), float(mean[1]), float(mean[2])) if np.isfinite(mean).all() else None
