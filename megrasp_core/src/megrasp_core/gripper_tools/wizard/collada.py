"""Triangles of COLLADA (.dae) files, which ROS models use a lot and MuJoCo does not read.

Geometry only: triangles, polygon lists and fans with the nodes' transforms and the file's unit.
The up axis is ignored, as RViz does.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Soup = tuple[NDArray[np.float64], NDArray[np.int64]]


def read_collada(file: Path) -> trimesh.Trimesh:
    """Return the whole scene as one mesh in metres. Raises ValueError where nothing is found."""
    root = ElementTree.parse(file).getroot()
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    by_id = {element.get("id"): element for element in root.iter() if element.get("id")}
    unit = root.find("asset/unit")
    scale = float(unit.get("meter", "1")) if unit is not None else 1.0
    meshes = {
        f"#{geometry.get('id')}": _geometry(geometry, by_id) for geometry in root.iter("geometry")
    }
    out: list[Soup] = []
    for scene in root.iter("visual_scene"):
        for node in scene.findall("node"):
            _collect(node, np.eye(4), meshes, by_id, out)
    if not out:
        out = [mesh for mesh in meshes.values() if len(mesh[1])]
    if not out:
        raise ValueError("it holds no triangles")
    parts = [trimesh.Trimesh(scale * vertices, faces, process=False) for vertices, faces in out]
    return trimesh.util.concatenate(parts)  # type: ignore[return-value]


def _collect(
    node: ElementTree.Element,
    parent: NDArray[np.float64],
    meshes: dict[str, Soup],
    by_id: dict[str | None, ElementTree.Element],
    out: list[Soup],
) -> None:
    pose = parent @ _transform(node)
    for instance in node.findall("instance_geometry"):
        vertices, faces = meshes.get(instance.get("url", ""), (np.zeros((0, 3)), np.zeros((0, 3))))
        if len(faces):
            out.append((vertices @ pose[:3, :3].T + pose[:3, 3], faces.astype(np.int64)))
    for child in node.findall("node"):
        _collect(child, pose, meshes, by_id, out)
    for instance in node.findall("instance_node"):
        other = by_id.get(instance.get("url", "").removeprefix("#"))
        if other is not None:
            _collect(other, pose, meshes, by_id, out)


def _transform(node: ElementTree.Element) -> NDArray[np.float64]:
    pose = np.eye(4)
    for element in node:
        values = _numbers(element) if element.tag in _STEPS else np.zeros(0)
        step = np.eye(4)
        if element.tag == "matrix":
            step = values.reshape(4, 4)
        elif element.tag == "translate":
            step[:3, 3] = values
        elif element.tag == "rotate":
            turn = Rotation.from_rotvec(np.radians(values[3]) * values[:3])
            step[:3, :3] = turn.as_matrix()
        elif element.tag == "scale":
            step[:3, :3] = np.diag(values)
        pose = pose @ step
    return pose


_STEPS = ("matrix", "translate", "rotate", "scale")


def _geometry(geometry: ElementTree.Element, by_id: dict[str | None, ElementTree.Element]) -> Soup:
    vertices, faces = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)]
    count = 0
    for kind in ("triangles", "polylist", "polygons"):
        for block in geometry.iter(kind):
            found = _block(block, by_id)
            if found is None:
                continue
            vertices.append(found[0])
            faces.append(found[1] + count)
            count += len(found[0])
    return np.concatenate(vertices), np.concatenate(faces)


def _block(
    block: ElementTree.Element, by_id: dict[str | None, ElementTree.Element]
) -> Soup | None:
    inputs = block.findall("input")
    stride = 1 + max((int(i.get("offset", "0")) for i in inputs), default=0)
    first = next((i for i in inputs if i.get("semantic") == "VERTEX"), None)
    holder = by_id.get(first.get("source", "").removeprefix("#")) if first is not None else None
    position = holder.find("input[@semantic='POSITION']") if holder is not None else None
    source = by_id.get(position.get("source", "")[1:]) if position is not None else None
    numbers = source.find("float_array") if source is not None else None
    if first is None or numbers is None:
        return None
    vertices = _numbers(numbers).reshape(-1, 3)
    corners = [_numbers(p).astype(np.int64)[int(first.get("offset", "0")) :: stride]
               for p in block.findall("p")]  # fmt: skip
    sizes = block.find("vcount")
    if block.tag == "triangles":
        return vertices, np.concatenate(corners).reshape(-1, 3)
    if sizes is not None:
        ends = np.cumsum(_numbers(sizes).astype(np.int64))[:-1]
        corners = np.split(corners[0], ends)
    fans = [
        np.stack([np.full(len(c) - 2, c[0]), c[1:-1], c[2:]], axis=1)
        for c in corners
        if len(c) > 2
    ]
    return vertices, np.concatenate(fans) if fans else np.zeros((0, 3), np.int64)


def _numbers(element: ElementTree.Element) -> NDArray[np.float64]:
    return np.array((element.text or "").split(), float)
