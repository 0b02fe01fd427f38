"""Which gripper is on, under random interleavings of everything that can happen at once: no late
subscriber reads poses of a gripper other than `active_gripper`.
"""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from turns import Turns

from megrasp_core.errors import CancelledError, MegraspError
from megrasp_ros.errors import NoChangerError
from megrasp_ros.server.tool_change import change_tool
from megrasp_ros.server.tool_state import ToolState
from megrasp_ros.server.worker import Job

GRIPPERS: dict[str, Any] = {name: SimpleNamespace(name=name) for name in ("jaw", "hand", "claw")}
RUNS = 1000
CLIENTS = 4
EACH = 5


class LatchedTopics:
    """What a late subscriber would read; silent while the node's publishers are off."""

    def __init__(self) -> None:
        self.on = False
        self.poses_of = ""
        self.active_name = ""
        self.published = 0

    def nothing(self) -> None:
        self._publish(poses_of="")

    def active(self, gripper: Any) -> None:
        self._publish(active_name=gripper.name)

    def poses(self, name: str) -> None:
        self._publish(poses_of=name)
        self.published += self.on

    def _publish(self, **values: str) -> None:
        if self.on:
            vars(self).update(values)
            # After each message: somebody may subscribe between two.
            assert self.poses_of in ("", self.active_name), "poses of a gripper that is not active"


class Cell:
    """A node's tool, with an engine that takes its time and a changer that cannot be trusted."""

    def __init__(self, seed: int, kind: type[ToolState] = ToolState) -> None:
        self.turns = Turns(seed)
        self.topics = LatchedTopics()
        self.state = kind(self.topics)
        self.state.commit(GRIPPERS["jaw"], "jaw")
        self.topics.on = True
        self.state.serve()
        self.moving = threading.Lock()
        self.stale = 0
        self.operations: list[Callable[[], None]] = [
            self.set_gripper,
            self.set_gripper_with_changer,
            self.set_gripper_with_liar,
            self.tool_is_dropped,
            self.changer_is_silent,
            self.changer_is_missing,
            self.tool_id,
            self.request,
            self.request_for_another,
            self.empty_bin,
            self.other_gripper_while_inactive,
            self.reload,
        ]

    def any(self) -> Any:
        return self.turns.random.choice(list(GRIPPERS.values()))

    def client(self) -> None:
        for _ in range(EACH):
            # Requests as often as everything else together: they are what can go wrong.
            chosen = self.turns.random.choice([*self.operations, *[self.request] * 8])
            self.turns.give()
            with contextlib.suppress(MegraspError):
                chosen()

    # Operations

    def change(self, mount: Callable[[str], Any] | None) -> None:
        def asked(name: str, job: Job) -> Any:
            self.turns.give()
            assert mount is not None
            answer = mount(name)
            self.turns.give()
            return answer

        gripper = self.any()
        change_tool(
            self.state,
            gripper,
            gripper.name,
            Job("set_gripper", lambda job: None),
            prepare=lambda gripper: self.turns.give(),
            mount=asked if mount is not None else None,
        )

    def set_gripper(self) -> None:
        self.change(None)

    def set_gripper_with_changer(self) -> None:
        self.change(lambda name: SimpleNamespace(success=True, message="", mounted=name))

    def set_gripper_with_liar(self) -> None:
        self.change(
            lambda name: SimpleNamespace(success=True, message="", mounted=self.any().name)
        )

    def tool_is_dropped(self) -> None:
        self.change(lambda name: SimpleNamespace(success=False, message="dropped", mounted=""))

    def changer_is_silent(self) -> None:
        self.change(lambda name: None)

    def changer_is_missing(self) -> None:
        def missing(name: str) -> None:
            raise self.turns.random.choice([NoChangerError("none"), CancelledError("deactivated")])

        self.change(missing)

    def tool_id(self) -> None:
        self.state.report(self.turns.random.choice([*GRIPPERS, ""]))

    def request(self) -> None:
        claim = self.state.claim()
        version = self.state.version
        for _ in range(self.turns.random.randrange(4)):
            self.turns.give()
        changed = self.state.version != version
        self.stale += changed
        before = self.topics.published
        try:
            self.state.publish(claim, lambda: self.topics.poses(claim.gripper.name))
        except MegraspError:
            assert changed, "a job that was up to date was refused"
            raise
        assert not changed, "a job planned for an older version was published"
        assert self.topics.published == before + 1

    def request_for_another(self) -> None:
        """Answered and not published: nothing happens here."""
        self.turns.give()

    def empty_bin(self) -> None:
        claim = self.state.claim()
        self.turns.give()
        self.state.clear(claim)

    def other_gripper_while_inactive(self) -> None:
        if not self.moving.acquire(blocking=False):
            return
        try:
            self.state.suspend()
            self.turns.give()
            self.topics.on = False
            self.turns.give()
            self.state.commit(self.any(), "configured")
            self.turns.give()
            self.topics.on = True
            self.turns.give()
            self.state.serve()
        finally:
            self.moving.release()

    def reload(self) -> None:
        active = self.state.active
        assert active is not None
        self.turns.give()
        self.state.commit(active, "jaw", mounted=self.state.reported)


def test_latched_poses_are_always_those_of_the_active_gripper() -> None:
    published = stale = 0
    for seed in range(RUNS):
        cell = Cell(seed)
        cell.turns.run([cell.client] * CLIENTS)
        published, stale = published + cell.topics.published, stale + cell.stale
        # However it went, the next change brings the node back to work.
        cell.state.commit(GRIPPERS["hand"], "hand", mounted="hand")
        claim = cell.state.claim()
        cell.state.publish(claim, functools.partial(cell.topics.poses, "hand"))
        assert (cell.topics.poses_of, cell.topics.active_name) == ("hand", "hand")
    # What the test is about has happened often.
    assert published > RUNS
    assert stale > RUNS / 2


class Careless(ToolState):
    """A state that publishes whatever comes."""

    def check(self, claim: Any) -> None:
        return


class Forgetful(ToolState):
    """A state that leaves the poses where they are when the gripper changes."""

    def _void(self) -> None:
        self._version += 1


@pytest.mark.parametrize("kind", [Careless, Forgetful])
def test_a_state_that_does_not_look_after_it_is_found_out(kind: type[ToolState]) -> None:
    with pytest.raises(AssertionError):
        for seed in range(RUNS):
            cell = Cell(seed, kind)
            cell.turns.run([cell.client] * CLIENTS)
