"""Objects from meshes: repaired, light, with convex pieces and mass; a folder of them resumes."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.errors import InvalidRequestError, ObjectError
from megrasp_core.jobs import ExecutorConfig, Progress, RunSummary, run_units
from megrasp_core.meshes import Mesh, repaired, simplified

from .decomposition import Method, available_method, decompose
from .folder import META, load_object, save_object
from .mesh_files import MeshFile, mesh_files, read_mesh
from .model import DEFAULT_COLOUR, ConvexPiece, ObjectModel
from .solids import mass_properties

DEFAULT_DENSITY = 500.0
"""kg/m3: household things with the air in them. Procedural objects have 300 to 800."""
LEAST_FACES = 100
_RECORD = "prepared"
"""Entry of meta.json by which a finished object is known: what it was made of, and how."""


@dataclass(frozen=True)
class PrepareSettings:
    """How meshes become objects.

    Attributes:
        scale: metres for each unit of the meshes; None: they are in metres.
        density: kg/m3, of the volume that the mesh encloses.
        mass: kg, of every object, in place of the density.
        faces: most triangles of the visual mesh.
        decomposition: how convex pieces are made, see `decompose`.
    """

    scale: float | None = None
    density: float = DEFAULT_DENSITY
    mass: float | None = None
    faces: int = 2000
    decomposition: Method = "auto"

    def checked(self) -> PrepareSettings:
        """Return these with the decomposition that is available for "auto".

        Raises InvalidRequestError where a value is outside its range.
        """
        for what, value, unit, example in (
            ("scale", self.scale, "metres for each unit of the meshes", "0.001 for millimetres"),
            ("density", self.density, "kg/m3", "500"),
            ("mass", self.mass, "kilograms", "0.2"),
        ):
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise InvalidRequestError(
                    f"the {what} {value} was given; expected {unit} over 0, such as {example}."
                )
        if self.faces < LEAST_FACES:
            raise InvalidRequestError(
                f"{self.faces} faces were asked for; expected at least {LEAST_FACES}, such as "
                "2000."
            )
        return dataclasses.replace(self, decomposition=available_method(self.decomposition))


@dataclass(frozen=True, eq=False)
class Prepared:
    """An object and what `meta.json` says of how it was made."""

    model: ObjectModel
    meta: dict[str, Any]

    def line(self) -> str:
        """What it is and what was done, for a user."""
        size = " x ".join(f"{1000.0 * edge:.0f}" for edge in self.model.extents)
        pieces = len(self.model.pieces)
        parts = [f"{size} mm", f"{self.model.mass:.3g} kg"]
        parts.append(f"{pieces} convex piece{'' if pieces == 1 else 's'}")
        if not self.meta["watertight"]:
            parts.append("not closed: mass and volume are those of the pieces")
        if self.meta["repair"] != "none":
            parts.append(self.meta["repair"])
        return f"{self.model.name}: {', '.join(parts)}"


@dataclass
class PrepareSummary:
    """What a run over a folder did.

    Attributes:
        folders: of the objects that are there now, sorted by name.
        kept: how many of them were finished before.
        made: a line for each of the others, in order of completion.
        run: how these went.
    """

    folders: list[Path]
    kept: int
    made: list[str]
    run: RunSummary


def prepare_object(file: MeshFile, settings: PrepareSettings | None = None) -> Prepared:
    """Make an object of a mesh file; its origin is the centre of mass.

    Volume, centre and inertia are those of the mesh at equal density where it is closed, else of
    the convex pieces.

    Raises:
        ObjectError: the mesh cannot be read, has an unlikely size, or no volume.
        InvalidRequestError: a setting is outside its range.
    """
    settings = (settings or PrepareSettings()).checked()
    mesh, colour = read_mesh(file.path, settings.scale)
    # Volumes and inertia are sums of tetrahedra up to the origin, which may be far away.
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    low, high = np.nanmin(corners, axis=0), np.nanmax(corners, axis=0)
    middle = (low + high) / 2.0
    away = middle if np.abs(middle).max() > (high - low).max() else np.zeros(3)
    mesh = Mesh(mesh.vertices - away, mesh.faces)
    repair = repaired(mesh)
    try:
        found = decompose(repair.mesh, settings.decomposition)
    except ObjectError as error:
        raise ObjectError(f"{file.path}: {error}") from None
    whole = ConvexPiece(repair.mesh.vertices, np.asarray(repair.mesh.faces, np.int32))
    solid = mass_properties([whole] if repair.closed else found.pieces)
    visual = simplified(repair.mesh, settings.faces)
    density = settings.density if settings.mass is None else settings.mass / solid.volume
    model = ObjectModel(
        name=file.name,
        vertices=visual.vertices - solid.centre,
        faces=np.asarray(visual.faces, np.int32),
        pieces=tuple(ConvexPiece(v - solid.centre, f) for v, f in found.pieces),
        mass=density * solid.volume,
        inertia=density * solid.inertia,
        colour=colour or DEFAULT_COLOUR,
    )
    meta = {
        "source": file.path.name,
        "licence": None,
        "scale": settings.scale or 1.0,
        "source_offset": (solid.centre + away).tolist(),
        "mass_source": "given" if settings.mass is not None else "volume*density",
        "density": density,
        "volume": solid.volume,
        "watertight": repair.closed,
        "repair": "; ".join(repair.done) or "none",
        "source_faces": len(mesh.faces),
        "decomposition": found.method,
        "rgb": None if colour is None else list(colour),
        _RECORD: _made_with(file, settings),
    }
    return Prepared(model, meta)


def prepare_objects(
    source: str | Path,
    destination: str | Path,
    settings: PrepareSettings | None = None,
    executor: ExecutorConfig | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> PrepareSummary:
    """Make an object folder below `destination` of every mesh of `source` (`mesh_files`).

    A folder that can be read and was made of the same file with the same settings is kept; one
    that is damaged or half written is made again. A mesh that fails does not stop the others.

    Args:
        source: folder of meshes, or a mesh file.
        destination: made when missing.
        settings: how.
        executor: where it runs.
        on_progress: called after every mesh.

    Raises:
        ObjectError: no mesh there, the folders lie in one another, or the destination is a file.
        InvalidRequestError: a setting is outside its range.
    """
    settings = (settings or PrepareSettings()).checked()
    source, destination = Path(source), Path(destination)
    one, other = source.resolve(), destination.resolve()
    if source.is_dir() and (one.is_relative_to(other) or other.is_relative_to(one)):
        raise ObjectError(
            f"meshes are read from {source} and objects written to {destination}, which lie in "
            "one another; expected two folders apart. Give another destination."
        )
    if destination.exists() and not destination.is_dir():
        raise ObjectError(
            f"objects would be written to {destination}, which is a file; expected a folder, or a "
            "path where one can be made."
        )
    files = mesh_files(source)
    todo = [file for file in files if not _is_finished(file, destination / file.name, settings)]
    made: list[str] = []

    def save(file: MeshFile, prepared: Prepared) -> None:
        _save(prepared, destination / file.name)
        made.append(prepared.line())

    run = run_units(
        functools.partial(prepare_object, settings=settings),
        todo,
        executor,
        on_result=save,
        on_progress=on_progress,
    )
    folders = [destination / file.name for file in files]
    folders = [folder for folder in folders if _RECORD in (_meta(folder) or {})]
    return PrepareSummary(folders, len(files) - len(todo), made, run)


def _made_with(file: MeshFile, settings: PrepareSettings) -> dict[str, Any]:
    digest = hashlib.sha256(file.path.read_bytes()).hexdigest()
    return {"mesh": digest, "settings": dataclasses.asdict(settings)}


def _is_finished(file: MeshFile, folder: Path, settings: PrepareSettings) -> bool:
    meta = _meta(folder) or {}
    try:
        whole = meta.get("faces") == len(load_object(folder).faces)
        return whole and meta.get(_RECORD) == _made_with(file, settings)
    except (ObjectError, OSError):
        # Whatever is wrong with the mesh is told when it is read again.
        return False


def _meta(folder: Path) -> dict[str, Any] | None:
    """What the meta.json of a folder holds; None where it is missing or damaged."""
    try:
        meta = json.loads((folder / META).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return meta if isinstance(meta, dict) else None


def _save(prepared: Prepared, folder: Path) -> None:
    """Write an object in the place of what is half written there.

    Raises ObjectError where an object that was not made here has the name.
    """
    if _RECORD not in (_meta(folder) or {_RECORD: None}):
        raise ObjectError(
            f"{folder} holds an object that was not made of a mesh by this command; expected "
            "another destination. Give one, or remove the folder."
        )
    # Without it the folder is no object: one that is killed from here on leaves none.
    (folder / META).unlink(missing_ok=True)
    save_object(prepared.model, folder, prepared.meta)
