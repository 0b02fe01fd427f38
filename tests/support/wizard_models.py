"""Small grippers for the wizard's tests, as a stranger would bring them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import trimesh

PALM = (0.08, 0.04, 0.06)
FINGER = (0.01, 0.02, 0.06)


def mjcf(body: str, extra: str = "") -> str:
    """An MJCF model in radians."""
    compiler = '<compiler angle="radian" autolimits="true"/>'
    return f"<mujoco>{compiler}<worldbody>{body}</worldbody>{extra}</mujoco>"


def jaws(attributes: str = "", more: str = "") -> str:
    """Body of a parallel jaw gripper: 66 mm of travel along x, fingers 60 mm along z."""
    fingers = "".join(
        f'<body name="finger_{side}" pos="{x} 0 0.03">'
        f'<joint name="slide_{side}" type="slide" axis="1 0 0" range="{travel}"/>'
        '<geom type="box" size="0.005 0.01 0.03" pos="0 0 0.03"/></body>'
        for side, x, travel in (("a", -0.04, "0 0.033"), ("b", 0.04, "-0.033 0"))
    )
    palm = '<geom type="box" size="0.04 0.03 0.03"/>'
    return f'<body name="palm" {attributes}>{more}{palm}{fingers}</body>'


def around_a_centre(count: int) -> str:
    """MJCF of fingers that turn inwards around a centre."""
    fingers = "".join(
        f'<body name="turn_{k}" euler="0 0 {6.283185307 * k / count}">'
        f'<body name="finger_{k}" pos="0.05 0 0.03">'
        f'<joint name="hinge_{k}" axis="0 -1 0" range="-0.3 0.9"/>'
        '<geom type="box" size="0.006 0.008 0.03" pos="0 0 0.03"/></body></body>'
        for k in range(count)
    )
    return mjcf(f'<body name="palm"><geom type="cylinder" size="0.04 0.03"/>{fingers}</body>')


def arm(body: str, joints: int = 6) -> str:
    """MJCF of an arm that carries a gripper's body."""
    base = '<geom type="cylinder" size="0.06 0.1"/>'
    return mjcf(f'<body name="foot">{base}{_links(body, joints)}</body>')


def two_arms() -> str:
    """MJCF of a robot with a gripper on each of two arms."""
    right = _links(jaws(), 5)
    left = right
    for name in ("arm_", "turn_", "finger_", "slide_", "palm"):
        left = left.replace(f'"{name}', f'"left_{name}')
    left = left.replace('pos="0 0 0.2"', 'pos="0 0.3 0.2"', 1)
    return mjcf(f'<body name="torso"><geom type="box" size="0.1 0.2 0.3"/>{left}{right}</body>')


def _links(body: str, joints: int) -> str:
    links = "".join(
        f'<body name="arm_{k}" pos="0 0 0.2">'
        f'<joint name="turn_{k}" axis="{"0 0 1" if k % 2 else "0 1 0"}" range="-3 3"/>'
        '<geom type="capsule" size="0.04 0.06" pos="0 0 0.1"/>'
        for k in range(joints)
    )
    return links + body + "</body>" * joints


SINGLE = mjcf(
    """<body name="base"><geom type="box" size="0.03 0.02 0.03"/>
    <geom type="box" size="0.004 0.01 0.04" pos="-0.02 0 0.07"/>
    <body name="jaw" pos="0.025 0 0.03"><joint name="hinge" axis="0 -1 0" range="-0.2 1.5"/>
    <geom type="box" size="0.004 0.01 0.04" pos="0 0 0.04"/></body></body>"""
)


def couplings(count: int) -> str:
    """Equalities that bend every outer hinge q<k> by 0.7 of p<k>."""
    rows = "".join(
        f'<joint joint1="q{k}" joint2="p{k}" polycoef="0 0.7 0 0 0"/>' for k in range(count)
    )
    return f"<equality>{rows}</equality>"


INERTIAL = (
    '<inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" '
    'iyz="0"/></inertial>'
)


def single_jaw(low: float, high: float) -> str:
    """URDF of a jaw on the hinge `turn` (rad) beside a fixed one on the palm, 90 mm long."""
    fixed = shape("0.05 0.03 0.06", "0 0 0.03") + shape("0.008 0.025 0.09", "-0.02 0 0.1")
    jaw = shape("0.008 0.025 0.09", "0 0 0.045")
    return (
        f'<robot name="jaw"><link name="palm">{INERTIAL}{fixed}</link>'
        f'<link name="jaw">{INERTIAL}{jaw}</link>'
        '<joint name="turn" type="revolute"><parent link="palm"/><child link="jaw"/>'
        '<origin xyz="-0.004 0 0.055"/><axis xyz="0 1 0"/>'
        f'<limit lower="{low}" upper="{high}" effort="10" velocity="1"/></joint></robot>'
    )


