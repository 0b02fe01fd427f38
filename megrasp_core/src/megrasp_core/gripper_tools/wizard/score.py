"""Score of the wizard: grippers whose axes and TCP are known, hidden from it."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.errors import DescriptionError, MegraspError
from megrasp_core.gripper_tools.plain_jaws import plain_jaws, write_plain_jaw
from megrasp_core.grippers import FILE_NAME, MODEL_SUFFIXES, GripperDescription, load_description

from .wizard import ModelRequest, new_gripper

FACTS_FILE = "facts.json"
JAW_LIMITS = (10.0, 0.010)
HAND_LIMITS = (25.0, 0.030)
"""Largest angle of either axis (degrees) and distance of the TCP (m)."""

WANTED = 11 / 13
WANTED_JAWS = 38 / 40

JAW_ACTUATORS = 4
"""A real gripper with more actuators is a hand."""


@dataclass(frozen=True)
class Row:
    """One gripper: angles (degrees) of closing (sign free) and approach axis to the measured ones,
    distance (m) of the TCPs; None where the wizard failed with `error`.
    """

    name: str
    kind: str
    closing: float | None
    approach: float | None
    tcp: float | None
    right: bool
    sureness: dict[str, str]
    errors: list[str]


@dataclass(frozen=True)
class Score:
    """All rows, and which share of them is wanted right."""

    rows: list[Row]
    wanted: float = WANTED

    @property
    def right(self) -> int:
        """Number of grippers within all limits."""
        return sum(row.right for row in self.rows)

    @property
    def passed(self) -> bool:
        """Whether the wanted share is right."""
        return bool(self.rows) and self.right >= self.wanted * len(self.rows) - 1e-9

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of the JSON file."""
        limits = {
            kind: {"axes_deg": limit[0], "tcp_m": limit[1]}
            for kind, limit in (("jaws", JAW_LIMITS), ("hand", HAND_LIMITS))
        }
        rows = [asdict(row) for row in self.rows]
        return {"right": self.right, "of": len(rows), "limits": limits, "grippers": rows}


