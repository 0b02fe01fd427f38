"""`megrasp gripper new`: a stranger's model in, a gripper folder out."""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from megrasp_core.drawing.gripper_picture import gripper_picture
from megrasp_core.errors import DescriptionError, InvalidRequestError
from megrasp_core.gripper_tools.check import check_geometry, check_gripper
from megrasp_core.grippers import (
    FILE_NAME,
    Gripper,
    GripperDescription,
    load_description,
    quiet_mujoco,
    save_description,
)

from .analyse import Analysis, Overrides, analyse
from .compose import Labels, compose, valid_name
from .conclusions import conclude
from .encounters import collisions_on_the_way
from .findings import Finding, Notes
from .prepare import Prepared, prepare
from .source import SourceOptions
from .tcp import other_tcps

REPORT_FILE = "report.json"
PICTURE_FILE = "picture.png"
UNKNOWN = "unknown"

Revise = Callable[[list[Finding], Overrides], Overrides | None]
"""Shows findings to the user; returns changed overrides, or None to accept."""


@dataclass(frozen=True)
class ModelRequest:
    """What `megrasp gripper new` is asked for.

    Attributes:
        model: URDF or MJCF.
        out: new folder.
        source: how the model is read.
        overrides: what is said instead of found.
        name: registered name; None: that of the folder.
        display_name: for people; None: from the name.
        licence: of the model.
        origin: where the model comes from.
    """

    model: Path
    out: Path
    source: SourceOptions = field(default_factory=SourceOptions)
    overrides: Overrides = field(default_factory=Overrides)
    name: str | None = None
    display_name: str | None = None
    licence: str | None = None
    origin: str | None = None


@dataclass(frozen=True)
class NewGripper:
    """What was made: the description in its folder, the analysis, findings, notes, and what the
    check of the finished gripper says.
    """

    description: GripperDescription
    analysis: Analysis
    findings: list[Finding]
    notes: list[str]
    errors: list[str]
    warnings: list[str]

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of report.json."""
        return {
            "findings": [asdict(finding) for finding in self.findings],
            "notes": self.notes,
            "errors": self.errors,
            "warnings": self.warnings,
        }


def new_gripper(
    request: ModelRequest,
    revise: Revise | None = None,
    accept_scale: Callable[[float], bool] | None = None,
    picture: bool = True,
) -> NewGripper:
    """Make `gripper.yaml`, model, picture and report in the folder `request.out`.

    Args:
        request: model and options.
        revise: asks the user about what is unsure; None never asks.
        accept_scale: asks whether to scale a model in millimetres; None never accepts.
        picture: whether to draw the picture.

    Raises:
        DescriptionError: the model is wrong (the message says what to do).
        InvalidRequestError: the folder holds a description already, or the name is no gripper's.
    """
    out = request.out
    if (out / FILE_NAME).exists():
        raise InvalidRequestError(
            f"{out} holds a {FILE_NAME} already; expected a new folder. Remove it or name another"
        )
    if request.name is not None and not re.fullmatch(r"[a-z0-9_]+", request.name):
        raise InvalidRequestError(
            f"the name '{request.name}' is no gripper's; expected a-z, 0-9 and _, such as "
            f"--name {valid_name(request.name)} (any words: --display-name)"
        )
    with quiet_mujoco():
        return _make(request, revise, accept_scale or (lambda _: False), picture)


def _make(
    request: ModelRequest,
    revise: Revise | None,
    accept_scale: Callable[[float], bool],
    picture: bool,
) -> NewGripper:
    out, overrides = request.out, request.overrides
    notes = Notes()
    with tempfile.TemporaryDirectory(prefix="megrasp-gripper-") as scratch, _named(scratch, out):
        prepared = prepare(request.model, Path(scratch), request.source, notes, accept_scale)
        labels = _labels(request, prepared)
        while True:
            analysis = analyse(prepared, overrides)
            description, analysis = _with_sound_tcp(prepared, analysis, labels, overrides)
            findings = conclude(prepared, analysis, description, overrides)
            changed = revise(findings, overrides) if revise is not None else None
            if changed is None:
                break
            overrides = changed
        notes.lines += collisions_on_the_way(prepared, analysis)
        save_description(description, prepared.folder)
        # What the loader refuses is not left behind.
        load_description(prepared.folder)
        out.mkdir(parents=True, exist_ok=True)
        shutil.copytree(prepared.folder, out, dirs_exist_ok=True)
    out.chmod(0o755)
    made = load_description(out)
    check = check_gripper(out)
    result = NewGripper(made, analysis, findings, notes.lines, check.errors, check.warnings)
    (out / REPORT_FILE).write_text(json.dumps(result.to_dict(), indent=1) + "\n", encoding="utf-8")
    if picture:
        gripper_picture(Gripper(made), out / PICTURE_FILE)
    return result


@contextmanager
def _named(scratch: str, out: Path) -> Iterator[None]:
    """Name in errors the folder that the user asked for, not the one it is made in."""
    try:
        yield
    except DescriptionError as error:
        if scratch not in str(error):
            raise
        raise DescriptionError(str(error).replace(scratch, str(out))) from error


def _with_sound_tcp(
    prepared: Prepared, analysis: Analysis, labels: Labels, overrides: Overrides
) -> tuple[GripperDescription, Analysis]:
    """Return the description with the first TCP that has nothing against it, and the analysis
    with that; where all have, with the first.
    """
    description = compose(prepared, analysis, labels)
    if overrides.tcp is not None or check_geometry(Gripper(description)).ok:
        return description, analysis
    for rule, tcp in other_tcps(prepared.mechanism, prepared.motion, analysis):
        changed = replace(analysis, tcp=tcp, tcp_rule=rule)
        other = compose(prepared, changed, labels)
        if check_geometry(Gripper(other)).ok:
            return other, changed
    return description, analysis


def _labels(request: ModelRequest, prepared: Prepared) -> Labels:
    # The registered name of a gripper is its folder's.
    name = request.name or valid_name(request.out.resolve().name)
    return Labels(
        name=name,
        display_name=request.display_name or name,
        licence=request.licence or UNKNOWN,
        source=request.origin or f"made from {request.model.name}",
    )
