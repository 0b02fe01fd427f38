"""A gripper of the family from a seed: contents of its `gripper.yaml` and its MJCF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import Any

import numpy as np

from .draw import draw_parameters
from .finger import Link, finger_links
from .motion import Kinematics, kinematics
from .palm import palm_parts
from .parameters import FamilyParameters, Placement
from .ranges import CENTRIC, CROSS, SLIDE, TWO_ONE
from .shapes import Part, about_z, add_geoms, add_meshes, numbers, turned

MODEL_FILE = "model.xml"
COLOUR = "0.35 0.37 0.40 1"
# Reflected inertia and damping of a drive: a slide's (kg, Ns/m), a hinge's per squared lever.
SLIDE_INERTIA, SLIDE_DAMPING = 0.4, 150.0
HINGE_INERTIA, HINGE_DAMPING = 1.0, 80.0
# Natural frequency of the drive (rad/s): stiff enough to press at a few millimetres of error.
STIFFNESS_RATE = 150.0
FOLLOWER_ARMATURE, FOLLOWER_DAMPING = 0.001, 0.02
MARGIN = 1e-4


def sample_gripper(seed: int, kind: str | None = None) -> tuple[dict[str, Any], str]:
    """Return the contents of `gripper.yaml` and the text of `model.xml` of a seed.

    The same arguments give the same gripper. kind: one of FAMILY_KINDS, by default drawn with the
    seed. Raises InvalidRequestError for a negative seed or an unknown kind.
    """
    return build_gripper(draw_parameters(seed, kind))


def build_gripper(p: FamilyParameters) -> tuple[dict[str, Any], str]:
    """Return the contents of `gripper.yaml` and the text of `model.xml` of these parameters."""
    k = kinematics(p)
    links = finger_links(p, k)
    places = p.placements()
    root = ET.Element("mujoco", model=name_of(p))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    ET.SubElement(root, "option", integrator="implicitfast", cone="elliptic", impratio="10")
    default = ET.SubElement(root, "default")
    ET.SubElement(default, "geom", rgba=COLOUR)
    ET.SubElement(default, "joint", solreflimit="0.005 1")
    ET.SubElement(default, "equality", solref="0.005 1", solimp="0.95 0.99 0.001")
    asset, world = ET.SubElement(root, "asset"), ET.SubElement(root, "worldbody")
    palm = palm_parts(p, k)
    add_meshes(asset, palm)
    add_meshes(asset, (part for link in _all(links) for part in link.parts))
    base = ET.SubElement(world, "body", name="palm")
    add_geoms(base, palm)
    for index, place in enumerate(places):
        for link in links:
            _add_link(base, p, k, link, f"finger_{index}", place)
    _add_drive(root, p, k, links, len(places))
    ET.indent(root)
    return _description(p, k, links), ET.tostring(root, encoding="unicode") + "\n"


def name_of(p: FamilyParameters) -> str:
    """Name of the gripper: its kind and its seed."""
    return f"{p.kind}_{p.seed:06d}"


def _all(links: tuple[Link, ...]) -> Iterator[Link]:
    for link in links:
        yield link
        yield from _all(link.children)


def _add_link(
    parent: ET.Element,
    p: FamilyParameters,
    k: Kinematics,
    link: Link,
    prefix: str,
    place: Placement | None,
) -> None:
    body = ET.SubElement(parent, "body", name=f"{prefix}_{link.name}")
    origin = Part("", "box", np.array([link.origin], dtype=np.float64))
    if place is not None:
        origin = turned(origin, "", place.angle, place.shift)
        body.set("quat", about_z(place.angle))
    body.set("pos", numbers(origin.points[0]))
    joint = {
        "name": f"{prefix}_{link.name}_joint",
        "type": "hinge" if link.hinge else "slide",
        "axis": numbers(link.axis),
        "range": numbers((k.closed - MARGIN, k.open + MARGIN)),
    }
    inertia, damping = _drive(p, k)
    if link.follows:
        inertia, damping = FOLLOWER_ARMATURE, FOLLOWER_DAMPING
    ET.SubElement(
        body, "joint", joint | {"armature": f"{inertia:.6g}", "damping": f"{damping:.6g}"}
    )
    add_geoms(body, link.parts, f"{prefix}_")
    for child in link.children:
        _add_link(body, p, k, child, prefix, None)


def _drive(p: FamilyParameters, k: Kinematics) -> tuple[float, float]:
    """Armature and damping of a driven joint."""
    if p.motion == SLIDE:
        return SLIDE_INERTIA, SLIDE_DAMPING
    return HINGE_INERTIA * k.lever**2, HINGE_DAMPING * k.lever**2


def _add_drive(
    root: ET.Element, p: FamilyParameters, k: Kinematics, links: tuple[Link, ...], count: int
) -> None:
    """Couple all fingers one to one and drive their mean with one actuator."""
    tendon, equality = ET.SubElement(root, "tendon"), ET.SubElement(root, "equality")
    fixed = ET.SubElement(tendon, "fixed", name="fingers")
    driven = links[0].name
    for index in range(count):
        joint = f"finger_{index}_{driven}_joint"
        ET.SubElement(fixed, "joint", joint=joint, coef=f"{1 / count:.9g}")
        if index:
            _couple(equality, joint, f"finger_0_{driven}_joint")
        for link in _all(links):
            if link.follows:
                _couple(equality, f"finger_{index}_{link.name}_joint", joint)
    inertia, damping = _drive(p, k)
    stiffness = count * inertia * STIFFNESS_RATE**2
    limit = count * p.force * k.lever
    ET.SubElement(
        ET.SubElement(root, "actuator"),
        "position",
        name="fingers",
        tendon="fingers",
        kp=f"{stiffness:.6g}",
        kv=f"{0.5 * count * damping:.6g}",
        ctrlrange=numbers((k.closed, k.open)),
        forcerange=f"{-limit:.6g} {limit:.6g}",
    )


def _couple(equality: ET.Element, joint: str, to: str) -> None:
    ET.SubElement(equality, "joint", name=joint, joint1=joint, joint2=to, polycoef="0 1 0 0 0")


def _description(p: FamilyParameters, k: Kinematics, links: tuple[Link, ...]) -> dict[str, Any]:
    groups: list[list[str]] = [[], []]
    for index, place in enumerate(p.placements()):
        groups[place.group] += [f"finger_{index}_{link.name}" for link in _all(links)]
    joint = f"finger_0_{links[0].name}_joint"
    return {
        "format": 1,
        "name": name_of(p),
        "display_name": f"{p.kind.replace('_', ' ')} {p.seed}, {p.motion}",
        "kind": "parallel" if p.kind == "parallel_slide" else "adaptive",
        "model": MODEL_FILE,
        "mount_from_model": {"xyz": [0, 0, 0], "quat": [0, 0, 0, 1]},
        "tcp": [0, 0, round(k.tcp_depth, 5)],
        "postures": {
            "open": {"joints": {joint: round(k.open, 5)}},
            "closed": {"joints": {joint: round(k.closed, 5)}},
        },
        "actuation": {},
        "max_width": round(p.along_x(k.clear), 5),
        "min_width": round(p.along_x(p.closed_radius), 5),
        "fingers": groups,
        "symmetry": _symmetry(p),
        "licence": "Apache-2.0",
        "source": f"procedural family, kind {p.kind}, seed {p.seed}",
    }


def _symmetry(p: FamilyParameters) -> int:
    """Number of turns about Z that leave the gripper as it is."""
    if p.layout in (CENTRIC, CROSS):
        square = p.palm == "stadium"
        return p.count if not (square and p.layout == CENTRIC) else 1
    return 1 if p.layout == TWO_ONE or p.palm_shift else 2
