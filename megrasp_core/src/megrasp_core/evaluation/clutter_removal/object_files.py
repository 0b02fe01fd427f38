"""Objects of the rounds: a folder of URDF files or of this project's objects, or procedural ones;
of them those that fit a gripper.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.errors import InvalidRequestError, ObjectError
from megrasp_core.evaluation.object_pool import load_pool
from megrasp_core.grippers import Gripper
from megrasp_core.meshes import Mesh, joined
from megrasp_core.objects import DEFAULT_DENSITY, ObjectModel, mass_properties
from megrasp_core.objects.solids import convex_piece

FILLED = 0.9
"""Of a gripper's opening an object may take up this share with its least width."""
LONGEST = 0.20
"""Edge (m) over which an object is left out: it would fill the workspace."""


def clutter_pool(folder: Path | None) -> list[ObjectModel]:
    """All objects below a folder: URDF files where there are any, else object folders; without a
    folder the procedural objects of the evaluations.

    Raises:
        ObjectError: there are none, or one cannot be read.
    """
    files = [] if folder is None else sorted(folder.rglob("*.urdf"))
    return [read_urdf(file) for file in files] if files else load_pool(folder)


def fitting(pool: Sequence[ObjectModel], gripper: Gripper) -> list[ObjectModel]:
    """Those whose least edge goes between the fingers; for hands, whose opening is not known, all
    that are not too long.

    Raises:
        InvalidRequestError: none is.
    """
    widest = gripper.description.max_width or np.inf
    found = [
        model
        for model in pool
        if model.extents.min() <= FILLED * widest and model.extents.max() <= LONGEST
    ]
    if not found:
        raise InvalidRequestError(
            f"none of the {len(pool)} objects fits gripper {gripper.name!r}; expected an edge of "
            f"at most {FILLED * widest:.3f} m, and none over {LONGEST} m. Give another --objects "
            "folder."
        )
    return found


def read_urdf(path: Path) -> ObjectModel:
    """The object of a URDF file with one link; its frame keeps the link's axes, with the origin at
    the centre of mass.

    Each part of a collision mesh file (a group, or what hangs together) counts as its convex hull,
    as in PyBullet. The mass is the file's, the inertia that of the pieces at equal density.

    Raises:
        ObjectError: the file or a mesh of it cannot be read, or it has several links.
    """
    try:
        links = ElementTree.parse(path).getroot().findall("link")
    except (OSError, ElementTree.ParseError) as error:
        raise ObjectError(f"{path} is not readable XML ({error}); expected a URDF.") from None
    if len(links) != 1:
        raise ObjectError(f"{path} has {len(links)} links; expected the one of a rigid object.")
    link = links[0]
    solid = _shapes(path, link, "collision")
    seen = _shapes(path, link, "visual") or solid
    if not solid:
        raise ObjectError(f"{path} has no collision geometry; expected meshes or primitives.")
    pieces = tuple(convex_piece(part.vertices) for mesh in solid for part in _parts(mesh))
    properties = mass_properties(pieces)
    mass = link.find("inertial/mass")
    kilograms = 0.0 if mass is None else float(mass.get("value", 0.0))
    if kilograms <= 0.0:
        kilograms = DEFAULT_DENSITY * properties.volume
    visual = joined(Mesh(np.asarray(m.vertices), np.asarray(m.faces)) for m in seen)
    return ObjectModel(
        name=path.stem,
        vertices=visual.vertices - properties.centre,
        faces=np.asarray(visual.faces, np.int32),
        pieces=tuple(type(p)(p.vertices - properties.centre, p.faces) for p in pieces),
        mass=kilograms,
        inertia=properties.inertia * (kilograms / properties.volume),
        category=path.parent.name,
    )


def _parts(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    parts = mesh.split(only_watertight=False)
    # What is flat or a few stray triangles has no hull.
    solid = [part for part in parts if len(part.vertices) > 3 and _spread(part) > 1e-4]
    return solid or [mesh]


def _spread(mesh: trimesh.Trimesh) -> float:
    return float(np.linalg.svd(mesh.vertices - mesh.vertices.mean(axis=0))[1][-1])


def _shapes(path: Path, link: ElementTree.Element, kind: str) -> list[trimesh.Trimesh]:
    found = []
    for element in link.findall(kind):
        geometry = element.find("geometry")
        shape = None if geometry is None or not len(geometry) else geometry[0]
        if shape is None:
            raise ObjectError(f"{path}: a {kind} has no geometry; expected a mesh or primitive.")
        try:
            mesh = _mesh(path, shape)
        except ObjectError:
            raise
        except Exception as error:
            # The loader raises whatever a damaged file makes it stumble over.
            raise ObjectError(
                f"{path}: its {kind} {shape.tag} {shape.attrib} cannot be read ({error}); "
                "expected a mesh file beside the URDF, or box, sphere or cylinder."
            ) from error
        found.append(mesh.apply_transform(_origin(element.find("origin"))))
    return found


def _mesh(path: Path, shape: ElementTree.Element) -> trimesh.Trimesh:
    if shape.tag == "box":
        return trimesh.creation.box(extents=_numbers(shape.attrib["size"]))
    if shape.tag == "sphere":
        return trimesh.creation.icosphere(radius=float(shape.attrib["radius"]))
    if shape.tag == "cylinder":
        radius, length = float(shape.attrib["radius"]), float(shape.attrib["length"])
        return trimesh.creation.cylinder(radius=radius, height=length)
    if shape.tag != "mesh":
        raise ObjectError(
            f"{path} has the shape {shape.tag}; expected mesh, box, sphere or cylinder."
        )
    file = shape.attrib["filename"].removeprefix("package://").removeprefix("file://")
    mesh = trimesh.load_mesh(path.parent / file, process=False)
    return mesh.apply_scale(_numbers(shape.get("scale", "1 1 1")))


def _origin(element: ElementTree.Element | None) -> NDArray[np.float64]:
    pose = np.eye(4)
    if element is not None:
        pose[:3, 3] = _numbers(element.get("xyz", "0 0 0"))
        angles = _numbers(element.get("rpy", "0 0 0"))
        pose[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
    return pose


def _numbers(text: str) -> NDArray[np.float64]:
    return np.array([float(part) for part in text.split()])
