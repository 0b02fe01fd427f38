"""One thread that does all computing, so that the executor stays free and torch sees a single
thread.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from megrasp_core.errors import CancelledError, RequestTimeoutError
from megrasp_ros.errors import BusyError, is_expected

_log = logging.getLogger(__name__)


class Job:
    """A piece of work for the worker, and its outcome.

    `timeout` (s, 0: none) counts from the construction. A `background` job makes way for any
    other.
    """

    def __init__(
        self,
        what: str,
        work: Callable[[Job], Any],
        timeout: float = 0.0,
        *,
        background: bool = False,
    ) -> None:
        self.what = what
        self.background = background
        self.work = work
        self.timeout = timeout
        self.started = time.monotonic()
        self.result: Any = None
        self.error: BaseException | None = None
        self.done = threading.Event()
        self._stop = threading.Event()
        self._reason = ""

    @property
    def elapsed(self) -> float:
        """Seconds since the job was made."""
        return time.monotonic() - self.started

    @property
    def remaining(self) -> float:
        """Seconds until the timeout; infinite without one."""
        return self.timeout - self.elapsed if self.timeout > 0 else float("inf")

    def cancel(self, reason: str) -> None:
        """Ask the work to stop at its next step; `reason` goes into the error message."""
        if not self._stop.is_set():
            self._reason = reason
            self._stop.set()

    def should_stop(self) -> bool:
        """Return True when the work was cancelled or its time is over."""
        return self._stop.is_set() or self.remaining <= 0

    def check(self) -> None:
        """Raise CancelledError or RequestTimeoutError when the work should stop."""
        if self._stop.is_set():
            raise CancelledError(self._reason)
        if self.remaining <= 0:
            raise RequestTimeoutError(
                f"the request was not done within its timeout of {self.timeout:g} s; give it more "
                "time, or lower num_grasps or `drawn`."
            )

    def wait(self) -> Any:
        """Wait for the end of the job; return its result or raise its error."""
        self.done.wait()
        if self.error is not None:
            raise self.error
        return self.result


class Worker:
    """Runs one job at a time in its own thread. There is no queue: a second job is refused or
    takes over.
    """

    def __init__(self, name: str = "megrasp_worker") -> None:
        self._changed = threading.Condition()
        self._job: Job | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def current(self) -> Job | None:
        """The running job."""
        return self._job

    def submit(self, job: Job, *, preempt: bool = False) -> Job:
        """Start a job. While another one runs: BusyError; with `preempt`, or if that one is a
        background job, it is cancelled first.
        """
        with self._changed:
            while self._job is not None and not self._closed:
                if not (preempt or self._job.background):
                    raise BusyError(
                        f"a job is running ({self._job.what}, for {self._job.elapsed:.1f} s); try "
                        "again when it is done, cancel it, or send generate_grasps with preempt: "
                        "true."
                    )
                self._job.cancel("another request took over; send this one again if it is needed.")
                self._changed.wait()
            if self._closed:
                raise BusyError("the node is shutting down; start it again.")
            self._job = job
            self._changed.notify_all()
        return job

    def close(self, timeout: float = 10.0) -> None:
        """Cancel the running job and end the thread."""
        with self._changed:
            self._closed = True
            if self._job is not None:
                self._job.cancel("the node is shutting down; start it again.")
            self._changed.notify_all()
        self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            with self._changed:
                while self._job is None and not self._closed:
                    self._changed.wait()
                job = self._job
            if job is None:
                return
            self._execute(job)
            with self._changed:
                self._job = None
                # Set after the slot is free: whoever waited for this job may submit the next one
                # at once.
                job.done.set()
                self._changed.notify_all()

    @staticmethod
    def _execute(job: Job) -> None:
        try:
            job.check()
            job.result = job.work(job)
        except CancelledError as error:
            job.error = error
            try:
                # The core only knows that it was stopped; the job knows why.
                job.check()
            except (CancelledError, RequestTimeoutError) as why:
                job.error = why
        except BaseException as error:
            if not is_expected(error):
                _log.exception("job %r failed", job.what)
            job.error = error