def slides(stroke: float) -> str:
    """URDF of two fingers that touch at 0 and open by `stroke` (m) each along x."""
    out = [f'<robot name="jaws"><link name="palm">{shape("0.12 0.05 0.06", "0 0 0.03")}</link>']
    for name, link, sign in (("left", "fl", -1), ("right", "fr", 1)):
        finger = shape("0.01 0.02 0.06", "0 0 0.03")
        mimic = '<mimic joint="left"/>' if sign > 0 else ""
        out.append(
            f'<link name="{link}">{INERTIAL}{finger}</link><joint name="{name}" type="prismatic">'
            f'<parent link="palm"/><child link="{link}"/><origin xyz="{0.005 * sign} 0 0.06"/>'
            f'<axis xyz="{sign} 0 0"/><limit lower="0" upper="{stroke}" effort="10" velocity="1"/>'
            f"{mimic}</joint>"
        )
    return "".join([*out, "</robot>"])


def shape(size: str, centre: str) -> str:
    """Visual and collision of a box in a URDF."""
    box = f'<origin xyz="{centre}"/><geometry><box size="{size}"/></geometry>'
    return f"<visual>{box}</visual><collision>{box}</collision>"


def chain_fingers(places: Sequence[tuple[float, float, float]], springs: bool = False) -> str:
    """Body of a palm with fingers of two hinges, p<k> and q<k>, that bend towards +x.

    Args:
        places: x, y (m) and turn about z (rad) of each.
        springs: hold the outer hinges by springs that rest at 0.1 rad.
    """
    spring = 'stiffness="0.3" springref="0.1" damping="0.05"' if springs else ""
    fingers = ""
    for k, (x, y, turn) in enumerate(places):
        outer = f'<joint name="q{k}" axis="0 1 0" range="0 1.5" armature="0.0005" {spring}/>'
        fingers += (
            f'<body name="f{k}" pos="{x} {y} 0.05" euler="0 0 {turn}">'
            f'<joint name="p{k}" axis="0 1 0" range="-0.4 1.4" armature="0.001"/>'
            '<geom type="capsule" fromto="0 0 0 0 0 0.045" size="0.008"/>'
            f'<body name="d{k}" pos="0 0 0.045">{outer}'
            '<geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.008"/></body></body>'
        )
    palm = '<geom type="box" size="0.045 0.04 0.025" pos="0 0 0.025"/>'
    return f'<body name="palm">{palm}{fingers}</body>'


def urdf(folder: Path, prefix: str = "meshes/", mesh_unit: float = 1.0, unit: float = 1.0) -> Path:
    """Write a URDF with a mimic joint and its STL meshes; return the URDF.

    Args:
        folder: gets gripper.urdf and meshes/.
        prefix: what stands before the meshes' names in the URDF.
        mesh_unit: units of the meshes in a metre.
        unit: units of all other lengths in a metre.
    """
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    for name, size in (("palm", PALM), ("finger", FINGER)):
        box = trimesh.creation.box([mesh_unit * edge for edge in size])
        box.export(folder / "meshes" / f"{name}.stl")
    mimic = '<mimic joint="left" multiplier="-1"/>'
    text = "".join(
        [
            '<robot name="jaws">',
            _link("palm", "palm", prefix),
            _link("left_finger", "finger", prefix),
            _link("right_finger", "finger", prefix),
            _slide("left", -0.035 * unit, 0.0, 0.03 * unit, 0.06 * unit, ""),
            _slide("right", 0.035 * unit, -0.03 * unit, 0.0, 0.06 * unit, mimic),
            "</robot>",
        ]
    )
    (folder / "gripper.urdf").write_text(text)
    return folder / "gripper.urdf"


def _link(name: str, mesh: str, prefix: str) -> str:
    shape = f'<geometry><mesh filename="{prefix}{mesh}.stl"/></geometry>'
    return f'<link name="{name}"><visual>{shape}</visual><collision>{shape}</collision></link>'


def _slide(name: str, x: float, low: float, high: float, z: float, mimic: str) -> str:
    return (
        f'<joint name="{name}" type="prismatic"><parent link="palm"/><child link="{name}_finger"/>'
        f'<origin xyz="{x} 0 {z}"/><axis xyz="1 0 0"/>'
        f'<limit lower="{low}" upper="{high}" effort="10" velocity="1"/>{mimic}</joint>'
    )
