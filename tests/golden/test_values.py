"""Numbers that stay as they are, and the comparison with older commits."""

from __future__ import annotations

import json

import numpy as np
import pytest
from compare import values_differ
from values import FILE, values

KEPT = json.loads(FILE.read_text())
FOUND = values()


@pytest.mark.parametrize("name", sorted(KEPT))
def test_the_numbers_are_those_that_were_written(name: str) -> None:
    np.testing.assert_allclose(FOUND[name], KEPT[name], rtol=1e-8, atol=1e-10)


def test_nothing_is_left_out() -> None:
    assert FOUND.keys() == KEPT.keys()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ({"a": 1.0}, {"a": 1.0 + 1e-9}, []),
        ({"a": 1.0}, {"a": 1.1}, ["/a: 1.0, now 1.1"]),
        ({"a": [1, 2]}, {"a": [1, 3]}, ["/a[1]: 2, now 3"]),
        ({"a": [1, 2]}, {"a": [1]}, ["/a: 2 entries, now 1"]),
        ({"a": "x", "seconds": 3}, {"b": "x", "seconds": 4}, ["/a: only before", "/b: only now"]),
        (np.zeros(3), np.array([0, 0, 2e-3]), [": off by 0.002"]),
        (np.arange(3), np.array([0, 1, 7]), [": 1 of 3 differ"]),
        (np.zeros(3), np.zeros(4), [": float64(3,), now float64(4,)"]),
    ],
)
def test_differences_are_named(old: object, new: object, told: list[str]) -> None:
    assert list(values_differ(old, new)) == told
