"""What worker processes run around their units; outside the packages, so that they import nothing
else for it.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections.abc import Callable
from typing import TypeVar

U = TypeVar("U")
R = TypeVar("R")


def end_with_parent() -> None:
    """Ends this process once its parent is gone: one that was killed cannot end its workers, and
    they would wait for work for ever.
    """
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def timed(function: Callable[[U], R], unit: U) -> tuple[R, float]:
    """The result of a unit and the CPU-seconds that it took."""
    start = time.process_time()
    result = function(unit)
    return result, time.process_time() - start
