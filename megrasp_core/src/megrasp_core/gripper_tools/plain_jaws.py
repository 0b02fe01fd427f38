"""Jaws as strangers draw them, made by code with known axes and TCP: what the wizard is scored on
beside the procedural family, which is always drawn the same way.

Four kinds: a single jaw on a hinge against a fixed one, two angular jaws, a vise (a single jaw on
a slide), and jaws whose limits say nothing (a full turn, none, 0 to 0, metres). Every other four
lie turned in their file; names tell nothing.

The TCP lies in the middle of the pads where there are any, else BEHIND behind the tips of plain
jaws; where jaws turn, half-way between its places open and closed, but no higher than the open
tips reach. Jaws that could turn farther are used up to USED from the closed posture.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

__all__ = ["JAW_KINDS", "PlainJaw", "plain_jaw", "plain_jaws", "write_plain_jaw"]

STREAM = 0x6A61
TURN = 2.0 * math.pi
USED = 1.0
"""Jaws open so far (rad): pads that turn farther no longer look at each other."""

BEHIND, MOST_BEHIND = 0.42, 0.03
"""The TCP of plain jaws lies behind their tips by this share of their length, at most so far
(m)."""

PAD = 0.003
"""Thickness (m) of pads."""

ANY_WAY = 0.3
"""Share of the turned models that lie along no axis of their file."""

Size = tuple[float, float, float]
Bounds = tuple[float, float] | None
Parts = tuple[list[str], list[str], Size]
"""Links, joints, TCP (m) with the closing axis along X and the approach along Z."""


@dataclass(frozen=True)
class PlainJaw:
    """A model as the text of a URDF, and what is known about it, in the model's frame.

    Attributes:
        name: kind and number.
        kind: one of JAW_KINDS.
        urdf: the file's text.
        closing: unit vector (3,), sign free.
        approach: unit vector (3,).
        tcp: point (3,), metres.
    """

    name: str
    kind: str
    urdf: str
    closing: NDArray[np.float64]
    approach: NDArray[np.float64]
    tcp: NDArray[np.float64]

    def facts(self) -> Mapping[str, Any]:
        """Return the facts as the wizard's score takes them."""
        return {
            "closing": self.closing.tolist(),
            "approach": self.approach.tolist(),
            "tcp": self.tcp.tolist(),
            "hand": False,
        }


def plain_jaws(count: int, seed: int) -> list[PlainJaw]:
    """Return `count` models, the kinds in turn; the same seed gives the same ones."""
    kinds = list(JAW_KINDS)
    return [plain_jaw(kinds[index % len(kinds)], index, seed) for index in range(count)]


def plain_jaw(kind: str, number: int, seed: int) -> PlainJaw:
    """Return one model of a kind. Raises KeyError for an unknown kind."""
    rng = np.random.default_rng([STREAM, seed, number])
    links, joints, tcp = JAW_KINDS[kind](rng)
    turn, place = Rotation.identity(), np.zeros(3)
    if number // len(JAW_KINDS) % 2:
        turn = Rotation.from_euler("xyz", rng.integers(0, 4, 3) * 90.0, degrees=True)
        if rng.random() < ANY_WAY:
            turn = Rotation.from_quat(rng.normal(size=4))
        place = rng.uniform(-0.05, 0.05, 3)
    mount = (
        '<link name="root"/><joint name="mount" type="fixed"><parent link="root"/>'
        f'<child link="a"/><origin xyz="{_text(place)}" rpy="{_text(_roll_pitch_yaw(turn))}"/>'
        "</joint>"
    )
    return PlainJaw(
        name=f"{kind}_{number:02d}",
        kind=kind,
        urdf=f'<robot name="tool">{mount}{"".join(links)}{"".join(joints)}</robot>\n',
        closing=turn.apply([1.0, 0.0, 0.0]),
        approach=turn.apply([0.0, 0.0, 1.0]),
        tcp=turn.apply(tcp) + place,
    )


