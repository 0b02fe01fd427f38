"""The steps from one gripper to another. No ROS here: the changer is whatever `Mount` is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from megrasp_ros.errors import NoChangerError, ToolChangeError

from .tool_state import ToolState
from .worker import Job

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper


class Changed(Protocol):
    """What a changer answers (ChangeTool.srv)."""

    success: bool
    message: str
    mounted: str


Mount = Callable[[str, Job], Changed | None]
"""(name, job) -> the changer's answer, None when it gave none; may block the worker's thread."""


def change_tool(
    state: ToolState,
    gripper: Gripper,
    spelling: str,
    job: Job,
    *,
    prepare: Callable[[Gripper], None],
    mount: Mount | None,
) -> None:
    """Make `gripper` the active one; on any failure the one before stays active.

    Args:
        state: is told of every step.
        gripper: loaded.
        spelling: how it was named.
        job: that this is part of.
        prepare: does what can fail before anything changes: renders and encodes the gripper.
        mount: asks the changer; None: somebody else changes the tool.

    Raises:
        ToolChangeError: there is no changer, it did not mount the gripper, or it says that another
            one is on.
        BusyError: another change is going on.
    """
    prepare(gripper)
    if mount is None:
        state.commit(gripper, spelling)
        return
    job.check()
    state.begin(gripper.name)
    try:
        answer = mount(gripper.name, job)
    except NoChangerError:
        state.withdraw()
        raise
    except BaseException:
        # It may have been changed or not; tool_id or the next set_gripper tells.
        state.abandon(None)
        raise
    if answer is None:
        state.abandon(None)
        raise ToolChangeError(
            f"the tool changer did not answer, so that nobody knows whether {gripper.name!r} is "
            "mounted; requests are refused until tool_id or set_gripper says which tool is on. "
            "Check the changer."
        )
    if answer.success and answer.mounted == gripper.name:
        state.commit(gripper, spelling, mounted=answer.mounted)
        return
    state.abandon(answer.mounted)
    on = f"{answer.mounted!r} is mounted" if answer.mounted else "no tool is mounted"
    if answer.success:
        raise ToolChangeError(
            f"the tool changer answered success for {gripper.name!r}, but that {on}; expected the "
            "same name. Check the changer and the names in its rack."
        )
    raise ToolChangeError(
        f"the tool changer did not mount {gripper.name!r}: {_reason(answer)}; "
        f"it says that {on}. Check the changer; the active gripper is unchanged here."
    )


def _reason(answer: Changed) -> str:
    return answer.message.rstrip(" .;") or "no reason given"
