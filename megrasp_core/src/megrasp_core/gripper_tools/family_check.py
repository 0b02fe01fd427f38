"""Grippers of the procedural family put to the test: loading, closing, clouds, holding.

An object suits a gripper when it fills SHARE of its travel along the closing axis and lies clear
of the palm: a box, its edges along the gripper's axes and as deep as the fingers stand apart, or
an upright cylinder, both centred at the TCP. A gripper holds when it holds one of the two in the
free-space trial.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from megrasp_core.drawing.contact_sheet import contact_sheet
from megrasp_core.drawing.grasp_picture import draw_gripper
from megrasp_core.errors import DescriptionError
from megrasp_core.evaluation.statistics import wilson
from megrasp_core.grippers import NEAR_TCP, Gripper, load_gripper
from megrasp_core.objects import ObjectModel, Solid, box, mass_properties, stack
from megrasp_core.simulation import FreeSpaceRig

from .check import check_gripper
from .compare import surface_distance

SHARE = 0.45
DENSITY = 500.0
DEPTH = 0.04
HEIGHT = 0.05
PAD_LEVEL = 0.01
CLOUD_POINTS = 512
PANEL = (300, 250)
MIN_CHANGE = 0.003
"""How far (m) the 90th percentile of the closed cloud about the TCP must lie from the open one."""


@dataclass(frozen=True)
class FamilyCheck:
    """Outcome for one gripper.

    error: why it does not load or close, or None. change: 90th percentile of the distance from the
    closed cloud, where it is near the TCP, to the surface of the open gripper (m). box, cylinder:
    what became of each trial; None where it was not tried.
    """

    name: str
    error: str | None
    change: float = 0.0
    box: str | None = None
    cylinder: str | None = None

    @property
    def sound(self) -> bool:
        """Whether it loads, closes, and its clouds differ."""
        return self.error is None and self.change >= MIN_CHANGE

    @property
    def holds(self) -> bool:
        """Whether it is sound and held one of the objects."""
        return self.sound and "success" in (self.box, self.cylinder)


def check_family_gripper(folder: str | Path, timestep: float = 0.002) -> FamilyCheck:
    """Put the gripper of a folder to the test; the cylinder is tried where the box was lost."""
    name = Path(folder).name
    result = check_gripper(folder)
    if result.errors:
        return FamilyCheck(name, result.errors[0])
    # A drive that does not get to the closed posture has burst or is stuck.
    if late := [w for w in result.warnings if "closed posture" in w]:
        return FamilyCheck(name, late[0])
    try:
        gripper = load_gripper(folder)
    except DescriptionError as error:
        return FamilyCheck(name, str(error))
    change = _change(gripper)
    outcomes: dict[str, str] = {}
    for kind in ("box", "cylinder"):
        rig = FreeSpaceRig(gripper, suitable_object(gripper, kind), timestep=timestep)
        # The object's frame stands at the TCP with the gripper's axes.
        pose = np.eye(4)
        pose[:3, 3] = -gripper.tcp
        outcomes[kind] = rig.trial(pose).reason.value
        if outcomes[kind] == "success":
            break
    return FamilyCheck(name, None, change, outcomes.get("box"), outcomes.get("cylinder"))


def suitable_object(gripper: Gripper, kind: str) -> ObjectModel:
    """Return the "box" or the "cylinder" that suits a gripper, its origin at the centre.

    Raises ValueError for a hand: without a width there is no telling what suits it.
    """
    d = gripper.description
    if d.max_width is None:
        raise ValueError(f"{d.name} has no max_width; expected a gripper with one")
    width = d.min_width + SHARE * (d.max_width - d.min_width)
    height = min(HEIGHT, 1.6 * _room_below(gripper))
    if kind == "cylinder":
        solid = _cylinder(width / 2, height)
    else:
        solid = box((width, max(DEPTH, _fingers_depth(gripper)), height))
    properties = mass_properties(solid.pieces)
    return ObjectModel(
        kind,
        solid.vertices,
        solid.faces,
        solid.pieces,
        DENSITY * properties.volume,
        DENSITY * properties.inertia,
    )


def summary(results: Sequence[FamilyCheck]) -> dict[str, Any]:
    """Return counts and 95 % Wilson intervals, over all and by kind, and the failures."""
    kinds = sorted({_kind(result) for result in results})
    return {
        "grippers": len(results),
        "sound": wilson(sum(r.sound for r in results), len(results)).to_json(),
        "holds": wilson(sum(r.holds for r in results), len(results)).to_json(),
        "kinds": {
            kind: wilson(sum(r.holds for r in of), len(of)).to_json()
            for kind in kinds
            if (of := [r for r in results if _kind(r) == kind])
        },
        "failures": [asdict(r) for r in results if not r.holds],
    }


def family_sheet(
    folders: Iterable[Path], file: Path, tell: Callable[[], object] | None = None
) -> Path:
    """Draw the grippers of these folders, open and closed, to a PNG; `tell` is called after each.

    Raises ValueError without a folder.
    """
    with TemporaryDirectory() as scratch:
        tiles = []
        for folder in folders:
            gripper = load_gripper(folder)
            picture = Path(scratch) / f"{folder.name}.png"
            draw_gripper(gripper, size=PANEL).save(picture)
            width = gripper.description.max_width
            opens = "" if width is None else f", opens to {1000 * width:.0f} mm"
            tiles.append((picture, folder.name + opens, None))
            if tell is not None:
                tell()
        return contact_sheet(tiles, file)


def text(content: Mapping[str, Any]) -> str:
    """Return the lines of a summary."""

    def line(name: str, rate: Mapping[str, Any]) -> str:
        if rate["ci95"] is None:
            return f"{name:<18s} none"
        low, high = rate["ci95"]
        counts = f"{rate['successes']}/{rate['trials']}"
        return f"{name:<18s} {counts:>10s} {rate['rate']:7.1%}  [{low:.1%}, {high:.1%}]"

    rows = [line("sound", content["sound"]), line("holds an object", content["holds"])]
    rows += [line("  " + kind, rate) for kind, rate in content["kinds"].items()]
    return "\n".join(rows)


def _change(gripper: Gripper) -> float:
    points = gripper.clouds(CLOUD_POINTS).closed_points
    near = points[np.linalg.norm(points - gripper.tcp, axis=1) < NEAR_TCP]
    if not len(near):
        return 0.0
    return float(np.percentile(surface_distance(near, gripper.meshes("open")), 90))


def _fingers_depth(gripper: Gripper) -> float:
    """Extent along Y (m) of the open fingers at the height of the TCP, over both groups."""
    pads = np.concatenate([gripper.pad_points("open", group) for group in (0, 1)])
    level = pads[np.abs(pads[:, 2] - gripper.tcp[2]) < PAD_LEVEL]
    return float(2 * np.abs(level[:, 1]).max(initial=0.0))


def _room_below(gripper: Gripper) -> float:
    """Height of the TCP over the highest point of what does not move (m)."""
    poses = gripper.body_poses("open")
    top = max(
        float(m.mesh.moved(poses[m.body]).vertices[:, 2].max())
        for m in gripper.body_meshes("collision")
        if gripper.finger_groups[m.body] < 0
    )
    return max(float(gripper.tcp[2]) - top, 0.005)


def _cylinder(radius: float, height: float) -> Solid:
    return stack([(radius, -height / 2), (radius, height / 2)])


def _kind(result: FamilyCheck) -> str:
    return result.name.rpartition("_")[0]
