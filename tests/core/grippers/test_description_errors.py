"""What every mistake in a description or its model is answered with, word for word.

The answers are kept in description_errors.yaml; after a deliberate change write them anew with

    python tests/core/grippers/test_description_errors.py --write
"""

from __future__ import annotations

import ast
import os
import re
import sys
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml
from mistakes import CHECK, LOAD, Write
from tiny_gripper import put, write

from megrasp_core.errors import MegraspError, UnknownGripperError
from megrasp_core.gripper_tools import check
from megrasp_core.gripper_tools.check import GripperCheck
from megrasp_core.grippers import (
    Gripper,
    actuation,
    description,
    fields,
    load_description,
    load_gripper,
    model,
    model_file,
    model_mistakes,
    posture,
    registry,
    yaml_file,
)

SNAPSHOT = Path(__file__).with_name("description_errors.yaml")
MODULES = (
    actuation,
    description,
    fields,
    model,
    model_file,
    model_mistakes,
    posture,
    registry,
    yaml_file,
)
# What parsers say differs between their versions, what is registered between machines.
FOREIGN = (
    r"(; (?:it|the parser) says: ).*()",
    r"(is no XML \().*?(\); expected)",
    r"(expected one of ).*?( or a folder)",
    r"(' is at )[-.e\d]+(, the closed)",
    r"(after the turn by )[.\d]+( mm)",
)
HELP = ("expect", "must", "valid", "required fields", "may be", "set it to", "models in")
HELP = (*HELP, "it says", "make them the same")
ALIKE = {"no file", "folder instead of the file"}


@dataclass(frozen=True)
class Answer:
    """What was said of a mistake, and the places in our code (file, line) that said it."""

    said: str | list[str]
    places: set[tuple[str, int]]


class Recorded(list[str]):
    """A list that knows where its items were appended."""

    def __init__(self) -> None:
        super().__init__()
        self.places: set[tuple[str, int]] = set()

    def append(self, text: str) -> None:
        """Append and remember who did."""
        caller = sys._getframe(1)
        self.places.add((caller.f_code.co_filename, caller.f_lineno))
        super().append(text)


def plain(message: str, folder: Path) -> str:
    """Leave out what differs from machine to machine."""
    message = message.replace(str(folder), "FOLDER")
    for pattern in FOREIGN:
        message = re.sub(pattern, r"\1...\2", message)
    return message


def refused(ask: Callable[[Path], object], folder: Path) -> Answer:
    """Return the error that stops the loading."""
    try:
        ask(folder)
    except Exception as error:
        places = set()
        cause: BaseException | None = error
        while cause is not None:
            frame, line = list(traceback.walk_tb(cause.__traceback__))[-1]
            places.add((frame.f_code.co_filename, line))
            cause = cause.__context__
        code = 200 if isinstance(error, UnknownGripperError) else 201
        ours = isinstance(error, MegraspError) and error.code == code
        return Answer(plain(str(error) if ours else repr(error), folder), places)
    return Answer("(loads)", set())


def checked(mistake: Write, folder: Path) -> Answer:
    """Return what `megrasp gripper check` finds, errors before warnings."""
    mistake(folder)
    lists = Recorded(), Recorded()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(check, "GripperCheck", lambda name, errors=None: _check(name, errors, lists))
        result = check.check_gripper(folder)
    said = [f"error: {e}" for e in result.errors] + [f"warning: {w}" for w in result.warnings]
    return Answer([plain(text, folder) for text in said], lists[0].places | lists[1].places)


def _check(name: str, errors: list[str] | None, lists: tuple[Recorded, Recorded]) -> GripperCheck:
    lists[0].extend(errors or [])
    return GripperCheck(name, *lists)


def _load(mistake: Write) -> Callable[[Path], object]:
    def ask(folder: Path) -> Gripper:
        mistake(folder)
        return Gripper.from_path(folder)

    return ask


