"""Where grasps failed is not tried again while there is anything else."""

from __future__ import annotations

import numpy as np
import pytest

from megrasp_core.cell.failure_memory import CHANGED, FailureMemory


def at(x: float) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


def places(memory: FailureMemory) -> list[float]:
    return [float(pose[0, 3]) for pose in memory.excluded]


def test_failures_outlast_a_success_elsewhere() -> None:
    memory = FailureMemory()
    memory.count(False, at(0.0))
    memory.count(False, at(0.3))
    assert (places(memory), memory.in_a_row) == ([0.0, 0.3], 2)
    memory.count(True, at(0.3 + 0.9 * CHANGED))
    assert (places(memory), memory.in_a_row) == ([0.0], 0), "beside it the scene has changed"
    memory.count(True, None)
    memory.count(False, None)
    assert (places(memory), memory.in_a_row) == ([0.0], 1)
    assert memory.recent == []


def test_giving_up_keeps_what_failed_and_another_gripper_does_not() -> None:
    memory = FailureMemory()
    memory.count(False, at(0.1))
    memory.give_up()
    assert (places(memory), memory.recent, memory.in_a_row) == ([0.1], [], 0)
    memory.clear()
    assert places(memory) == []


@pytest.mark.parametrize("nothing", [0, 1])
def test_what_failed_before_is_allowed_when_nothing_else_is_found(nothing: int) -> None:
    memory = FailureMemory()
    memory.count(False, at(0.0))
    memory.count(True, at(0.5))
    memory.count(False, at(0.2))
    asked: list[int] = []

    def synthesize(failed: list[np.ndarray]) -> int:
        asked.append(len(failed))
        return nothing if len(failed) > 1 else 5

    answer = memory.ask(synthesize, lambda grasps: grasps > 0)
    assert (answer, asked) == ((1, [2]) if nothing else (5, [2, 1]))
    assert places(memory) == ([0.0, 0.2] if nothing else [0.2])


def test_what_failed_since_the_last_success_is_never_allowed() -> None:
    memory = FailureMemory()
    memory.count(False, at(0.0))
    asked: list[int] = []
    assert memory.ask(lambda failed: asked.append(len(failed)) or 0, bool) == 0
    assert asked == [1]
