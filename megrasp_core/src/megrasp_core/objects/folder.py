"""Object folders: `visual.obj`, `collision.npz`, `meta.json`."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from megrasp_core.errors import ObjectError

from .model import (
    DEFAULT_COLOUR,
    DEFAULT_FRICTION,
    ConvexPiece,
    FaceArray,
    FloatArray,
    ObjectModel,
)
from .solids import volume_of

# What numpy raises for files that are cut short or are something else.
_DAMAGE = (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error)
VISUAL, COLLISION, META = "visual.obj", "collision.npz", "meta.json"
_ARRAYS = ("verts", "faces", "vert_start", "face_start")


def load_object(folder: str | Path, name: str | None = None) -> ObjectModel:
    """Read one object folder. `name` is the name to give it, by default that of the folder.

    Raises ObjectError that names the folder and what is missing or wrong in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ObjectError(
            f"no object folder {folder}; expected a folder with {VISUAL}, {COLLISION} and "
            f"{META}. Check the path."
        )
    missing = [file for file in (VISUAL, COLLISION, META) if not (folder / file).is_file()]
    if missing:
        raise ObjectError(
            f"the object folder {folder} lacks {', '.join(missing)}; expected {VISUAL}, "
            f"{COLLISION} and {META}. Make it with 'megrasp objects prepare' or 'megrasp objects "
            "generate'."
        )
    meta = _read_meta(folder / META)
    vertices, faces = _read_obj(folder / VISUAL)
    colour = meta.get("rgb")
    friction = meta.get("friction")
    try:
        return ObjectModel(
            name=name or folder.name,
            vertices=vertices,
            faces=faces,
            pieces=_read_pieces(folder / COLLISION),
            mass=float(meta["mass"]),
            inertia=np.asarray(meta["inertia"], dtype=np.float64),
            colour=DEFAULT_COLOUR if colour is None else _floats(colour, 3),
            friction=DEFAULT_FRICTION if friction is None else _floats(friction, 2),
            category=str(meta.get("category") or meta.get("set") or ""),
        )
    except (TypeError, ValueError) as error:
        raise ObjectError(
            f"{folder / META} holds a value of the wrong kind ({error}); expected numbers."
        ) from error
    except ObjectError as error:
        raise ObjectError(f"{folder}: {error}") from None


def load_objects(folder: str | Path) -> list[ObjectModel]:
    """Read every object at or below `folder`, sorted by relative path, which is the name.

    Raises ObjectError when the folder is missing, holds no object, or one of them is wrong.
    """
    return [load_object(path, name) for name, path in find_objects(folder)]


