"""What ROS parsers tolerate in a URDF and MuJoCo does not, and what is no part of the gripper."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from xml.etree import ElementTree

from megrasp_core.errors import DescriptionError

from .findings import Notes

ONCE = {
    "joint": (
        "origin", "parent", "child", "axis", "limit", "dynamics", "mimic", "calibration",
        "safety_controller",
    ),
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry", "material"),
    "collision": ("origin", "geometry"),
    "geometry": ("box", "cylinder", "sphere", "mesh", "capsule"),
}  # fmt: skip
"""Element -> those that it holds once."""

LIMITED = ("revolute", "prismatic")
SHAPES = ("visual", "collision")


def take_first(root: ElementTree.Element, notes: Notes) -> None:
    """Delete all but the first of what an element holds once, as ROS parsers do, in place."""
    for outer in ("joint", "link"):
        for item in root.findall(outer):
            name = item.get("name", "?")
            for element in [item, *item.iter()]:
                for kind in ONCE.get(element.tag, ()):
                    found = element.findall(kind)
                    for extra in found[1:]:
                        element.remove(extra)
                    if len(found) > 1:
                        where = "" if element is item else f" in a <{element.tag}>"
                        notes.add(
                            f"{outer} '{name}' has {len(found)} <{kind}>{where}; the first is "
                            "taken"
                        )


def drop_empty_limits(root: ElementTree.Element, notes: Notes) -> None:
    """Delete limits from 0 to 0, with which exporters say that they know none, in place."""
    dropped = []
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        if joint.get("type") not in LIMITED or limit is None:
            continue
        if _number(limit, "lower") == 0.0 and _number(limit, "upper") == 0.0:
            joint.remove(limit)
            dropped.append(joint.get("name", "?"))
    if dropped:
        notes.add(f"limits 0 to 0 taken as none: {', '.join(dropped)}")


def links_below(root: ElementTree.Element, link: str, path: Path) -> set[str]:
    """Return a link and all that hang from it. Raises DescriptionError where there is no such
    link.
    """
    refuse_unknown([link], [item.get("name", "") for item in root.findall("link")], "--root", path)
    children: dict[str, list[str]] = {}
    for joint in root.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            children.setdefault(parent.get("link", ""), []).append(child.get("link", ""))
    out: set[str] = set()
    left = [link]
    while left:
        name = left.pop()
        if name not in out:
            out.add(name)
            left += children.get(name, [])
    return out


def strip_links(root: ElementTree.Element, names: Collection[str]) -> None:
    """Delete the shapes of some links in place; their frames stay."""
    for link in root.findall("link"):
        if link.get("name", "") in names:
            for shape in [item for kind in SHAPES for item in link.findall(kind)]:
                link.remove(shape)


def refuse_unknown(given: Sequence[str], names: Sequence[str], option: str, path: Path) -> None:
    """Raise DescriptionError for a link that the model does not have."""
    for name in given:
        if name not in names:
            raise DescriptionError(
                f"{option} names the link '{name}', which {path} does not have; valid links: "
                f"{', '.join(names)}"
            )


def _number(element: ElementTree.Element, name: str) -> float:
    try:
        return float(element.get(name, "0"))
    except ValueError:
        return float("nan")
