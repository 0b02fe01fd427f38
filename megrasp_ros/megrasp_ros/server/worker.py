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

_TAKEN_OVER = "another request took over; send this one again if it is needed."


class Job:
    """A piece of work for the worker, and its outcome.

    Attributes:
        what: name for messages.
        work: called with the job in the worker's thread.
        timeout: seconds from `started` to the end; 0: none.
        background: makes way for any other job.
        preemptible: makes way for a job that preempts. What moves a tool does not.
        waits_for: what the work is waiting for at the moment, for the message of a timeout; ""
            while it computes.
    """

    def __init__(
        self,
        what: str,
        work: Callable[[Job], Any],
        timeout: float = 0.0,
        *,
        background: bool = False,
        preemptible: bool = False,
        started: float | None = None,
    ) -> None:
        """Make the job; `started` is when the request arrived (time.monotonic(); default: now)."""
        self.what = what
        self.background = background
        self.preemptible = preemptible or background
        self.work = work
        self.timeout = timeout
        self.started = time.monotonic() if started is None else started
        self.waits_for = ""
        self.result: Any = None
        self.error: BaseException | None = None
        self.done = threading.Event()
        self._stop = threading.Event()
        self._reason = ""
        self._lock = threading.Lock()
        self._on_done: list[Callable[[], None]] = []

    @property
    def elapsed(self) -> float:
        """Seconds since the job was started."""
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
            todo = (
                f"it was still waiting for {self.waits_for}; see to that, or give it more time."
                if self.waits_for
                else "give it more time, or lower num_grasps or `drawn`."
            )
            raise RequestTimeoutError(
                f"the request was not done within its timeout of {self.timeout:g} s; {todo}"
            )

    def on_done(self, call: Callable[[], None]) -> None:
        """Call something in the worker's thread at the end of the job; at once if it has ended."""
        with self._lock:
            if not self.done.is_set():
                self._on_done.append(call)
                return
        call()

    def end(self) -> None:
        """Tell those who wait; result or error have been set."""
        with self._lock:
            self.done.set()
            calls, self._on_done = self._on_done, []
        # The request, with its cloud, need not outlive the work.
        self.work = _nothing
        for call in calls:
            call()

    def outcome(self) -> Any:
        """Return the result of the job that has ended, or raise its error."""
        if self.error is not None:
            raise self.error
        return self.result

    def wait(self) -> Any:
        """Wait for the end of the job; return its result or raise its error."""
        self.done.wait()
        return self.outcome()


class Worker:
    """Runs one job at a time in its own thread.

    There is no queue: a second job is refused, or it takes over and waits until the one before has
    stopped. `submit` never blocks.
    """

    def __init__(self, name: str = "megrasp_worker") -> None:
        self._changed = threading.Condition()
        self._running: Job | None = None
        self._next: Job | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def current(self) -> Job | None:
        """The running job, or the one that is about to run."""
        with self._changed:
            return self._running or self._next

    def submit(self, job: Job, *, preempt: bool = False) -> Job:
        """Start a job.

        Background jobs make way for it; with `preempt` preemptible ones do too. They are cancelled
        and the job starts when they have stopped. Raises BusyError when another job stays.
        """
        with self._changed:
            if self._closed:
                raise BusyError("the node is shutting down; start it again.")
            there = [each for each in (self._running, self._next) if each is not None]
            for other in there:
                if not (other.background or (preempt and other.preemptible)):
                    raise BusyError(
                        f"a job is running ({other.what}, for {other.elapsed:.1f} s); try again "
                        "when it is done, cancel it, or send generate_grasps with preempt: true, "
                        "which takes over from other syntheses."
                    )
            for other in there:
                other.cancel(_TAKEN_OVER)
            given_up, self._next = self._next, job
            self._changed.notify_all()
        if given_up is not None:
            self._give_up(given_up)
        return job

    def stop_all(self, reason: str, timeout: float) -> bool:
        """Cancel what runs and what waits; return whether all has ended within `timeout` (s)."""
        with self._changed:
            there = [each for each in (self._running, self._next) if each is not None]
        for job in there:
            job.cancel(reason)
        end = time.monotonic() + timeout
        ended = [job.done.wait(max(0.0, end - time.monotonic())) for job in there]
        return all(ended)

    def close(self, timeout: float = 10.0) -> None:
        """Cancel the running job and end the thread."""
        with self._changed:
            self._closed = True
            given_up, self._next = self._next, None
            for job in (self._running, given_up):
                if job is not None:
                    job.cancel("the node is shutting down; start it again.")
            self._changed.notify_all()
        if given_up is not None:
            self._give_up(given_up)
        self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            with self._changed:
                while self._next is None and not self._closed:
                    self._changed.wait()
                if self._next is None:
                    return
                job = self._running = self._next
                self._next = None
            _execute(job)
            with self._changed:
                # Free before the end is told: whoever waited may submit the next one at once.
                self._running = None
            _tell(job)
            del job

    def _give_up(self, job: Job) -> None:
        """End a job that has not begun and was cancelled."""
        try:
            job.check()
        except (CancelledError, RequestTimeoutError) as error:
            job.error = error
        _tell(job)


def run_job(job: Job) -> None:
    """Do a job in the calling thread, and tell its end; its error is kept in it."""
    _execute(job)
    _tell(job)


def _tell(job: Job) -> None:
    try:
        job.end()
    except Exception:
        _log.exception("the end of job %r could not be told", job.what)


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
    _forget_frames(job.error)


def _forget_frames(error: BaseException | None) -> None:
    """Let go of what the frames of a traceback hold: clouds, for as long as nobody collects."""
    while error is not None:
        error.__traceback__ = None
        following = error.__cause__ or error.__context__
        error.__cause__ = error.__context__ = None
        error = following


def _nothing(job: Job) -> None:
    """Stand in for work that is done."""
