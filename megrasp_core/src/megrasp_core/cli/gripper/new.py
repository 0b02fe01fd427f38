"""`megrasp gripper new | score-wizard`."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from megrasp_core.cli.common import Flag, emit, say
from megrasp_core.errors import InvalidRequestError

if TYPE_CHECKING:
    from megrasp_core.gripper_tools.wizard.analyse import Overrides
    from megrasp_core.gripper_tools.wizard.findings import Finding
    from megrasp_core.gripper_tools.wizard.score import Score
    from megrasp_core.gripper_tools.wizard.wizard import NewGripper

__all__ = ["new", "score_wizard"]

Vector = Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")]
Values = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")]
Folders = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=FOLDER ...")]
Links = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="LINK")]
Arguments = Annotated[
    tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME:=VALUE")
]

VECTORS = ("approach", "closing", "tcp")
POSTURES = ("open", "closed")


def new(
    model: tyro.conf.Positional[Path],
    out: Path,
    name: str | None = None,
    display_name: str | None = None,
    kind: str | None = None,
    approach: Vector | None = None,
    closing: Vector | None = None,
    tcp: Vector | None = None,
    tip_depth: float | None = None,
    open: Values = (),
    closed: Values = (),
    root: str | None = None,
    scale: float | None = None,
    package: Folders = (),
    without: Links = (),
    xacro_arg: Arguments = (),
    licence: str | None = None,
    source: str | None = None,
    yes: Flag = False,
) -> int:
    """Make a gripper.yaml, and a picture to check it by, from a URDF, xacro or MJCF.

    Moves the joints to find the fingers, the approach and closing axes, the TCP, the open and the
    closed posture; says how sure it is of each, and asks on a terminal about what it cannot tell.
    Vectors and lengths are in the model's frame, metres and radians.

    Try: megrasp gripper new my_gripper.urdf --out grippers/my_gripper

    Args:
        model: URDF, xacro or MJCF.
        out: new folder: gripper.yaml, model.xml, meshes/, picture.png, report.json.
        name: registered name; by default that of the folder.
        display_name: name for people.
        kind: parallel, adaptive or hand.
        approach: direction out of the palm.
        closing: direction along which the fingers close.
        tcp: point between the fingertips.
        tip_depth: distance of the TCP behind the fingertips, instead of `tcp`.
        open: joint (or actuator) values of the open posture.
        closed: joint (or actuator) values of the closed posture.
        root: link to cut the gripper out at, of a model that holds more.
        scale: metres in one unit of the model's lengths, such as 0.001.
        package: folders of ROS packages that meshes are named by.
        without: a link whose shapes are no part of the gripper, such as a safety hull; repeatable.
        xacro_arg: an argument of a xacro file; repeatable.
        licence: licence of the model.
        source: where the model comes from.
        yes: never ask; take what is found.
    """
    from megrasp_core.gripper_tools.wizard.source import SourceOptions
    from megrasp_core.gripper_tools.wizard.wizard import ModelRequest, new_gripper

    packages = {key: Path(value) for key, value in _pairs(package, "--package").items()}
    asking = not yes and sys.stdin.isatty()
    request = ModelRequest(
        model=model,
        out=out,
        source=SourceOptions(packages, scale, root, without, _arguments(xacro_arg)),
        overrides=_overrides(kind, approach, closing, tcp, tip_depth, open, closed),
        name=name,
        display_name=display_name,
        licence=licence,
        origin=source,
    )
    made = new_gripper(
        request,
        revise=_Questions() if asking else None,
        accept_scale=lambda factor: yes or (asking and _agreed(factor)),
    )
    return _report(made, out)


def score_wizard(
    names: tyro.conf.Positional[tuple[str, ...]] = (),
    folder: Path | None = None,
    jaws: int | None = None,
    seed: int = 1,
    out: Path | None = None,
    keep: Path | None = None,
) -> int:
    """Score `gripper new` on grippers whose facts are known and hidden from it.

    By default the real ones of the assets. Right are closing and approach axis within 10 degrees
    for jaws and 25 for hands, the TCP within 1 cm and 3 cm. Exit code 1 where less than 11 of 13
    are right, of drawn jaws less than 38 of 40.

    Try: megrasp gripper score-wizard --jaws 40 --out jaws.json

    Args:
        names: grippers; all of the folder by default.
        folder: holds facts.json and models, or folders with a gripper.yaml that are taken as
            truth; by default the folder grippers of MEGRASP_ASSETS.
        jaws: draw so many single, angular, vise and limitless jaws instead.
        seed: of the drawn jaws.
        out: JSON with a row per gripper.
        keep: folder to keep the made grippers and their pictures in.
    """
    from megrasp_core.gripper_tools.wizard.score import (
        FACTS_FILE,
        score_assets,
        score_descriptions,
        score_plain_jaws,
    )

    if jaws is not None:
        if jaws < 1 or names or folder is not None:
            raise InvalidRequestError(
                f"--jaws {jaws} draws its own grippers; expected at least 1, and neither names "
                "nor --folder"
            )
        return _show_score(score_plain_jaws(jaws, seed, keep, say), out)
    assets = os.environ.get("MEGRASP_ASSETS")
    chosen = folder or (Path(assets) / "grippers" if assets else None)
    if chosen is None or not chosen.is_dir():
        raise InvalidRequestError(
            f"no grippers to score on at {chosen or 'MEGRASP_ASSETS, which is not set'}; expected "
            "a folder: set MEGRASP_ASSETS or --folder"
        )
    run = score_assets if (chosen / FACTS_FILE).is_file() else score_descriptions
    return _show_score(run(chosen, names, keep, say), out)


def _show_score(score: Score, out: Path | None) -> int:
    from megrasp_core.gripper_tools.wizard.score import table

    for line in table(score):
        say(line)
    if out is not None:
        emit(score.to_dict(), out)
    return 0 if score.passed else 1


def _overrides(
    kind: str | None,
    approach: Vector | None,
    closing: Vector | None,
    tcp: Vector | None,
    tip_depth: float | None,
    opened: Values,
    closed: Values,
) -> Overrides:
    import numpy as np

    from megrasp_core.gripper_tools.wizard.analyse import Overrides
    from megrasp_core.grippers import KINDS

    if kind is not None and kind not in KINDS:
        raise InvalidRequestError(f"--kind is '{kind}'; expected one of {', '.join(KINDS)}")
    if tcp is not None and tip_depth is not None:
        raise InvalidRequestError("--tcp and --tip-depth are both given; expected one of them")
    for option, vector in (("--approach", approach), ("--closing", closing)):
        if vector is not None and np.linalg.norm(vector) < 1e-6:
            raise InvalidRequestError(f"{option} is 0 0 0; expected a direction such as 0 0 1")
    if approach is not None and closing is not None:
        lean = abs(np.dot(approach, closing)) / np.linalg.norm(approach) / np.linalg.norm(closing)
        if lean > 0.1:
            raise InvalidRequestError(
                "--approach and --closing are not perpendicular "
                f"({np.degrees(np.arccos(lean)):.0f} degrees); expected 90"
            )
    return Overrides(
        approach=None if approach is None else np.array(approach),
        closing=None if closing is None else np.array(closing),
        tcp=None if tcp is None else np.array(tcp),
        tip_depth=tip_depth,
        open=_numbers(_pairs(opened, "--open"), "--open"),
        closed=_numbers(_pairs(closed, "--closed"), "--closed"),
        kind=kind,
    )


def _pairs(items: tuple[str, ...], option: str) -> dict[str, str]:
    out = {}
    for item in items:
        key, equals, value = item.partition("=")
        if not (key and equals and value):
            raise InvalidRequestError(f"{option} got '{item}'; expected name=value")
        out[key] = value
    return out


def _arguments(items: tuple[str, ...]) -> dict[str, str]:
    out = {}
    for item in items:
        name, sign, value = item.partition(":=")
        if not (name and sign):
            raise InvalidRequestError(f"--xacro-arg got '{item}'; expected name:=value")
        out[name] = value
    return out


def _numbers(items: Mapping[str, str], option: str) -> dict[str, float]:
    out = {}
    for key, value in items.items():
        try:
            out[key] = float(value)
        except ValueError:
            raise InvalidRequestError(
                f"{option} got '{key}={value}'; expected a number (rad or m)"
            ) from None
    return out


def _agreed(factor: float) -> bool:
    answer = input(f"The lengths look like millimetres. Scale the model by {factor:g}? [Y/n] ")
    return answer.strip().lower() in ("", "y", "yes")


class _Questions:
    """Asks once about every answer that is a guess."""

    def __init__(self) -> None:
        self._asked: set[str] = set()

    def __call__(self, findings: list[Finding], overrides: Overrides) -> Overrides | None:
        """Return changed overrides, or None where the user agrees with the rest."""
        from megrasp_core.gripper_tools.wizard.findings import GUESS, show

        for finding in findings:
            known = finding.what in (*VECTORS, *POSTURES)
            if finding.sureness != GUESS or finding.what in self._asked or not known:
                continue
            self._asked.add(finding.what)
            say(f"Not sure about {finding.what}: {show(finding.value)} ({finding.why}).")
            changed = _ask(finding.what, overrides)
            if changed is not None:
                return changed
        return None


def _ask(what: str, overrides: Overrides) -> Overrides | None:
    import numpy as np

    form = "X Y Z" if what in VECTORS else "joint=value ..."
    while True:
        answer = input(f"  Enter keeps it; or {form}: ").split()
        if not answer:
            return None
        try:
            if what in POSTURES:
                option = f"--{what}"
                return replace(
                    overrides, **{what: _numbers(_pairs(tuple(answer), option), option)}
                )
            vector = np.array([float(v) for v in answer])
            if vector.shape == (3,) and (what == "tcp" or np.linalg.norm(vector) > 1e-6):
                return replace(overrides, **{what: vector})
        except (ValueError, InvalidRequestError) as error:
            say(f"  {error}")
        say(f"  expected {form}")


def _report(made: NewGripper, out: Path) -> int:
    from megrasp_core.gripper_tools.wizard.findings import GUESS
    from megrasp_core.gripper_tools.wizard.wizard import PICTURE_FILE

    for finding in made.findings:
        say(finding.line())
    for note in made.notes:
        say(f"note: {note}")
    for finding in made.findings:
        if finding.sureness == GUESS and finding.option:
            say(f"unsure: {finding.what}: {finding.why}; look at the picture, or {finding.option}")
    for warning in made.warnings:
        say(f"warning: {warning}")
    for error in made.errors:
        say(f"finding: {error}")
    say(f"wrote {out}/gripper.yaml; look at {out / PICTURE_FILE}")
    say(f"next: megrasp gripper check {out}")
    return 1 if made.errors else 0
