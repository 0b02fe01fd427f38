"""Many answers at once leave one after another."""

from __future__ import annotations

import threading
import time
from itertools import pairwise

from megrasp_ros.pacing import Gate


def test_a_few_pass_at_once_and_many_in_their_order() -> None:
    gate, passed, all_passed = Gate(burst=3, gap=0.01, quiet=0.0), [], threading.Event()

    def enter(number: int) -> None:
        def pass_(number: int = number) -> None:
            passed.append((number, time.monotonic()))
            if number == 19:
                all_passed.set()

        gate.enter(pass_)

    for number in range(20):
        enter(number)
    assert [number for number, _ in passed[:3]] == [0, 1, 2]
    assert all_passed.wait(60)
    assert [number for number, _ in passed] == list(range(20))
    times = [at for _, at in passed[3:]]
    # Not faster than the gap; sleeping may be a little short.
    assert min(later - earlier for earlier, later in pairwise(times)) > 0.005


def test_nobody_passes_before_the_crowd_has_come() -> None:
    gate, passed = Gate(burst=1, gap=0.01, quiet=3600.0), threading.Event()
    gate.enter(lambda: None)
    gate.enter(passed.set)
    assert not passed.wait(0.3)


def test_the_gate_opens_again() -> None:
    gate = Gate(burst=1, gap=0.01, quiet=0.0)
    for _ in range(3):
        passed = threading.Event()
        gate.enter(passed.set)
        assert passed.wait(60)
        time.sleep(0.05)
