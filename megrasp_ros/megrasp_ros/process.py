"""The one way in which this package's nodes start, spin and end.

Signals are heard from the first line on, imports included (entry.py), and as often as they come.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import NoReturn, Protocol

from .fast_dds import remove_stale_segments

INTERRUPTED = 130
PATIENCE = 4.0
"""A signal so long (s) after the first one ends the process at once; ros2 launch sends its second
one after five.
"""


class StopSignals:
    """SIGINT and SIGTERM as an event.

    Before `orderly` the process has nothing to put in order and a signal ends it.
    """

    def __init__(self) -> None:
        """Take the signals over; only the main thread may."""
        self.event = threading.Event()
        self.orderly = False
        self._first = 0.0
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        code = INTERRUPTED if number == signal.SIGINT else 0
        now = time.monotonic()
        if not self.orderly:
            os._exit(code)
        if not self.event.is_set():
            self._first = now
            self.event.set()
        elif now - self._first > PATIENCE:
            os._exit(INTERRUPTED)


class Runnable(Protocol):
    """What is used of a node."""

    def destroy_node(self) -> None:
        """Destroy the node."""


def run_node(
    make: Callable[[], Runnable], *, threads: int = 4, signals: StopSignals | None = None
) -> NoReturn:
    """Make a node, spin it until SIGINT, SIGTERM or the end of rclpy's context, and exit with 0.

    Where the node has methods `start` and `close`, they are called before it is spun and, with it
    still spinning, at the end. A node that cannot be made because of what it was given (a
    MegraspError or a parameter out of range) ends the process with exit code 2 and one line that
    says why; one that cannot be spun any more, with 1.
    """
    signals = signals or StopSignals()
    import rclpy

    signals.orderly = True
    _start_rclpy()
    nodes: list[Runnable] = []
    code = _serve(make, nodes, threads, signals)
    # Here, where nothing holds the executor any more.
    _join_callbacks(3.0)
    while nodes:
        nodes.pop().destroy_node()
    rclpy.try_shutdown()
    leave(code)


def run_program(run: Callable[[], int], *, signals: StopSignals | None = None) -> NoReturn:
    """Call a program that makes calls and ends by itself, with rclpy up, and exit with what it
    returns.

    SIGINT and SIGTERM shut rclpy down, which ends every wait; the program then returns or raises
    whatever it likes, and the process exits with 130. A MegraspError or a parameter out of range
    is exit code 2 and one line that says why.
    """
    signals = signals or StopSignals()
    import rclpy
    from rclpy.exceptions import ParameterException
    from rclpy.logging import get_logger

    from megrasp_core.errors import MegraspError

    signals.orderly = True
    _start_rclpy()

    def shut_down() -> None:
        signals.event.wait()
        # What rclpy is making at that moment stays half-made, and its finalizer fails.
        sys.unraisablehook = lambda _: None
        rclpy.try_shutdown()

    threading.Thread(target=shut_down, name="signals", daemon=True).start()
    try:
        code = run()
    except (MegraspError, ParameterException) as error:
        get_logger("megrasp_ros").fatal(str(error))
        code = 2
    except BaseException:
        if not signals.event.is_set():
            raise
        code = INTERRUPTED
    rclpy.try_shutdown()
    leave(INTERRUPTED if signals.event.is_set() else code)


def _start_rclpy() -> None:
    """Start rclpy, or leave with 2 and one line when the command line cannot be read."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    remove_stale_segments()
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:
        sys.stderr.write(
            f"{str(error).splitlines()[0]}\nExpected arguments such as --ros-args -p name:=value; "
            "the numbers of a list all with a decimal point, [0.0, 0.0, 1.0].\n"
        )
        leave(2)


def leave(code: int) -> NoReturn:
    """End the process at once."""
    # Fast DDS keeps its shared memory until the last object that knows the node is gone.
    gc.collect()
    # Freeing torch's modules takes seconds more on a busy machine, and ros2 launch loses patience
    # with a node after five.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _serve(
    make: Callable[[], Runnable], nodes: list[Runnable], threads: int, signals: StopSignals
) -> int:
    from rclpy.exceptions import ParameterException
    from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
    from rclpy.logging import get_logger

    from megrasp_core.errors import MegraspError

    from .spinning import spin

    executor = MultiThreadedExecutor(num_threads=threads)
    failed: list[Exception] = []

    def run() -> None:
        try:
            spin(executor, signals.event.is_set)
        except ExternalShutdownException:
            pass
        except Exception as error:
            failed.append(error)

    # Not the main thread: it could not hear signals while it waits for messages.
    spinner = threading.Thread(target=run, name="spin", daemon=True)
    try:
        node = make()
        nodes.append(node)
        executor.add_node(node)  # type: ignore[arg-type]
        getattr(node, "start", _nothing)()
        spinner.start()
        while spinner.is_alive() and not signals.event.wait(0.2):
            pass
    except (MegraspError, ParameterException) as error:
        get_logger("megrasp_ros").fatal(str(error))
        return 2
    finally:
        for node in nodes:
            getattr(node, "close", _nothing)()
        executor.shutdown()
        if spinner.is_alive():
            spinner.join(2.0)
    if failed:
        get_logger("megrasp_ros").fatal(f"spinning has failed too often: {failed[0]}")
        return 1
    return 0


def _join_callbacks(timeout: float) -> None:
    """Wait (s) for the executor's threads. Its own shutdown does not wait for them; they end once
    it is gone and they are done with their callbacks.
    """
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        gc.collect()
        busy = [
            thread
            for thread in threading.enumerate()
            if thread is not threading.main_thread() and not thread.daemon
        ]
        if not busy:
            return
        busy[0].join(0.05)


def _nothing() -> None:
    """Stand in for what a node does not have."""
