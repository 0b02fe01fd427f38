"""The worker thread: one job at a time, cancelled or out of time between its steps."""

from __future__ import annotations

import threading

import pytest
from megrasp_msgs.msg import ErrorCode

from megrasp_core.errors import CancelledError, CloudError, RequestTimeoutError
from megrasp_ros.errors import BusyError, describe, is_expected
from megrasp_ros.server.worker import Job, Worker


@pytest.fixture
def worker():
    made = Worker()
    yield made
    made.close()


def stepping(started: threading.Event):
    """Return work that runs until it is stopped."""

    def work(job: Job) -> None:
        started.set()
        while not job.should_stop():
            threading.Event().wait(0.005)
        raise CancelledError("between two steps")

    return work


def test_results_and_errors_reach_the_caller(worker: Worker) -> None:
    assert worker.submit(Job("sum", lambda job: 1 + 2)).wait() == 3
    with pytest.raises(ZeroDivisionError):
        worker.submit(Job("bug", lambda job: 1 / 0)).wait()
    assert worker.submit(Job("after the bug", lambda job: "goes on")).wait() == "goes on"


def test_all_jobs_run_in_one_other_thread(worker: Worker) -> None:
    threads = {
        worker.submit(Job("id", lambda job: threading.get_ident())).wait() for _ in range(5)
    }
    assert len(threads) == 1
    assert threads != {threading.get_ident()}


def test_a_second_job_is_refused_while_one_runs(worker: Worker) -> None:
    started = threading.Event()
    first = worker.submit(Job("long work", stepping(started)))
    assert started.wait(5)
    with pytest.raises(BusyError, match="long work"):
        worker.submit(Job("second", lambda job: None))
    first.cancel("enough")
    with pytest.raises(CancelledError, match="enough"):
        first.wait()
    assert worker.submit(Job("third", lambda job: 3)).wait() == 3


def test_a_preempting_job_takes_over(worker: Worker) -> None:
    started = threading.Event()
    first = worker.submit(Job("first", stepping(started), preemptible=True))
    assert started.wait(5)
    assert worker.submit(Job("second", lambda job: 2), preempt=True).wait() == 2
    with pytest.raises(CancelledError, match="took over"):
        first.wait()


def test_a_background_job_makes_way(worker: Worker) -> None:
    started = threading.Event()
    first = worker.submit(Job("automatic", stepping(started), background=True))
    assert started.wait(5)
    assert worker.submit(Job("request", lambda job: 2)).wait() == 2
    with pytest.raises(CancelledError, match="took over"):
        first.wait()


def test_a_job_ends_at_its_timeout(worker: Worker) -> None:
    started = threading.Event()
    job = worker.submit(Job("slow", stepping(started), timeout=0.1))
    with pytest.raises(RequestTimeoutError, match=r"timeout of 0\.1 s"):
        job.wait()
    assert 0.1 <= job.elapsed < 2.0


def test_closing_cancels(worker: Worker) -> None:
    started = threading.Event()
    job = worker.submit(Job("until the end", stepping(started)))
    assert started.wait(5)
    worker.close()
    with pytest.raises(CancelledError, match="shutting down"):
        job.wait()
    with pytest.raises(BusyError, match="shutting down"):
        worker.submit(Job("too late", lambda job: None))


class OutOfMemoryError(RuntimeError):
    """Named like torch's."""


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (CloudError("no points"), ErrorCode.BAD_CLOUD, "no points"),
        (MemoryError(), ErrorCode.OUT_OF_MEMORY, "drawn"),
        (OutOfMemoryError("CUDA"), ErrorCode.OUT_OF_MEMORY, "CUDA"),
        (KeyError("x"), ErrorCode.INTERNAL, "KeyError"),
    ],
)
def test_every_error_has_a_code_and_a_text(error: Exception, code: int, words: str) -> None:
    assert describe(error)[0] == code
    assert words in describe(error)[1]
    assert is_expected(error) == (code != ErrorCode.INTERNAL)


def test_the_cores_codes_are_the_messages_constants() -> None:
    import megrasp_core.errors as core
    import megrasp_ros.errors as ros

    constants = {v for k, v in ErrorCode.__dict__.items() if k.isupper()} | {
        getattr(ErrorCode, name) for name in dir(ErrorCode) if name.isupper()
    }
    found = [
        each.code
        for module in (core, ros)
        for each in vars(module).values()
        if isinstance(each, type) and issubclass(each, core.MegraspError)
    ]
    assert len(found) > 15
    assert set(found) <= constants
