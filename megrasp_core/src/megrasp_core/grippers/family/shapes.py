"""Primitive solids of a gripper and their MJCF: boxes, rods, ellipsoids, convex hulls."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class Part:
    """One solid: `shape` is box, cylinder, capsule, ellipsoid or mesh.

    points: centre (1, 3), the two ends (2, 3) of a rod, or vertices (N, 3) of a convex mesh.
    size: half sizes (3,) of box and ellipsoid, the radius (1,) of a rod. angle: turn about Z.
    """

    name: str
    shape: str
    points: NDArray[np.float64]
    size: tuple[float, ...] = ()
    angle: float = 0.0


def box(name: str, low: ArrayLike, high: ArrayLike) -> Part:
    """Return the box between two corners (3,)."""
    a, b = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    return Part(name, "box", ((a + b) / 2)[None], tuple(((b - a) / 2).tolist()))


def cylinder(name: str, start: ArrayLike, end: ArrayLike, radius: float) -> Part:
    """Return a cylinder between the middles (3,) of its ends."""
    return Part(name, "cylinder", np.array([start, end], dtype=np.float64), (radius,))


def capsule(name: str, start: ArrayLike, end: ArrayLike, radius: float) -> Part:
    """Return a capsule about the segment between two points (3,)."""
    return Part(name, "capsule", np.array([start, end], dtype=np.float64), (radius,))


def ellipsoid(name: str, centre: ArrayLike, semi_axes: Sequence[float]) -> Part:
    """Return an ellipsoid with its axes along those of the frame."""
    return Part(name, "ellipsoid", np.array([centre], dtype=np.float64), tuple(semi_axes))


def hull(name: str, points: ArrayLike) -> Part:
    """Return the convex hull of points (N, 3)."""
    return Part(name, "mesh", np.asarray(points, dtype=np.float64))


def prism(name: str, outline: ArrayLike, axis: int, low: float, high: float) -> Part:
    """Return a convex outline (N, 2), in the two axes other than `axis` in order, extruded along
    `axis` from low to high.
    """
    flat = np.asarray(outline, dtype=np.float64)
    ends = [np.insert(flat, axis, level, axis=1) for level in (low, high)]
    return hull(name, np.concatenate(ends))


def turned(part: Part, name: str, angle: float, shift: float) -> Part:
    """Return the part moved by `shift` along Y and then turned about Z."""
    c, s = math.cos(angle), math.sin(angle)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    points = (part.points + np.array([0.0, shift, 0.0])) @ rotation.T
    return Part(name, part.shape, points, part.size, part.angle + angle)


def add_geoms(body: ET.Element, parts: Iterable[Part], prefix: str = "") -> None:
    """Add the geoms to a body; meshes refer to the asset of the part's own name."""
    for part in parts:
        attributes = {"name": prefix + part.name, "type": part.shape}
        if part.shape == "mesh":
            attributes["mesh"] = part.name
        elif part.shape in ("cylinder", "capsule"):
            attributes |= {"size": numbers(part.size), "fromto": numbers(part.points.ravel())}
        else:
            attributes |= {"size": numbers(part.size), "pos": numbers(part.points[0])}
            if part.angle:
                attributes["quat"] = about_z(part.angle)
        ET.SubElement(body, "geom", attributes)


def add_meshes(asset: ET.Element, parts: Iterable[Part]) -> None:
    """Add the mesh assets that the parts need."""
    for part in parts:
        if part.shape == "mesh":
            ET.SubElement(asset, "mesh", name=part.name, vertex=numbers(part.points.ravel()))


def numbers(values: Iterable[float]) -> str:
    """Return numbers as MJCF writes them, to a hundredth of a millimetre or milliradian."""
    return " ".join(f"{round(float(value), 5) + 0.0:g}" for value in values)


def about_z(angle: float) -> str:
    """Return MJCF's quaternion (w, x, y, z) of a turn about Z."""
    return f"{math.cos(angle / 2):.9g} 0 0 {math.sin(angle / 2):.9g}"
