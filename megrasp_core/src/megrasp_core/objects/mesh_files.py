"""Mesh files of objects: which there are, what they hold, and whether their unit is the metre."""

from __future__ import annotations

import hashlib
import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import trimesh
from numpy.typing import NDArray

from megrasp_core.errors import InvalidRequestError, ObjectError
from megrasp_core.meshes import Mesh

SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".off")
Up = Literal["x", "y", "z"]
SMALLEST, LARGEST = 0.003, 1.0
"""Longest edge of the box around what may be an object to grasp (m)."""
UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254}
SIZES = 0.01, 0.5
"""Sizes (m) at which a unit is named as the likely one."""
_UP_TURNS = {
    "x": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "z": np.eye(3),
}


@dataclass(frozen=True)
class MeshFile:
    """A mesh file and the name of the object that it becomes."""

    name: str
    path: Path

    def __str__(self) -> str:
        return self.name

    def fingerprint(self) -> str:
        """sha256 of the content."""
        return hashlib.sha256(self.path.read_bytes()).hexdigest()


@dataclass(frozen=True, eq=False)
class ReadMesh:
    """A mesh in metres, +Z up, and its mean colour (3,) in 0..1, None where it has none."""

    mesh: Mesh
    colour: tuple[float, float, float] | None


def mesh_files(source: str | Path) -> list[MeshFile]:
    """Return the mesh files of a folder, sorted by name; of a file, itself.

    Files lie in the folder, and are named after themselves, or one in each of its sub-folders,
    named after these.

    Raises:
        ObjectError: the folder is missing or holds no mesh, a sub-folder holds several, or two
            have one name.
    """
    source = Path(source)
    kinds = ", ".join(SUFFIXES)
    if source.is_file():
        if source.suffix.lower() not in SUFFIXES:
            raise ObjectError(f"{source} is no mesh file; expected one of {kinds}.")
        return [MeshFile(source.stem, source)]
    if not source.is_dir():
        raise ObjectError(
            f"no folder {source}; expected one with meshes ({kinds}) or with a sub-folder for "
            "each. Check the path."
        )
    found = [MeshFile(path.stem, path) for path in _meshes_in(source)]
    for folder in sorted(path for path in source.iterdir() if path.is_dir()):
        inside = _meshes_in(folder)
        if len(inside) > 1:
            raise ObjectError(
                f"{folder} holds {len(inside)} meshes ({', '.join(p.name for p in inside[:3])}"
                f"{', ...' if len(inside) > 3 else ''}); expected one in each sub-folder. Leave "
                "one there, or give the sub-folder itself."
            )
        found += [MeshFile(folder.name, path) for path in inside]
    if not found:
        raise ObjectError(
            f"{source} holds no mesh; expected {kinds} in it, or one in each of its sub-folders."
        )
    found.sort(key=lambda file: file.name)
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


def read_mesh(path: Path, scale: float | None = None, up: Up = "z") -> ReadMesh:
    """Read a mesh file.

    Args:
        path: .obj, .ply, .stl, .glb or .off; several bodies in it become one mesh.
        scale: what its numbers are multiplied by to be metres; None: 1.
        up: its axis that points up, turned to +Z.

    Raises:
        ObjectError: it cannot be read, holds no triangle, or its size is none of an object to
            grasp; the units that would explain it are named.
        InvalidRequestError: the scale is not over 0, or another axis.
    """
    check_scale(scale)
    if up not in _UP_TURNS:
        raise InvalidRequestError(f"up {up!r} was given; expected one of {', '.join(_UP_TURNS)}.")
    try:
        found = trimesh.load_scene(path, process=False).to_mesh()
    except Exception as error:
        # The loaders raise whatever a damaged file makes them stumble over.
        raise ObjectError(
            f"{path} cannot be read ({_first_line(error)}); expected a {path.suffix} mesh. "
            "Export it again."
        ) from error
    vertices, faces = np.asarray(found.vertices, np.float64), np.asarray(found.faces, np.int64)
    if len(faces) == 0:
        raise ObjectError(f"{path} holds no triangle; expected a mesh. Export it again.")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ObjectError(
            f"{path} names vertex {int(faces.max())} of {len(vertices)}; expected a whole mesh. "
            "Export it again."
        )
    finite = vertices[np.unique(faces)]
    finite = finite[np.isfinite(finite).all(axis=1)]
    if len(finite) == 0:
        raise ObjectError(f"{path} holds no finite vertex; expected metres. Export it again.")
    _check_size(path, float(np.ptp(finite, axis=0).max()), scale)
    with np.errstate(invalid="ignore"):
        vertices = vertices * (scale or 1.0) @ _UP_TURNS[up].T
    return ReadMesh(Mesh(vertices, faces), _colour(found))


def check_scale(scale: float | None) -> None:
    """Raise InvalidRequestError for a scale that is not over 0."""
    if scale is not None and not (np.isfinite(scale) and scale > 0.0):
        raise InvalidRequestError(
            f"the scale {scale} was given; expected a number over 0: metres for each unit of the "
            "meshes, 0.001 for millimetres."
        )


def _check_size(path: Path, size: float, scale: float | None) -> None:
    metres = size * (scale or 1.0)
    if SMALLEST <= metres <= LARGEST:
        return
    likely = [
        f"{name} it would be {_length(size * unit)} (--scale {unit:g})"
        for name, unit in [*UNITS.items(), ("metres", 1.0)]
        if SIZES[0] <= size * unit <= SIZES[1] and unit != (scale or 1.0)
    ]
    given = "" if scale is None else f" with the scale {scale:g}"
    advice = f"In {', in '.join(likely)}." if likely else "Give --scale: metres for each unit."
    raise ObjectError(
        f"{path} is {_length(metres)} long{given}; expected metres, from {_length(SMALLEST)} to "
        f"{_length(LARGEST)}. {advice}"
    )


def _length(metres: float) -> str:
    return f"{1000 * metres:.3g} mm" if metres < 1.0 else f"{metres:.3g} m"


def _first_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def _colour(mesh: Any) -> tuple[float, float, float] | None:
    """Mean over the area of the colours of faces, vertices, materials or pictures."""
    try:
        visual = mesh.visual
        if not visual.defined:
            return None
        if visual.kind == "texture":
            visual = visual.to_color()
        colours = np.asarray(visual.face_colors, dtype=np.float64)[:, :3] / 255.0
        weights = np.nan_to_num(np.asarray(mesh.area_faces, dtype=np.float64))
        mean: NDArray[np.float64] = np.average(colours, axis=0, weights=weights)
    except Exception:
        # A picture that is missing or odd is no reason to have no object.
        return None
    if not np.isfinite(mean).all():
        return None
    return float(mean[0]), float(mean[1]), float(mean[2])