def _no_asset(folder: Path) -> Gripper:
    os.environ["MEGRASP_ASSETS"] = str(folder)
    return Gripper.from_path(write(folder, put("model", "asset:tiny/model.xml")))


ASK: dict[str, Callable[[Path], object]] = {
    **{name: _load(mistake) for name, mistake in LOAD.items()},
    "asset that is missing": _no_asset,
    "model given as a description": lambda folder: load_description(write(folder) / "model.xml"),
    "name unlike the folder's": lambda folder: load_gripper(
        "other", [write(folder / "other").parent]
    ),
    "unknown gripper": lambda folder: load_gripper("tinny", [write(folder / "tiny").parent]),
}


def all_answers() -> dict[str, Answer]:
    """Make every mistake and return what is said, checks under "check: <name>"."""
    out = {}
    with tempfile.TemporaryDirectory() as scratch, pytest.MonkeyPatch.context() as patch:
        patch.chdir(scratch)
        for number, (name, ask) in enumerate(ASK.items()):
            patch.setenv("MEGRASP_ASSETS", "")
            out[name] = refused(ask, Path(scratch) / f"load{number}")
        for number, (name, mistake) in enumerate(CHECK.items()):
            out[f"check: {name}"] = checked(mistake, Path(scratch) / f"check{number}")
        assert not Path("MUJOCO_LOG.TXT").exists()
    return out


@pytest.fixture(scope="module")
def answers() -> dict[str, Answer]:
    """What is said now."""
    return all_answers()


@cache
def kept() -> dict[str, Any]:
    """Return the snapshot."""
    return yaml.safe_load(SNAPSHOT.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", [*ASK, *(f"check: {name}" for name in CHECK)])
def test_message(answers: dict[str, Answer], name: str) -> None:
    """The message is the one that is kept."""
    assert answers[name].said == kept().get(name), "write the snapshot anew if this is meant"


def test_snapshot_holds_nothing_else(answers: dict[str, Answer]) -> None:
    """No message is kept of a mistake that is not tried."""
    assert sorted(kept()) == sorted(answers)


def test_each_mistake_has_its_own_message() -> None:
    """No two share one, but for what parsers tell apart."""
    messages = {name: kept()[name] for name in ASK if name not in ALIKE}
    own = [message for message in messages.values() if "..." not in message]
    assert len(own) > 90
    assert [message for message in own if own.count(message) > 1] == []


def test_messages_say_where_and_what_is_right() -> None:
    """Each names the file and the right or valid values."""
    for name in ASK:
        message = kept()[name]
        assert "FOLDER" in message or name == "unknown gripper", message
        assert any(word in message for word in HELP), message


def test_every_error_of_the_code_is_tried(answers: dict[str, Answer]) -> None:
    """Each raise, and each error and warning of the check, is what some mistake leads to."""
    reached = {place for answer in answers.values() for place in answer.places}
    for module in MODULES:
        assert raises(module) - reached == set(), "raised by no mistake in the table"
    assert appends(check) - reached == set(), "said of no mistake in the table"


def raises(module: ModuleType) -> set[tuple[str, int]]:
    """Return the places of a module that raise."""
    return {
        (str(module.__file__), node.lineno)
        for node in ast.walk(ast.parse(Path(str(module.__file__)).read_text()))
        if isinstance(node, ast.Raise)
    }


def appends(module: ModuleType) -> set[tuple[str, int]]:
    """Return the places of a module that append to `errors` or `warnings`."""
    return {
        (str(module.__file__), node.lineno)
        for node in ast.walk(ast.parse(Path(str(module.__file__)).read_text()))
        if isinstance(node, ast.Call)
        and re.search(r"\.(errors|warnings)\.append$", ast.unparse(node.func))
    }


if __name__ == "__main__" and "--write" in sys.argv:
    messages = {name: answer.said for name, answer in all_answers().items()}
    SNAPSHOT.write_text(
        yaml.safe_dump(messages, sort_keys=False, width=95, allow_unicode=True), encoding="utf-8"
    )