def write_plain_jaw(jaw: PlainJaw, folder: Path) -> Path:
    """Write a model to `folder`/model.urdf; return the file."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "model.urdf"
    file.write_text(jaw.urdf, encoding="utf-8")
    return file


def _single_hinge(rng: np.random.Generator) -> Parts:
    """A jaw on a hinge beside a fixed one; the limits may let it turn far past its use."""
    length, width, thick = _jaw_size(rng)
    palm, gap = rng.uniform(0.03, 0.06), rng.uniform(0.004, 0.012)
    sign = float(rng.choice([-1.0, 1.0]))
    face = -0.016
    hinge = face + gap + thick / 2.0
    base = _box((rng.uniform(0.05, 0.08), width + 0.01, palm), (0.0, 0.0, palm / 2.0))
    fixed = _box((thick, width, length), (sign * (face - thick / 2.0), 0.0, palm + length / 2.0))
    jaw = _box((thick, width, length), (0.0, 0.0, length / 2.0))
    wide = float(rng.choice([0.8, 1.2, 1.75, 2.4, math.pi]))
    bounds = (-0.2, wide) if sign > 0.0 else (-wide, 0.2)
    joint = _joint("revolute", "b", (sign * hinge, 0.0, palm), (0.0, 1.0, 0.0), bounds)
    # The fixed jaw says how deep; beside it the TCP lies half-way to the jaw that is half open.
    up = length - _behind(length)
    middle = face + (gap + up * math.sin(min(wide, USED) / 2.0)) / 2.0
    return [_link("a", base + fixed), _link("b", jaw)], [joint], (sign * middle, 0.0, palm + up)


def _vise(rng: np.random.Generator) -> Parts:
    """A jaw on a slide against a fixed one, both standing on a rail."""
    length, width, thick = (
        rng.uniform(0.03, 0.08),
        rng.uniform(0.015, 0.04),
        rng.uniform(0.008, 0.015),
    )
    rail, opening = rng.uniform(0.02, 0.05), rng.uniform(0.03, 0.09)
    above = float(rng.choice([0.0, 0.0005, 0.002]))
    sign = float(rng.choice([-1.0, 1.0]))
    base = _box((opening + 0.06, width + 0.01, rail), (0.0, 0.0, rail / 2.0))
    outside = -sign * (opening + thick) / 2.0
    fixed = _box((thick, width, length), (outside, 0.0, rail + length / 2.0))
    jaw = _box((thick, width, length), (sign * thick / 2.0, 0.0, length / 2.0))
    behind = _behind(length)
    if rng.random() < 0.5:
        pad = rng.uniform(0.35, 0.6) * length
        behind = pad / 2.0
        size, inside = (PAD, width, pad), sign * (opening - PAD) / 2.0
        fixed += _box(size, (-inside, 0.0, rail + length - behind))
        jaw += _box(size, (-sign * PAD / 2.0, 0.0, length - behind))
    joint = _joint(
        "prismatic",
        "b",
        (sign * opening / 2.0, 0.0, rail + above),
        (-sign, 0.0, 0.0),
        (0.0, opening * float(rng.choice([0.95, 1.0, 1.3]))),
    )
    tcp = (0.0, 0.0, rail + length - behind)
    return [_link("a", base + fixed), _link("b", jaw)], [joint], tcp


def _angular(rng: np.random.Generator) -> Parts:
    """Two jaws on hinges, coupled or not, that open up to right angles."""
    return _two_hinges(rng, (-0.12, float(rng.choice([0.5, 0.8, 1.2, 1.57]))))


def _no_limits(rng: np.random.Generator) -> Parts:
    """Jaws whose limits nobody set: hinges of a turn or none, slides of none or of metres."""
    hinges: list[Bounds] = [(-math.pi, math.pi), (-TURN, TURN), (0.0, 0.0), None]
    slides: list[Bounds] = [(0.0, 0.0), (-2.0, 2.0)]
    choice = int(rng.integers(len(hinges) + len(slides)))
    if choice < len(hinges):
        return _two_hinges(rng, hinges[choice])
    length, width, thick = _jaw_size(rng)
    palm, gap = rng.uniform(0.04, 0.08), rng.uniform(0.0, 0.004)
    links = [_link("a", _box((0.12, 0.05, palm), (0.0, 0.0, palm / 2.0)))]
    joints = []
    for name, sign in (("b", -1.0), ("c", 1.0)):
        links.append(_link(name, _box((thick, width, length), (0.0, 0.0, length / 2.0))))
        place = (sign * (gap + thick) / 2.0, 0.0, palm + 0.001)
        bounds = slides[choice - len(hinges)]
        joints.append(_joint("prismatic", name, place, (sign, 0.0, 0.0), bounds))
    return links, joints, (0.0, 0.0, palm + 0.001 + length - _behind(length))


def _two_hinges(rng: np.random.Generator, bounds: Bounds) -> Parts:
    length, width, thick = _jaw_size(rng)
    palm = rng.uniform(0.03, 0.06)
    padded, coupled = rng.random() < 0.5, rng.random() < 0.5
    pad = rng.uniform(0.25, 0.45) * length
    half = rng.uniform(0.0005, 0.004) + PAD * padded
    behind = pad / 2.0 if padded else _behind(length)
    links = [_link("a", _box((0.06, width + 0.012, palm), (0.0, 0.0, palm / 2.0)))]
    joints = []
    for name, sign in (("b", -1.0), ("c", 1.0)):
        shape = _box((thick, width, length), (sign * thick / 2.0, 0.0, length / 2.0))
        if padded:
            shape += _box((PAD, width, pad), (-sign * PAD / 2.0, 0.0, length - behind))
        links.append(_link(name, shape))
        mimic = '<mimic joint="turn_b"/>' if coupled and name == "c" else ""
        place = (sign * half, 0.0, palm + 0.002)
        kind = "continuous" if bounds is None else "revolute"
        joints.append(_joint(kind, name, place, (0.0, sign, 0.0), bounds, mimic))
    limited = bounds is not None and bounds[1] > 0.0
    opened = min(bounds[1], USED) if bounds is not None and limited else USED
    held = (length - behind) * (1.0 + math.cos(opened)) / 2.0
    level = palm + 0.002 + min(held, length * math.cos(opened))
    return links, joints, (0.0, 0.0, level)


JAW_KINDS: dict[str, Callable[[np.random.Generator], Parts]] = {
    "single_hinge": _single_hinge,
    "vise": _vise,
    "angular": _angular,
    "no_limits": _no_limits,
}
"""Kind -> what draws one."""


def _jaw_size(rng: np.random.Generator) -> tuple[float, float, float]:
    """Return length, width and thickness of a jaw (m)."""
    return rng.uniform(0.04, 0.1), rng.uniform(0.015, 0.03), rng.uniform(0.006, 0.01)


def _behind(length: float) -> float:
    return min(BEHIND * length, MOST_BEHIND)


def _link(name: str, shapes: str) -> str:
    inertial = (
        '<inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" '
        'iyz="0"/></inertial>'
    )
    return f'<link name="{name}">{inertial}{shapes}</link>'


def _box(size: Size, centre: Size) -> str:
    geometry = f'<origin xyz="{_text(centre)}"/><geometry><box size="{_text(size)}"/></geometry>'
    return f"<visual>{geometry}</visual><collision>{geometry}</collision>"


def _joint(kind: str, child: str, place: Size, axis: Size, bounds: Bounds, more: str = "") -> str:
    limit = ""
    if bounds is not None:
        limit = (
            f'<limit lower="{bounds[0]:.5g}" upper="{bounds[1]:.5g}" effort="20" velocity="1"/>'
        )
    return (
        f'<joint name="turn_{child}" type="{kind}"><parent link="a"/><child link="{child}"/>'
        f'<origin xyz="{_text(place)}"/><axis xyz="{_text(axis)}"/>{limit}{more}</joint>'
    )


def _roll_pitch_yaw(turn: Rotation) -> NDArray[np.float64]:
    with warnings.catch_warnings():
        # At a right pitch roll and yaw are not unique; any pair serves.
        warnings.simplefilter("ignore", UserWarning)
        return turn.as_euler("xyz")


def _text(values: Size | NDArray[np.float64]) -> str:
    return " ".join(f"{float(value):.6g}" for value in values)
