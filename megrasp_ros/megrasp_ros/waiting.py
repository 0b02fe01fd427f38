"""Waiting for rclpy futures in other threads, and for other threads in callbacks."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.task import Future

SLICE = 0.2
"""SIGTERM shuts rclpy down without waking a waiting thread, so look for it this often (s)."""


def wait_for_future(
    future: Future,
    timeout: float,
    *,
    context: Context | None = None,
    check: Callable[[], None] | None = None,
) -> Any | None:
    """The future's result, or None after `timeout` seconds without one (it is then cancelled).

    context: that of the node, None for rclpy's default one. check: called again and again
    meanwhile; may raise.
    Somebody else must spin the node, and not from the calling thread. Raises what the future
    raised, and ExternalShutdownException when the process is told to end meanwhile.
    """
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    end = time.monotonic() + timeout
    while not done.wait(min(SLICE, max(0.0, end - time.monotonic()))):
        if not rclpy.ok(context=context):
            raise ExternalShutdownException
        if time.monotonic() >= end:
            future.cancel()
            return None
        if check is not None:
            check()
    return future.result()


def send_in_executor(
    node: Node,
    send: Callable[[], Future],
    timeout: float,
    *,
    check: Callable[[], None] | None = None,
) -> Any | None:
    """What the future that `send` returns brings, `send` being called by the node's executor.

    For action clients: rclpy's `send_goal_async` notes the request only after it is sent, without
    a lock, so that a fast answer is thrown away when another thread spins ("Ignoring unexpected
    goal response"). Called by a single-threaded executor, sending and answering cannot overlap.
    None, check and exceptions: see `wait_for_future`.
    """
    executor = node.executor
    if executor is None:
        raise ExternalShutdownException
    end = time.monotonic() + timeout
    sent = wait_for_future(executor.create_task(send), timeout, context=node.context)
    if sent is None:
        return None
    return wait_for_future(
        sent, max(0.0, end - time.monotonic()), context=node.context, check=check
    )


async def wake_when(call_at_end: Callable[[Callable[[], None]], None], node: Node) -> None:
    """Wait in a coroutine of the node's executor for something that another thread does.

    call_at_end: takes a function that is to be called at the end, from any thread.
    """
    done = Future()

    def end() -> None:
        done.set_result(None)
        executor = node.executor
        if executor is not None:
            # The executor looks at what it waits for only when something happens.
            with contextlib.suppress(InvalidHandle):
                executor.wake()

    call_at_end(end)
    await done
