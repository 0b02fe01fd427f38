"""Handles that another thread destroys do not end the spinning."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from rclpy.exceptions import InvalidHandle

from megrasp_ros.spinning import MOST, spin


class Stumbling:
    """An executor that meets a destroyed handle some times before it ends as usual."""

    def __init__(self, times: int) -> None:
        self.left, self.spins = times, 0

    def spin(self) -> None:
        self.spins += 1
        if self.left:
            self.left -= 1
            raise InvalidHandle("cannot use Destroyable because destruction was requested")


@pytest.fixture
def running() -> Iterator[None]:
    rclpy.init()
    yield
    rclpy.try_shutdown()


def test_spinning_goes_on_after_a_destroyed_handle(running):
    executor: Any = Stumbling(3)
    spin(executor)
    assert executor.spins == 4


def test_spinning_ends_when_the_process_is_told_to(running):
    rclpy.shutdown()
    executor: Any = Stumbling(3)
    spin(executor)
    assert executor.spins == 1


def test_a_handle_that_stays_destroyed_is_an_error(running):
    executor: Any = Stumbling(10 * MOST)
    with pytest.raises(InvalidHandle):
        spin(executor)
    assert executor.spins == MOST


def test_other_errors_pass_through(running):
    class Broken:
        def spin(self) -> None:
            raise RuntimeError("something else")

    executor: Any = Broken()
    with pytest.raises(RuntimeError, match="something else"):
        spin(executor)
