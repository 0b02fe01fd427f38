"""Reading a stranger's model: URDF, xacro or MJCF with its meshes, as one `mujoco.MjSpec`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from megrasp_core.errors import DescriptionError
from megrasp_core.grippers import check_names, check_tree, read_xml

from .findings import Notes
from .meshes import MeshFinder, MeshStore, missing_message
from .urdf_repairs import (
    SHAPES,
    drop_empty_limits,
    links_below,
    refuse_unknown,
    strip_links,
    take_first,
)
from .xacro_source import expand, is_xacro

LEAST_MASS = 1e-3
LEAST_INERTIA = 1e-7


@dataclass(frozen=True)
class SourceOptions:
    """What the user says about the file.

    Attributes:
        packages: ROS package name -> folder.
        scale: metres in one unit of the model's lengths; None: metres, or found by its size.
        root: link to cut the gripper out at.
        without: links whose shapes are left out.
        xacro: arguments of a xacro file.
    """

    packages: Mapping[str, Path] = field(default_factory=dict)
    scale: float | None = None
    root: str | None = None
    without: Sequence[str] = ()
    xacro: Mapping[str, str] = field(default_factory=dict)


def read_source(path: Path, folder: Path, options: SourceOptions, notes: Notes) -> mujoco.MjSpec:
    """Read a model; its meshes are copied to `folder`/meshes and named there.

    Args:
        path: URDF, xacro or MJCF file.
        folder: where the meshes go.
        options: what the user said.
        notes: what was found and done is written here.

    Raises:
        DescriptionError: no model, or meshes that are not there.
    """
    if not path.is_file():
        raise DescriptionError(f"no model at {path}; expected a URDF, xacro or MJCF file")
    if is_xacro(path):
        root = ElementTree.fromstring(expand(path, options.packages, options.xacro))
    elif options.xacro:
        raise DescriptionError(
            f"--xacro-arg is given, but {path} is no xacro file; leave the option out"
        )
    else:
        root = read_xml(path)
    if root.tag == "mujocoinclude":
        raise DescriptionError(
            f"{path} is an include file, a part of a model; give the model that includes it"
            f"{_includers(path)}"
        )
    store = MeshStore(folder)
    if root.tag == "robot":
        spec = _read_urdf(path, root, options, store, notes)
    else:
        spec = _read_mjcf(path, options, store, notes)
    spec.meshdir = str(store.folder.resolve())
    if store.converted:
        notes.add(f"meshes converted to STL: {', '.join(sorted(set(store.converted)))}")
    return spec


def is_urdf(path: Path) -> bool:
    """Whether a readable model is a URDF, or a xacro file of one, whatever its suffix."""
    return is_xacro(path) or read_xml(path).tag == "robot"


def _includers(path: Path) -> str:
    """Return the names of the models beside a fragment that include it, as text."""
    found = [
        file.name
        for file in sorted(path.parent.glob("*.xml"))
        if file != path
        and re.search(
            rf"<include\s+file\s*=\s*[\"'](\./)?{re.escape(path.name)}[\"']",
            file.read_text(encoding="utf-8", errors="replace"),
        )
    ]
    return f": {', '.join(found)}" if found else ""


def _read_urdf(
    path: Path,
    root: ElementTree.Element,
    options: SourceOptions,
    store: MeshStore,
    notes: Notes,
) -> mujoco.MjSpec:
    check_names(root, path)
    take_first(root, notes)
    check_tree(root, path)
    drop_empty_limits(root, notes)
    names = [link.get("name", "") for link in root.findall("link")]
    refuse_unknown(options.without, names, "--without", path)
    strip_links(root, options.without)
    if options.root is not None:
        strip_links(root, set(names) - links_below(root, options.root, path))
    compiler = root.find("mujoco/compiler")
    meshdir = compiler.get("meshdir", "") if compiler is not None else ""
    finder = MeshFinder(path.parent, options.packages, (path.parent / meshdir,))
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
    compiler_options = {
        "meshdir": str(store.folder.resolve()),
        "strippath": "false",
        "discardvisual": "false",
        "fusestatic": "false",
        "balanceinertia": "true",
        "boundmass": str(LEAST_MASS),
        "boundinertia": str(LEAST_INERTIA),
    }
    element = ElementTree.SubElement(root, "mujoco")
    ElementTree.SubElement(element, "compiler", compiler_options)
    return _parse(path, ElementTree.tostring(root, encoding="unicode"))


def _read_mjcf(
    path: Path, options: SourceOptions, store: MeshStore, notes: Notes
) -> mujoco.MjSpec:
    spec = _parse(path, None)
    _strip_bodies(spec, options, path)
    finder = MeshFinder(path.parent, options.packages, (path.parent / (spec.meshdir or ""),))
    users = {geom.meshname: geom.parent.name for geom in spec.geoms if geom.meshname}
    missing: dict[str, str] = {}
    for mesh in list(spec.meshes):
        if not mesh.file:
            continue
        mesh.name = mesh.name or Path(mesh.file).stem
        if mesh.name not in users and (options.root or options.without):
            spec.delete(mesh)
            continue
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


def _strip_bodies(spec: mujoco.MjSpec, options: SourceOptions, path: Path) -> None:
    """Delete the shapes of the bodies that are left out, and of those that `--root` cuts off."""
    for index, body in enumerate(spec.bodies):
        body.name = body.name or f"link_{index}"
    names = [body.name for body in spec.bodies if body.name != "world"]
    refuse_unknown(options.without, names, "--without", path)
    stripped = [body for body in spec.bodies if body.name in options.without]
    if options.root is not None:
        refuse_unknown([options.root], names, "--root", path)
        kept = {options.root}
        # Parents come before their children.
        for body in spec.bodies:
            if body.name != "world" and body.parent.name in kept:
                kept.add(body.name)
        stripped += [
            b for b in spec.bodies if b.name not in kept and b.name not in options.without
        ]
    if stripped:
        spec.compiler.boundmass = max(spec.compiler.boundmass, LEAST_MASS)
        spec.compiler.boundinertia = max(spec.compiler.boundinertia, LEAST_INERTIA)
    for geom in [geom for body in stripped for geom in body.geoms]:
        spec.delete(geom)


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