def find_objects(folder: str | Path) -> list[tuple[str, Path]]:
    """Return (relative path, folder) of every folder that holds a meta.json, sorted by path.

    Raises ObjectError when the folder is missing or holds no object.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ObjectError(
            f"no folder {folder}; expected one with object folders in it. Check the path."
        )
    found = [meta.parent for meta in folder.rglob(META)]
    if not found:
        raise ObjectError(
            f"{folder} holds no object: no {META} at any depth. Expected folders with {VISUAL}, "
            f"{COLLISION} and {META}; make some with 'megrasp objects generate {folder} -n 20'."
        )
    named = [
        (path.relative_to(folder).as_posix() if path != folder else folder.name, path)
        for path in found
    ]
    return sorted(named)


def save_object(
    model: ObjectModel, folder: str | Path, extra: Mapping[str, Any] | None = None
) -> None:
    """Write one object folder, made when missing; `extra` fields join those of meta.json.

    Collision vertices are stored as float32, as the format says. Raises ObjectError when it cannot
    be written.
    """
    folder = Path(folder)
    solid = sum(volume_of(piece.vertices, piece.faces) for piece in model.pieces)
    visual = trimesh.Trimesh(model.vertices, model.faces, process=False)
    meta: dict[str, Any] = {
        "name": model.name,
        "category": model.category,
        "scale": 1.0,
        "source_offset": [0.0, 0.0, 0.0],
        "com": [0.0, 0.0, 0.0],
        "mass": model.mass,
        "volume": float(visual.volume) if visual.is_watertight else None,
        "convex_volume": solid,
        "inertia": model.inertia.tolist(),
        "extents": model.extents.tolist(),
        "friction": list(model.friction),
        "faces": len(model.faces),
        "vertices": len(model.vertices),
        "watertight": bool(visual.is_watertight),
        "convex_parts": len(model.pieces),
        "rgb": list(model.colour),
        **(extra or {}),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / VISUAL).write_text(_obj_text(model.vertices, model.faces), encoding="utf-8")
        np.savez_compressed(
            folder / COLLISION,
            verts=np.concatenate([piece.vertices for piece in model.pieces]).astype(np.float32),
            faces=np.concatenate([piece.faces for piece in model.pieces]).astype(np.int32),
            vert_start=_starts([len(piece.vertices) for piece in model.pieces]),
            face_start=_starts([len(piece.faces) for piece in model.pieces]),
        )
        # Last: a folder counts as an object once it holds this file, so an interrupted write
        # leaves none behind.
        (folder / META).write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise ObjectError(
            f"cannot write the object folder {folder} ({error}); expected a writable place."
        ) from error


def _starts(lengths: list[int]) -> FaceArray:
    return np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)


def _obj_text(vertices: FloatArray, faces: FaceArray) -> str:
    lines = ["# metres, origin at the centre of mass"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    return "\n".join(lines) + "\n"


def _floats(values: Any, count: int) -> Any:
    numbers = tuple(float(value) for value in values)
    if len(numbers) != count:
        raise ValueError(f"{len(numbers)} numbers where {count} are expected")
    return numbers


def _read_meta(path: Path) -> dict[str, Any]:
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ObjectError(
            f"{path} is not readable JSON ({error}); expected an object with mass and inertia."
        ) from error
    missing = [
        key for key in ("mass", "inertia") if not isinstance(meta, dict) or meta.get(key) is None
    ]
    if missing:
        raise ObjectError(
            f"{path} lacks {', '.join(missing)}; expected mass (kg) and inertia (3 x 3, kg m2) "
            "about the centre of mass."
        )
    return meta


def _read_obj(path: Path) -> tuple[FloatArray, FaceArray]:
    try:
        mesh = trimesh.load_mesh(path, file_type="obj", process=False, skip_materials=True)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    except Exception as error:
        # The loader raises whatever a damaged file makes it stumble over.
        raise ObjectError(
            f"{path} is not a readable OBJ mesh ({error}); expected v and f lines."
        ) from error
    if not len(faces):
        raise ObjectError(f"{path} holds no face; expected a triangle mesh in metres.")
    return vertices, faces


def _read_pieces(path: Path) -> tuple[ConvexPiece, ...]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            missing = [key for key in _ARRAYS if key not in archive]
            arrays = {key: archive[key] for key in _ARRAYS if key in archive}
    except _DAMAGE as error:
        raise ObjectError(f"{path} is damaged ({error}); expected a numpy archive.") from error
    if missing:
        raise ObjectError(
            f"{path} lacks the arrays {', '.join(missing)}; expected {', '.join(_ARRAYS)}."
        )
    verts, faces = arrays["verts"].astype(np.float64), arrays["faces"]
    at, corner = arrays["vert_start"], arrays["face_start"]
    if len(at) != len(corner) or len(at) < 2 or at[-1] != len(verts) or corner[-1] != len(faces):
        raise ObjectError(
            f"{path}: vert_start and face_start do not fit verts and faces; expected P+1 starts "
            "each, the last one the number of rows."
        )
    return tuple(
        ConvexPiece(verts[at[i] : at[i + 1]], faces[corner[i] : corner[i + 1]])
        for i in range(len(at) - 1)
    )