def score_assets(
    folder: Path,
    names: Sequence[str] = (),
    keep: Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Score:
    """Make a description of every gripper below `folder` and compare it with facts.json there.

    Args:
        folder: holds facts.json and a folder per gripper with model.xml or model.urdf.
        names: grippers; all with a folder of their own by default.
        keep: where the made grippers stay, with pictures; None throws them away.
        progress: told the name of each gripper before it is made.

    Raises:
        DescriptionError: no such gripper or no facts.
    """
    facts = json.loads((folder / FACTS_FILE).read_text(encoding="utf-8"))
    known = [name for name in facts if (folder / name).is_dir()]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise DescriptionError(f"no gripper '{unknown[0]}' in {folder}; valid: {', '.join(known)}")
    rows = []
    for name in names or known:
        if progress is not None:
            progress(name)
        model = next(
            file for file in sorted((folder / name).iterdir()) if file.suffix in MODEL_SUFFIXES
        )
        with tempfile.TemporaryDirectory() as scratch:
            out = (Path(scratch) if keep is None else keep) / name
            rows.append(_row(name, model, out, facts[name], picture=keep is not None))
    return Score(rows)


def score_plain_jaws(
    count: int,
    seed: int,
    keep: Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Score:
    """The same for jaws that are drawn here, with what is known about them as the facts.

    Args:
        count: how many.
        seed: of the drawing.
        keep: where the made grippers stay, with pictures; None throws them away.
        progress: told the name of each gripper before it is made.
    """
    rows = []
    for jaw in plain_jaws(count, seed):
        if progress is not None:
            progress(jaw.name)
        with tempfile.TemporaryDirectory() as scratch:
            model = write_plain_jaw(jaw, Path(scratch) / "input")
            out = (Path(scratch) if keep is None else keep) / jaw.name
            rows.append(_row(jaw.name, model, out, jaw.facts(), picture=keep is not None))
    return Score(rows, WANTED_JAWS)


def score_descriptions(
    folder: Path,
    names: Sequence[str] = (),
    keep: Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Score:
    """The same for a folder of gripper folders: what their gripper.yaml says are the facts.

    Raises:
        DescriptionError: no such gripper, or a description that cannot be read.
    """
    known = sorted(file.parent.name for file in folder.glob(f"*/{FILE_NAME}"))
    unknown = [name for name in names if name not in known]
    if unknown or not known:
        raise DescriptionError(
            f"no gripper '{(unknown or ['*'])[0]}' in {folder}; valid: {', '.join(known)}"
        )
    rows = []
    for name in names or known:
        if progress is not None:
            progress(name)
        truth = load_description(folder / name)
        with tempfile.TemporaryDirectory() as scratch:
            # Without its description, in a folder that does not tell its name.
            source = Path(scratch) / "input"
            shutil.copytree(truth.model_path.parent, source)
            (source / FILE_NAME).unlink(missing_ok=True)
            model = source / truth.model_path.name
            out = Path(scratch) / "made" if keep is None else keep / name
            rows.append(_row(name, model, out, facts_of(truth), picture=keep is not None))
    return Score(rows)


def facts_of(description: GripperDescription) -> dict[str, Any]:
    """Return axes and TCP of a description in the model frame, and whether it is a hand."""
    mount = description.mount_from_model.matrix()
    tcp = mount[:3, :3].T @ (np.array(description.tcp) - mount[:3, 3])
    hand = description.kind == "hand"
    return {"closing": mount[0, :3], "approach": mount[2, :3], "tcp": tcp, "hand": hand}


def compare_with_facts(
    description: GripperDescription, fact: Mapping[str, Any]
) -> tuple[float, float, float]:
    """Return the angles (degrees) of closing and approach axis and the distance (m) of the TCP.

    A fact holds `closing`, `approach` and `tcp` in the model frame.
    """
    mount = description.mount_from_model.matrix()
    closing, approach = mount[0, :3], mount[2, :3]
    tcp = mount[:3, :3].T @ (np.array(description.tcp) - mount[:3, 3])
    return (
        min(_angle(closing, fact["closing"]), _angle(-closing, fact["closing"])),
        _angle(approach, fact["approach"]),
        float(np.linalg.norm(tcp - np.array(fact["tcp"]))),
    )


def within_limits(hand: bool, closing: float, approach: float, tcp: float) -> bool:
    """Whether axes (degrees) and TCP (m) are right for a hand or for jaws."""
    angle, distance = HAND_LIMITS if hand else JAW_LIMITS
    return max(closing, approach) <= angle and tcp <= distance


def table(score: Score) -> list[str]:
    """Return the score as lines of text."""
    lines = [f"{'gripper':<20s} {'kind':<9s} closing approach      TCP"]
    for row in score.rows:
        if row.closing is None or row.approach is None or row.tcp is None:
            lines.append(f"{row.name:<20s} failed: {row.errors[0]}")
            continue
        lines.append(
            f"{row.name:<20s} {row.kind:<9s} {row.closing:5.1f} deg {row.approach:5.1f} deg "
            f"{1000 * row.tcp:5.1f} mm {'right' if row.right else 'WRONG'}"
        )
    lines.append(f"{score.right} of {len(score.rows)} right")
    return lines


def _row(name: str, model: Path, out: Path, fact: Mapping[str, Any], picture: bool) -> Row:
    try:
        made = new_gripper(ModelRequest(model, out), picture=picture)
    except MegraspError as error:
        return Row(name, "?", None, None, None, False, {}, [str(error)])
    closing, approach, tcp = compare_with_facts(made.description, fact)
    # By the facts, not by what the wizard takes it for: a jaw called a hand gets no easier limits.
    hand = fact["hand"] if "hand" in fact else len(fact["actuators"]) > JAW_ACTUATORS
    return Row(
        name=name,
        kind=made.description.kind,
        closing=round(closing, 2),
        approach=round(approach, 2),
        tcp=round(tcp, 5),
        right=within_limits(hand, closing, approach, tcp),
        sureness={finding.what: finding.sureness for finding in made.findings},
        errors=made.errors,
    )


def _angle(a: Any, b: Any) -> float:
    a, b = np.asarray(a, float), np.asarray(b, float)
    cosine = float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
