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

from .decomposition import Method, check_method, decompose
from .folder import META, load_object, save_object
from .mesh_files import MeshFile, Up, check_scale, mesh_files, read_mesh
from .model import DEFAULT_COLOUR, ConvexPiece, FloatArray, ObjectModel
from .solids import MassProperties, mass_properties

DEFAULT_DENSITY = 500.0
"""kg/m3: household things with the air in them. Procedural objects have 300 to 800."""
LEAST_FACES = 100
_RECORD = "prepared"
"""Entry of meta.json by which a finished object is known."""


@dataclass(frozen=True)
class PrepareSettings:
    """How meshes become objects.

    Attributes:
        scale: metres for each unit of the meshes; None: they are in metres.
        density: kg/m3, of the volume that the mesh encloses.
        mass: kg, of every object, in place of the density.
        up: axis of the meshes that points up.
        faces: most triangles of the visual mesh.
        decomposition: how convex pieces are made, see `decompose`.
    """

    scale: float | None = None
    density: float = DEFAULT_DENSITY
    mass: float | None = None
    up: Up = "z"
    faces: int = 2000
    decomposition: Method = "auto"

    def check(self) -> None:
        """Raise InvalidRequestError where a value is outside its range."""
        check_scale(self.scale)
        check_method(self.decomposition)
        if not (np.isfinite(self.density) and self.density > 0.0):
            raise InvalidRequestError(
                f"the density {self.density} was given; expected kg/m3 over 0, such as 500."
            )
        if self.mass is not None and not (np.isfinite(self.mass) and self.mass > 0.0):
            raise InvalidRequestError(
                f"the mass {self.mass} was given; expected kilograms over 0, such as 0.2."
            )
        if self.faces < LEAST_FACES:
            raise InvalidRequestError(
                f"{self.faces} faces were asked for; expected at least {LEAST_FACES}, such as "
                "2000."
            )


