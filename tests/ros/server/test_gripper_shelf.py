"""Finding and loading grippers: nothing blocks for ever, nothing is kept without bound."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from megrasp_core import grippers
from megrasp_core.errors import CancelledError, DescriptionError
from megrasp_core.grippers import Gripper, load_gripper
from megrasp_ros.errors import UnknownNameError
from megrasp_ros.server import gripper_shelf
from megrasp_ros.server.gripper_shelf import GripperShelf


@pytest.fixture
def stalled(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let the description of schunk_wsg32 lie on a disk that does not answer."""
    answers, load = threading.Event(), grippers.load_gripper

    def stall(name: str, paths: Sequence[str]) -> Gripper:
        if "schunk_wsg32" in name:
            answers.wait()
        return load(name, paths)

    monkeypatch.setattr(grippers, "load_gripper", stall)
    yield
    answers.set()


def test_reading_that_blocks_is_given_up(stalled: None) -> None:
    shelf = GripperShelf()
    with pytest.raises(DescriptionError, match="had not ended"):
        shelf.load("schunk_wsg32", (), seconds=0.3)
    # Not tried again as long as somebody is at it; others are read.
    with pytest.raises(DescriptionError, match="still going on"):
        shelf.load("schunk_wsg32", ())
    assert shelf.load("robotiq_2f85", ()).name == "robotiq_2f85"


def test_who_comes_while_it_is_read_waits_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, go_on, load = threading.Event(), threading.Event(), grippers.load_gripper
    loads: list[str] = []

    def slow(name: str, paths: Sequence[str]) -> Gripper:
        loads.append(name)
        begun.set()
        go_on.wait()
        return load(name, paths)

    monkeypatch.setattr(grippers, "load_gripper", slow)
    shelf, found = GripperShelf(), []

    def ask() -> None:
        found.append(shelf.load("schunk_wsg32", ()))

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    assert begun.wait(60.0)
    go_on.set()
    for thread in threads:
        thread.join()
    assert loads == ["schunk_wsg32"]
    assert len(found) == 4 and all(each is found[0] for each in found)


def test_reading_can_be_broken_off(stalled: None) -> None:
    def check() -> None:
        raise CancelledError("enough")

    with pytest.raises(CancelledError, match="enough"):
        GripperShelf().load("schunk_wsg32", (), check=check)


def test_a_gripper_is_loaded_once_however_it_is_named() -> None:
    source = Path(load_gripper("schunk_wsg32").description.file).parent
    shelf = GripperShelf()
    by_folder = shelf.load(str(source), (), allow_paths=True)
    assert shelf.load(f"{source}/../{source.name}", (), allow_paths=True) is by_folder
    assert shelf.load("schunk_wsg32", ()) is shelf.load("schunk_wsg32", ())


def test_few_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gripper_shelf, "MOST", 1)
    shelf = GripperShelf()
    first = shelf.load("schunk_wsg32", ())
    shelf.load("robotiq_2f85", ())
    assert shelf.load("schunk_wsg32", ()) is not first


@pytest.mark.parametrize("name", ["/etc/passwd", "~nosuchuser", "x" * 10**6, "a\0b", "", ".", "/"])
def test_only_the_folder_of_a_gripper_is_a_path(name: str) -> None:
    for allowed in (False, True):
        with pytest.raises(UnknownNameError) as error:
            GripperShelf().load(name, (), allow_paths=allowed)
        assert len(str(error.value)) < 2000


def test_no_other_file_is_opened_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "secret.txt").write_text("secret: 1\n")
    (tmp_path / "gripper.yaml").symlink_to(tmp_path / "secret.txt")
    with pytest.raises(UnknownNameError):
        GripperShelf().load(str(tmp_path), (), allow_paths=True)
    with pytest.raises(UnknownNameError):
        GripperShelf().load(str(Path("/etc/passwd")), (), allow_paths=True)
