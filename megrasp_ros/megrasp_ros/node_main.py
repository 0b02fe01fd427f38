"""The one way in which this package's auxiliary nodes start, spin and end."""

from __future__ import annotations

import sys
from collections.abc import Callable

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node

from megrasp_core.errors import MegraspError

from .spinning import spin


def run_node(make: Callable[[], Node], *, threads: int = 4) -> None:
    """Makes the node, spins it until Ctrl-C or SIGTERM, and exits with 0.

    A node that cannot be made because of what it was given (a MegraspError or a parameter out of
    range) ends the process with exit code 2 and one line that says why.
    """
    rclpy.init()
    node: Node | None = None
    code = 0
    try:
        node = make()
        executor = MultiThreadedExecutor(num_threads=threads)
        executor.add_node(node)
        spin(executor)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (MegraspError, ParameterException) as error:
        get_logger("megrasp_ros").fatal(str(error))
        code = 2
    except Exception:
        # A signal makes rclpy's handles invalid under whatever callback is running.
        if rclpy.ok():
            raise
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    if code:
        sys.exit(code)
