"""The one owner of the tool: what each event does to claims and to what is told."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from megrasp_core.errors import CancelledError
from megrasp_ros.errors import (
    BusyError,
    NoChangerError,
    NotActiveError,
    ToolChangeError,
    ToolMismatchError,
)
from megrasp_ros.server.tool_change import change_tool
from megrasp_ros.server.tool_state import ToolState
from megrasp_ros.server.worker import Job

JAW: Any = SimpleNamespace(name="jaw")
HAND: Any = SimpleNamespace(name="hand")


class Heard:
    """What was told, in order."""

    def __init__(self) -> None:
        self.all: list[str] = []

    def nothing(self) -> None:
        self.all.append("")

    def active(self, gripper: Any) -> None:
        self.all.append(gripper.name)


@pytest.fixture
def heard() -> Heard:
    return Heard()


@pytest.fixture
def state(heard: Heard) -> ToolState:
    made = ToolState(heard)
    made.commit(JAW, "jaw")
    made.serve()
    heard.all.clear()
    return made


def change(state: ToolState, mount: Any) -> None:
    change_tool(
        state,
        HAND,
        "hand",
        Job("set_gripper", lambda job: None),
        prepare=lambda gripper: None,
        mount=mount,
    )


def answer(success: bool, mounted: str, message: str = "") -> Any:
    return lambda name, job: SimpleNamespace(success=success, mounted=mounted, message=message)


def test_empty_poses_are_told_before_the_new_gripper(state: ToolState, heard: Heard) -> None:
    change(state, None)
    assert heard.all == ["", "hand"]
    assert (state.active, state.spelling) == (HAND, "hand")


def test_a_claim_ends_with_a_change(state: ToolState, heard: Heard) -> None:
    claim = state.claim()
    assert claim.gripper is JAW
    state.publish(claim, lambda: heard.all.append("poses"))
    change(state, None)
    with pytest.raises(ToolMismatchError, match="changed while grasps for 'jaw' were computed"):
        state.publish(claim, lambda: heard.all.append("never"))
    assert heard.all == ["poses", "", "hand"]


def test_nothing_is_planned_while_the_changer_works(state: ToolState, heard: Heard) -> None:
    def mount(name: str, job: Job) -> Any:
        with pytest.raises(BusyError, match="changed to 'hand'"):
            state.claim()
        assert heard.all == [""]
        return SimpleNamespace(success=True, mounted="hand", message="")

    change(state, mount)
    assert state.claim().gripper is HAND


@pytest.mark.parametrize(
    ("mount", "text", "reported"),
    [
        (answer(True, "claw"), "answered success for 'hand', but that 'claw' is mounted", "claw"),
        (answer(True, ""), "but that no tool is mounted", ""),
        (answer(False, "", "slipped"), "slipped; it says that no tool is mounted", ""),
        (lambda name, job: None, "did not answer", ""),
    ],
)
def test_a_change_that_failed_is_not_believed(
    state: ToolState, mount: Any, text: str, reported: str
) -> None:
    with pytest.raises(ToolChangeError, match=text):
        change(state, mount)
    assert (state.active, state.reported) == (JAW, reported)
    with pytest.raises(ToolMismatchError):
        state.claim()


def test_a_refusal_with_the_old_tool_on_leaves_it_usable(state: ToolState, heard: Heard) -> None:
    with pytest.raises(ToolChangeError, match="jammed"):
        change(state, answer(False, "jaw", "jammed"))
    assert state.claim().gripper is JAW
    assert heard.all == ["", ""]


def test_without_a_changer_to_ask_nothing_is_known_to_have_moved(state: ToolState) -> None:
    def mount(name: str, job: Job) -> None:
        raise NoChangerError("not there")

    with pytest.raises(NoChangerError):
        change(state, mount)
    assert state.claim().gripper is JAW


def test_after_a_change_that_was_broken_off_the_latest_report_counts(state: ToolState) -> None:
    def cancelled(name: str, job: Job) -> None:
        raise CancelledError("deactivated")

    def reported_and_cancelled(name: str, job: Job) -> None:
        state.report("jaw")
        raise CancelledError("deactivated")

    with pytest.raises(CancelledError):
        change(state, cancelled)
    with pytest.raises(ToolMismatchError, match="no tool"):
        state.claim()
    with pytest.raises(CancelledError):
        change(state, reported_and_cancelled)
    assert state.claim().gripper is JAW


def test_reports(state: ToolState, heard: Heard) -> None:
    # Changers start with an empty one; and the first that agrees changes nothing.
    claim = state.claim()
    for name in ("", "jaw", "jaw"):
        state.report(name)
    state.check(claim)
    assert not heard.all
    state.report("hand")
    assert heard.all == [""]
    with pytest.raises(ToolMismatchError, match="tool_id reports 'hand'"):
        state.claim()
    state.report("jaw")
    # The tool was off in the meantime.
    with pytest.raises(ToolMismatchError):
        state.check(claim)
    state.check(state.claim())
    state.report("")
    with pytest.raises(ToolMismatchError, match="reports no tool"):
        state.claim()
    # Somebody mounts it by hand and says so.
    change(state, None)
    assert state.claim().gripper is HAND


def test_a_report_that_contradicts_outlives_set_gripper(state: ToolState) -> None:
    state.report("jaw")
    change(state, None)
    with pytest.raises(ToolMismatchError, match="reports 'jaw', but the active gripper is 'hand'"):
        state.claim()
    state.report("hand")
    assert state.claim().gripper is HAND


def test_poses_go_with_the_node(state: ToolState, heard: Heard) -> None:
    claim = state.claim()
    state.suspend()
    assert heard.all == [""]
    for call in (state.claim, lambda: state.check(claim)):
        with pytest.raises(NotActiveError):
            call()
    state.commit(HAND, "hand")
    assert "hand" not in heard.all
    state.serve()
    assert heard.all[-2:] == ["", "hand"]
    with pytest.raises(ToolMismatchError):
        state.check(claim)


def test_the_name_of_a_reported_tool_is_kept_short(state: ToolState) -> None:
    """Every diagnosis tells it again."""
    state.report("t" * 10**7)
    assert len(state.reported or "") < 400
    with pytest.raises(ToolMismatchError):
        state.claim()
    state.abandon("m" * 10**7)
    assert len(state.reported or "") < 400
    state.report("jaw")
    assert state.claim().gripper is JAW
