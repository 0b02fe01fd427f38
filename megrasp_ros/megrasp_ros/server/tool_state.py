"""Which gripper is on the arm: the one place that knows, and the only one that publishes by it.

No ROS here. A version counts the changes. Whoever plans grasps takes a `Claim` first; `publish`
lets it through only as long as nothing has changed since. Everything that is told to others, empty
poses after a change included, is told under the same lock, so that a late subscriber never meets
poses of a gripper other than the active one.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from megrasp_core.errors import MegraspError
from megrasp_ros.errors import BusyError, NotActiveError, ToolMismatchError, shortened

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

LONGEST_NAME = 255
"""Of a tool that somebody reports: every diagnosis tells it again."""


class Told(Protocol):
    """Where the state is told; publishes at once."""

    def nothing(self) -> None:
        """Replace poses and grasps by empty ones."""

    def active(self, gripper: Gripper) -> None:
        """Tell which gripper is active."""


@dataclass(frozen=True, eq=False)
class Claim:
    """The tool as it was when a job was planned."""

    version: int
    gripper: Gripper


class ToolState:
    """The active gripper, what the changer reports, and whether a change is going on.

    All methods may be called from any thread. `spelling` is how the active gripper was named: a
    registered name, or a folder.
    """

    def __init__(self, told: Told) -> None:
        self._told = told
        self._lock = threading.RLock()
        self._serving = False
        self._version = 0
        self._active: Gripper | None = None
        self._spelling = ""
        self._reported: str | None = None
        self._changing = ""
        self._heard = False

    @property
    def version(self) -> int:
        """Counts the changes."""
        return self._version

    @property
    def active(self) -> Gripper | None:
        """The gripper that grasps are made for; None before the first."""
        return self._active

    @property
    def spelling(self) -> str:
        """How the active gripper was named."""
        return self._spelling

    @property
    def reported(self) -> str | None:
        """Name of the tool that is mounted, by the changer; "": none, None: nobody has said."""
        return self._reported

    @property
    def mounted(self) -> str:
        """Name of the tool that is on the arm: as reported, else the active one; "": none."""
        with self._lock:
            return self._mounted()

    # Planning

    def claim(self) -> Claim:
        """Return what a job for the active gripper may rely on.

        Raises NotActiveError while nothing is served, BusyError during a change, ToolMismatchError
        when another tool is reported.
        """
        with self._lock:
            self._require_serving()
            if self._changing:
                raise BusyError(
                    f"the tool is being changed to {self._changing!r}; try again when set_gripper "
                    "has answered."
                )
            if self._active is None:
                raise ToolMismatchError(
                    "no gripper is active; expected one. Call set_gripper with its name."
                )
            self._require_match(self._active)
            return Claim(self._version, self._active)

    def check(self, claim: Claim) -> None:
        """Raise ToolMismatchError or NotActiveError when a claim no longer holds."""
        with self._lock:
            self._require_serving()
            if claim.version == self._version:
                return
            if self._active is not None:
                self._require_match(self._active)
            raise ToolMismatchError(
                f"the tool was changed while grasps for {claim.gripper.name!r} were computed "
                f"(change {claim.version}, now {self._version}); they are not given out. Send the "
                "request again."
            )

    def publish(self, claim: Claim, publish: Callable[[], None]) -> None:
        """Call `publish` if the claim still holds. Raises what `check` raises."""
        with self._lock:
            self.check(claim)
            publish()

    # Changing

    def begin(self, name: str) -> None:
        """Before the changer is asked: from now on no pose is right. Raises BusyError."""
        with self._lock:
            self._require_serving()
            if self._changing:
                raise BusyError(
                    f"the tool is being changed to {self._changing!r}; wait for that answer."
                )
            self._changing, self._heard = name, False
            self._void()

    def commit(self, gripper: Gripper, spelling: str, *, mounted: str | None = None) -> None:
        """Make a gripper the active one and tell it.

        mounted: what the changer says is mounted now; None: it was not asked. Somebody else has
        seen to it then, which counts more than an earlier report of no tool.
        """
        with self._lock:
            self._active, self._spelling, self._changing = gripper, spelling, ""
            if mounted is not None:
                self._reported = mounted
            elif self._reported == "":
                self._reported = None
            self._void()
            self._tell_active()

    def abandon(self, mounted: str | None) -> None:
        """End a change that failed; the active gripper stays.

        mounted: what the changer says is mounted, "" for none; None: it has not said. Then the
        latest report counts, if there was one during the change; otherwise no tool does.
        """
        with self._lock:
            if mounted is not None:
                self._reported = shortened(mounted, LONGEST_NAME)
            elif not self._heard:
                self._reported = ""
            self._changing = ""
            self._void()

    def withdraw(self) -> None:
        """End a change before anything was moved; the tool is as it was."""
        with self._lock:
            self._changing = ""

    def report(self, name: str) -> None:
        """Take in what the changer reports as mounted; "": nothing.

        An empty report before any other says nothing: changers start with it.
        """
        with self._lock:
            if self._reported is None and not name:
                return
            before = self._mounted()
            self._reported, self._heard = shortened(name, LONGEST_NAME), True
            if self._mounted() != before:
                self._void()

    # Serving

    def serve(self) -> None:
        """Tell the active gripper; claims are given from now on."""
        with self._lock:
            self._serving = True
            self._void()
            self._tell_active()

    def suspend(self) -> None:
        """Take back what was told; no claim holds any more."""
        with self._lock:
            if self._serving:
                self._void()
            self._serving = False

    def clear(self, claim: Claim) -> None:
        """Take back the poses, because the scene has none, if the claim still holds."""
        self.publish(claim, self._told.nothing)

    def _void(self) -> None:
        self._version += 1
        self._told.nothing()

    def _tell_active(self) -> None:
        if self._serving and self._active is not None:
            self._told.active(self._active)

    def _mounted(self) -> str:
        if self._reported is not None:
            return self._reported
        return self._active.name if self._active is not None else ""

    def _require_serving(self) -> None:
        if not self._serving:
            raise NotActiveError("the lifecycle node is not active any more; activate it.")

    def _require_match(self, active: Gripper) -> None:
        error = mismatch(self._reported, active.name)
        if error is not None:
            raise error


def mismatch(reported: str | None, active: str) -> MegraspError | None:
    """Return the error of a report that does not fit the active gripper."""
    if reported is None or reported == active:
        return None
    if not reported:
        return ToolMismatchError(
            f"the tool changer reports no tool, or did not say which; expected {active!r}, the "
            "active gripper. Call set_gripper with the gripper that is on the arm, or let the "
            f"changer mount {active!r} (megrasp_call change_tool {active})."
        )
    return ToolMismatchError(
        f"tool_id reports {reported!r}, but the active gripper is {active!r}; expected the same. "
        f"Call set_gripper with {reported!r}, or let the changer mount {active!r} (megrasp_call "
        f"change_tool {active})."
    )