@dataclass(frozen=True, eq=False)
class Prepared:
    """An object and what `meta.json` says of how it was made."""

    model: ObjectModel
    meta: dict[str, Any]

    def line(self) -> str:
        """What it is and what was done, for a user."""
        x, y, z = 1000.0 * self.model.extents
        pieces = len(self.model.pieces)
        parts = [
            f"{x:.0f} x {y:.0f} x {z:.0f} mm",
            f"{self.model.mass:.3g} kg",
            f"{pieces} convex piece{'s' if pieces > 1 else ''}",
        ]
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
        run: of the others.
    """

    folders: list[Path]
    kept: int
    run: RunSummary


def prepare_object(file: MeshFile, settings: PrepareSettings | None = None) -> Prepared:
    """Make an object of a mesh file; its origin is the centre of mass.

    Volume, centre and inertia are those of the mesh at equal density where it is closed, else of
    the convex pieces.

    Raises:
        ObjectError: the mesh cannot be read, has an unlikely size, or no volume.
        InvalidRequestError: a setting is outside its range.
    """
    settings = settings or PrepareSettings()
    settings.check()
    read = read_mesh(file.path, settings.scale, settings.up)
    repair = repaired(read.mesh)
    if len(repair.mesh.faces) == 0:
        raise ObjectError(
            f"{file.path} has no triangle with an area; expected a mesh. Export it again."
        )
    pieces, method = _pieces(file, repair.mesh, settings.decomposition)
    solid = _solid(repair.mesh, pieces, repair.closed)
    visual = _visual(repair.mesh, settings.faces)
    density = settings.density if settings.mass is None else settings.mass / solid.volume
    model = ObjectModel(
        name=file.name,
        # What float32 holds comes back from the files as it went in.
        vertices=_rounded(visual.vertices - solid.centre),
        faces=np.asarray(visual.faces, np.int32),
        pieces=tuple(ConvexPiece(_rounded(v - solid.centre), f) for v, f in pieces),
        mass=density * solid.volume,
        inertia=density * solid.inertia,
        colour=read.colour or DEFAULT_COLOUR,
    )
    meta = {
        "name": file.name,
        "source": file.path.name,
        "source_path": file.path.name,
        "licence": None,
        "scale": settings.scale or 1.0,
        "up": settings.up,
        "source_offset": solid.centre.tolist(),
        "mass_source": "given" if settings.mass is not None else "volume*density",
        "density": density,
        "volume": solid.volume,
        "watertight": repair.closed,
        "repair": "; ".join(repair.done) or "none",
        "source_faces": len(read.mesh.faces),
        "decomposition": method,
        "rgb": None if read.colour is None else list(read.colour),
        _RECORD: {**_made_with(file, settings), "content": _content(model)},
    }
    return Prepared(model, meta)


def prepare_objects(
    source: str | Path,
    destination: str | Path,
    settings: PrepareSettings | None = None,
    executor: ExecutorConfig | None = None,
    *,
    on_object: Callable[[Prepared], object] | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> PrepareSummary:
    """Make an object folder below `destination` of every mesh of `source` (`mesh_files`).

    A folder that is whole and was made of the same file with the same settings is kept; one that
    is damaged or half written is made again. A mesh that fails does not stop the others.

    Args:
        source: folder of meshes, or a mesh file.
        destination: made when missing.
        settings: how.
        executor: where it runs.
        on_object: called with each object that was made, once it is written.
        on_progress: called after every mesh.

    Raises:
        ObjectError: no mesh there, or the folders lie in one another.
        InvalidRequestError: a setting is outside its range.
    """
    settings = settings or PrepareSettings()
    settings.check()
    source, destination = Path(source), Path(destination)
    _check_apart(source, destination)
    files = mesh_files(source)
    todo = [file for file in files if not _is_finished(file, destination / file.name, settings)]

    written: list[Prepared] = []

    def save(file: MeshFile, prepared: Prepared) -> None:
        _save(prepared, destination / file.name)
        written.append(prepared)

    def tell(progress: Progress) -> None:
        # Not while saving: what goes wrong in here says nothing about the object.
        while written:
            prepared = written.pop()
            if on_object is not None:
                on_object(prepared)
        if on_progress is not None:
            on_progress(progress)

    run = run_units(
        functools.partial(prepare_object, settings=settings),
        todo,
        executor,
        on_result=save,
        on_progress=tell,
    )
    folders = [destination / file.name for file in files if _record(destination / file.name)]
    return PrepareSummary(folders, len(files) - len(todo), run)


def _check_apart(source: Path, destination: Path) -> None:
    one, other = source.resolve(), destination.resolve()
    if one.is_dir() and (one == other or one in other.parents or other in one.parents):
        raise ObjectError(
            f"meshes are read from {source} and objects written to {destination}, which lie in "
            "one another; expected two folders apart. Give another destination."
        )


def _pieces(file: MeshFile, mesh: Mesh, method: Method) -> tuple[tuple[ConvexPiece, ...], str]:
    try:
        found = decompose(mesh, method)
    except ObjectError as error:
        raise ObjectError(f"{file.path}: {error}") from None
    return found.pieces, found.method


def _solid(mesh: Mesh, pieces: tuple[ConvexPiece, ...], closed: bool) -> MassProperties:
    if closed:
        found = mass_properties([ConvexPiece(mesh.vertices, np.asarray(mesh.faces, np.int32))])
        if found.volume > 0.0 and (np.linalg.eigvalsh(found.inertia) > 0.0).all():
            return found
    return mass_properties(pieces)


def _visual(mesh: Mesh, count: int) -> Mesh:
    """At most `count` faces, closed again where that costs a few."""
    visual = simplified(mesh, count)
    if len(visual.faces) < len(mesh.faces):
        again = repaired(visual)
        if again.closed and len(again.mesh.faces) <= count:
            return again.mesh
    return visual


def _rounded(vertices: FloatArray) -> FloatArray:
    return vertices.astype(np.float32).astype(np.float64)


def _made_with(file: MeshFile, settings: PrepareSettings) -> dict[str, Any]:
    return {"mesh": file.fingerprint(), "settings": dataclasses.asdict(settings)}


def _content(model: ObjectModel) -> str:
    """sha256 of what the files of an object hold, as they hold it."""
    digest = hashlib.sha256()
    for vertices, faces in (model.mesh, *model.pieces):
        digest.update(np.ascontiguousarray(vertices, dtype="<f4").tobytes())
        digest.update(np.ascontiguousarray(faces, dtype="<i4").tobytes())
    return digest.hexdigest()


def _is_finished(file: MeshFile, folder: Path, settings: PrepareSettings) -> bool:
    record = _record(folder)
    if record is None:
        return False
    try:
        made_with = _made_with(file, settings)
        whole = record.get("content") == _content(load_object(folder))
    except (ObjectError, OSError):
        # Whatever is wrong with the mesh is told when it is read again.
        return False
    return whole and {key: record.get(key) for key in made_with} == made_with


def _record(folder: Path) -> dict[str, Any] | None:
    """The entry of a meta.json that this module wrote; None without one."""
    try:
        record = json.loads((folder / META).read_text(encoding="utf-8"))[_RECORD]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return record if isinstance(record, dict) else None


def _save(prepared: Prepared, folder: Path) -> None:
    """Write an object in the place of what is half written there.

    Raises ObjectError where another object, or something else, has the name.
    """
    meta = folder / META
    if meta.is_file() and _record(folder) is None and _is_object(folder):
        raise ObjectError(
            f"{folder} holds an object that was not made of a mesh by this command; expected "
            "another destination. Give one, or remove the folder."
        )
    # Without it the folder is no object: one that is killed from here on leaves none.
    meta.unlink(missing_ok=True)
    save_object(prepared.model, folder, prepared.meta)


def _is_object(folder: Path) -> bool:
    try:
        load_object(folder)
    except ObjectError:
        return False
    return True
