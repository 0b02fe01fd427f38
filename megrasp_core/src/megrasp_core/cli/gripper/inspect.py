"""`megrasp gripper list | show | check | render`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from megrasp_core.cli.common import emit, say
from megrasp_core.errors import InvalidRequestError

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

__all__ = ["check", "listed", "render", "show"]


def listed(out: Path | None = None) -> int:
    """All registered grippers.

    Try: MEGRASP_GRIPPER_PATH=my_grippers megrasp gripper list

    Args:
        out: JSON instead of a table.
    """
    from megrasp_core.grippers import gripper_folders, load_description

    rows = [(load_description(folder), str(folder)) for _, folder in gripper_folders().items()]
    if out is not None:
        emit([{**d.to_dict(), "folder": folder} for d, folder in rows], out)
        return 0
    for description, folder in rows:
        width = "-" if description.max_width is None else f"{1000 * description.max_width:.0f} mm"
        say(
            f"{description.name:<20s} {description.kind:<9s} opens {width:>7s}  "
            f"{description.display_name}  ({folder})"
        )
    return 0 if rows else 1


def show(name: tyro.conf.Positional[str], out: Path | None = None) -> int:
    """What is known about a gripper: frames, postures, fingers, hash.

    Try: megrasp gripper show robotiq_2f85

    Args:
        name: registered name or folder of a gripper.yaml.
        out: JSON file instead of standard output.
    """
    from megrasp_core.grippers import load_gripper

    emit(_facts(load_gripper(name)), out)
    return 0


def check(
    path: tyro.conf.Positional[str],
    against: str | None = None,
    points: int = 20000,
    out: Path | None = None,
) -> int:
    """Check a gripper description, and compare its shape with another's.

    Loads description and model, settles both postures, renders both clouds, tests that the fingers
    close towards each other and that the stated symmetry holds. Against another gripper, prints
    how far surfaces, TCP, opening and the motion of the pads differ; more than the limits is a
    finding. Exit code 1 with findings.

    Try: megrasp gripper check my_gripper/ --against robotiq_2f85

    Args:
        path: folder of a gripper.yaml, or a registered name.
        against: another gripper, such as the CAD model of the same one.
        points: surface points of each posture that are compared.
        out: JSON with the facts and findings.
    """
    from megrasp_core.gripper_tools.check import find_mistakes
    from megrasp_core.gripper_tools.fidelity import fidelity, text_table
    from megrasp_core.grippers import load_gripper

    if points < 1:
        raise InvalidRequestError(f"--points is {points}; expected at least 1.")
    gripper = load_gripper(path)
    other = None if against is None else load_gripper(against)
    report = _facts(gripper)
    found = find_mistakes(gripper)
    findings, warnings = list(found.errors), list(found.warnings)
    report["measures"] = found.measures
    result = None if other is None else fidelity(gripper, other, points)
    if result is not None:
        report["against"] = result.to_dict()
        findings += [
            f"against {result.reference}: {m.quantity} is {1000 * m.value:.2f} mm; expected at "
            f"most {1000 * m.limit:.1f} mm"
            for m in result.measures
            if m.limit is not None and not m.passed
        ]
    report["findings"], report["warnings"] = findings, warnings
    emit(report, out)
    if result is not None:
        say(f"{gripper.name} against {result.reference}, {points} points")
        say(text_table(result))
    for warning in warnings:
        say(f"warning: {warning}")
    for finding in findings:
        say(f"finding: {finding}")
    say(f"{gripper.name}: {len(findings)} findings, {len(warnings)} warnings")
    return 1 if findings else 0


def render(name: tyro.conf.Positional[str], out: Path) -> int:
    """A picture of the open and the closed gripper with the TCP frame.

    Try: megrasp gripper render robotiq_3f --out robotiq_3f.png

    Args:
        name: registered name or folder of a gripper.yaml.
        out: PNG.
    """
    from megrasp_core.drawing.grasp_picture import draw_gripper
    from megrasp_core.grippers import load_gripper

    image = draw_gripper(load_gripper(name))
    out.parent.mkdir(parents=True, exist_ok=True)
    image.save(out)
    say(f"wrote {out}")
    return 0


def _facts(gripper: Gripper) -> dict[str, Any]:
    return {
        **gripper.description.to_dict(),
        "hash": gripper.hash,
        "open_joints": gripper.open_joints,
        "closed_joints": gripper.closed_joints,
        "actuators": int(gripper.model.nu),
    }
