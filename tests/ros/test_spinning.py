"""Neither a callback's error nor a handle that another thread destroys ends the spinning."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException

from megrasp_ros.spinning import MOST, spin


class Stumbling:
    """An executor that meets an error some times before it ends as usual."""

    def __init__(self, times: int, error: Exception | None = None) -> None:
        self.left, self.spins = times, 0
        self.error = error or InvalidHandle("cannot use Destroyable")
        self.context = rclpy.get_default_context()

    def spin(self) -> None:
        self.spins += 1
        if self.left:
            self.left -= 1
            raise self.error


@pytest.fixture
def running() -> Iterator[None]:
    rclpy.init()
    yield
    rclpy.try_shutdown()


ERRORS = [InvalidHandle("destruction was requested"), RuntimeError("a bug in a callback")]


@pytest.mark.parametrize("error", ERRORS)
def test_spinning_goes_on_after_an_error(running: None, error: Exception) -> None:
    executor: Any = Stumbling(3, error)
    spin(executor)
    assert executor.spins == 4


def test_spinning_ends_when_the_process_is_told_to(running: None) -> None:
    rclpy.shutdown()
    executor: Any = Stumbling(3)
    spin(executor)
    assert executor.spins == 1


def test_spinning_ends_when_its_owner_says_so(running: None) -> None:
    executor: Any = Stumbling(3)
    spin(executor, lambda: executor.spins == 2)
    assert executor.spins == 2


@pytest.mark.parametrize("error", ERRORS)
def test_an_error_that_does_not_end_is_raised(running: None, error: Exception) -> None:
    executor: Any = Stumbling(10 * MOST, error)
    with pytest.raises(type(error)):
        spin(executor)
    assert executor.spins == MOST


def test_an_external_shutdown_passes_through(running: None) -> None:
    executor: Any = Stumbling(3, ExternalShutdownException())
    with pytest.raises(ExternalShutdownException):
        spin(executor)
