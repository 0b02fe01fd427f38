"""Reading a stranger's model: URDF or MJCF with its meshes, as one `mujoco.MjSpec`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from megrasp_core.errors import DescriptionError
from megrasp_core.grippers import read_xml

from .findings import Notes
from .meshes import MeshFinder, MeshStore, missing_message

LEAST_MASS = 1e-3
LEAST_INERTIA = 1e-7
SHAPES = ("visual", "collision")


def read_source(
    path: Path, folder: Path, packages: Mapping[str, Path], notes: Notes
) -> mujoco.MjSpec:
    """Read a model; its meshes are copied to `folder`/meshes and named there.

    Args:
        path: URDF or MJCF file.
        folder: where the meshes go.
        packages: ROS package name -> folder.
        notes: what was found and done is written here.

    Raises:
        DescriptionError: no model, or meshes that are not there.
    """
    if not path.is_file():
        raise DescriptionError(f"no model at {path}; expected a URDF or MJCF file")
    root = read_xml(path)
    store = MeshStore(folder)
    if root.tag == "robot":
        spec = _read_urdf(path, root, packages, store, notes)
    else:
        spec = _read_mjcf(path, packages, store, notes)
    spec.meshdir = str(store.folder.resolve())
    if store.converted:
        notes.add(f"meshes converted to STL: {', '.join(sorted(set(store.converted)))}")
    return spec


def _read_urdf(
    path: Path,
    root: ElementTree.Element,
    packages: Mapping[str, Path],
    store: MeshStore,
    notes: Notes,
) -> mujoco.MjSpec:
    compiler = root.find("mujoco/compiler")
    meshdir = compiler.get("meshdir", "") if compiler is not None else ""
    finder = MeshFinder(path.parent, packages, (path.parent / meshdir,))
    missing: dict[str, str] = {}
    for link in root.findall("link"):
        for shape in [item for kind in SHAPES for item in link.findall(kind)]:
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            name = mesh.get("filename", "")
            file = finder.find(name)
            if file is None:
                missing[name] = link.get("name", "?")
            else:
                mesh.set("filename", store.add(file))
    if missing:
        raise DescriptionError(missing_message(path, missing))
    _note_guesses(finder, notes)
    for element in root.findall("mujoco"):
        root.remove(element)
    options = {
        "meshdir": str(store.folder.resolve()),
        "strippath": "false",
        "discardvisual": "false",
        "fusestatic": "false",
        "balanceinertia": "true",
        "boundmass": str(LEAST_MASS),
        "boundinertia": str(LEAST_INERTIA),
    }
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", options)
    return _parse(path, ElementTree.tostring(root, encoding="unicode"))


def _read_mjcf(
    path: Path, packages: Mapping[str, Path], store: MeshStore, notes: Notes
) -> mujoco.MjSpec:
    spec = _parse(path, None)
    finder = MeshFinder(path.parent, packages, (path.parent / (spec.meshdir or ""),))
    users = {geom.meshname: geom.parent.name for geom in spec.geoms if geom.meshname}
    missing: dict[str, str] = {}
    for mesh in spec.meshes:
        if not mesh.file:
            continue
        mesh.name = mesh.name or Path(mesh.file).stem
        file = finder.find(mesh.file)
        if file is None:
            missing[mesh.file] = users.get(mesh.name, "?")
        else:
            mesh.file = store.add(file)
            mesh.content_type = ""
    if missing:
        raise DescriptionError(missing_message(path, missing))
    _note_guesses(finder, notes)
    return spec


def _parse(path: Path, text: str | None) -> mujoco.MjSpec:
    try:
        spec = mujoco.MjSpec.from_file(str(path)) if text is None else None
        return spec if spec is not None else mujoco.MjSpec.from_string(text or "")
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise DescriptionError(f"MuJoCo cannot read {path}: {reason}") from error


def _note_guesses(finder: MeshFinder, notes: Notes) -> None:
    for name, file in finder.guessed.items():
        notes.add(f"mesh {name} is not where the model says; {file} was taken")
