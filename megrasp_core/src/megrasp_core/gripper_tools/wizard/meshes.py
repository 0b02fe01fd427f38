"""Mesh files of a model: found, converted to what MuJoCo reads, copied beside the description."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import trimesh

from megrasp_core.errors import DescriptionError
from megrasp_core.meshes import Mesh, simplified

from .collada import read_collada

FOLDER = "meshes"
MOST_FACES = 190_000
"""MuJoCo reads STL files of at most 200 000 triangles."""

PARENTS = 5
PACKAGE = "package://"
VARIABLES = ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH", "COLCON_PREFIX_PATH")


@dataclass
class MeshFinder:
    """Finds the files that a model names.

    Args:
        folder: the model's folder.
        packages: ROS package name -> its folder, as the user gave them.
        roots: folders that relative names count from, the model's own first.
    """

    folder: Path
    packages: Mapping[str, Path]
    roots: tuple[Path, ...] = ()
    guessed: dict[str, Path] = field(default_factory=dict)

    def package(self, name: str) -> Path | None:
        """Return the folder of a ROS package, or None."""
        return next((place for place in self._package_folders(name) if place.is_dir()), None)

    def find(self, name: str) -> Path | None:
        """Return the file, or None. Files found elsewhere than stated, or in other letter case,
        are noted in `guessed`.
        """
        plain = name.removeprefix("file://").replace("model://", PACKAGE)
        if plain.startswith(PACKAGE):
            package, _, rest = plain.removeprefix(PACKAGE).partition("/")
            for place in self._package_folders(package):
                if (file := self._in(place, Path(rest), name)) is not None:
                    return file
            return self._beside(name, Path(rest))
        path = Path(plain)
        for root in (self.folder, *self.roots):
            if (file := self._in(root, path, name)) is not None:
                return file
        return self._beside(name, path)

    def _in(self, folder: Path, path: Path, name: str) -> Path | None:
        """Return the file below a folder, in whatever letter case it is written."""
        if (folder / path).is_file():
            return folder / path
        found = _any_case(folder, path)
        if found is not None:
            self.guessed[name] = found
        return found

    def _package_folders(self, package: str) -> list[Path]:
        if package in self.packages:
            return [self.packages[package]]
        out = []
        for parent in [self.folder.resolve(), *self.folder.resolve().parents][: PARENTS + 1]:
            out += [parent / package]
        for parent in [self.folder.resolve(), *self.folder.resolve().parents][:PARENTS]:
            if _package_name(parent) == package:
                out.append(parent)
        for variable in VARIABLES:
            for prefix in filter(None, os.environ.get(variable, "").split(":")):
                out += [Path(prefix) / "share" / package, Path(prefix) / package]
        return out

    def _beside(self, name: str, path: Path) -> Path | None:
        """Look for the end of a path from the model's folder upwards, longest end first."""
        parts = path.parts[1:] if path.is_absolute() else path.parts
        for parent in [self.folder.resolve(), *self.folder.resolve().parents][:PARENTS]:
            for start in range(len(parts)):
                candidate = _any_case(parent, Path(*parts[start:]))
                if candidate is not None:
                    self.guessed[name] = candidate
                    return candidate
        return None


def _any_case(folder: Path, path: Path) -> Path | None:
    """Return the file at a path below a folder, letter case aside; None where there is none."""
    here = Path(path.anchor) if path.is_absolute() else folder
    for part in path.parts[1:] if path.is_absolute() else path.parts:
        if part == ".." or (here / part).exists():
            here = here / part
            continue
        try:
            names = sorted(entry.name for entry in here.iterdir())
        except OSError:
            return None
        same = [name for name in names if name.lower() == part.lower()]
        if not same:
            return None
        here = here / same[0]
    return here if here.is_file() else None


def _package_name(folder: Path) -> str | None:
    file = folder / "package.xml"
    if not file.is_file():
        return None
    try:
        return (ElementTree.parse(file).getroot().findtext("name") or "").strip()
    except ElementTree.ParseError:
        return None


def missing_message(model: Path, missing: Mapping[str, str]) -> str:
    """Return what to say about meshes that are not there: name -> the link that uses it."""
    listed = "; ".join(f"{name} (link '{link}')" for name, link in list(missing.items())[:5])
    more = f" and {len(missing) - 5} more" if len(missing) > 5 else ""
    text = f"{model}: {len(missing)} mesh files cannot be found: {listed}{more}. "
    packages = sorted(
        {
            name.removeprefix(PACKAGE).partition("/")[0]
            for name in missing
            if name.startswith(PACKAGE)
        }
    )
    if packages:
        given = " ".join(f"{package}=/folder/of/{package}" for package in packages)
        return f"{text}Say where the ROS packages lie: --package {given}"
    return (
        f"{text}Put them where the model names them, relative to {model.parent}; what is no part "
        "of the gripper is not looked for with --root LINK, the link that the fingers hang from"
    )


class MeshStore:
    """Copies meshes into `folder`/meshes under names that do not clash."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / FOLDER
        self.converted: list[str] = []
        self._names: dict[Path, str] = {}

    def add(self, file: Path) -> str:
        """Copy or convert one file; return its name below the store's folder."""
        file = file.resolve()
        if file in self._names:
            return self._names[file]
        self.folder.mkdir(parents=True, exist_ok=True)
        mesh = _needs_conversion(file)
        suffix = file.suffix.lower() if mesh is None else ".stl"
        taken = set(self._names.values())
        stem = "".join(c if c.isalnum() or c in "-_." else "_" for c in file.stem)
        name, count = f"{stem}{suffix}", 1
        while name in taken:
            count += 1
            name = f"{stem}_{count}{suffix}"
        self._names[file] = name
        if mesh is None:
            shutil.copyfile(file, self.folder / name)
            (self.folder / name).chmod(0o644)
        else:
            mesh.export(self.folder / name)
            self.converted.append(file.name)
        return name


def _needs_conversion(file: Path) -> trimesh.Trimesh | None:
    """Return the mesh of a file that MuJoCo cannot read as it is, None of one that it can."""
    suffix = file.suffix.lower()
    if suffix == ".msh" or (suffix == ".obj" and file.stat().st_size < 20_000_000):
        return None
    if suffix == ".stl" and _binary_stl_faces(file) in range(1, MOST_FACES):
        return None
    try:
        mesh = read_collada(file) if suffix == ".dae" else trimesh.load(file, force="mesh")
    except Exception as error:
        raise DescriptionError(
            f"cannot read the mesh {file}: {error}; expected STL, OBJ, DAE, PLY, GLB or OFF. "
            "Convert it to STL"
        ) from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise DescriptionError(f"the mesh {file} holds no triangles; export it again as STL")
    return _thinned(mesh)


def _binary_stl_faces(file: Path) -> int:
    """Return the number of triangles of a binary STL file, 0 for a text one."""
    with file.open("rb") as stream:
        head = stream.read(84)
    count = int.from_bytes(head[80:84], "little") if len(head) == 84 else 0
    return count if file.stat().st_size == 84 + 50 * count else 0


def _thinned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    if len(mesh.faces) <= MOST_FACES:
        return mesh
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    whole = Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64))
    fewer = simplified(whole, MOST_FACES)
    return trimesh.Trimesh(fewer.vertices, fewer.faces, process=False)
