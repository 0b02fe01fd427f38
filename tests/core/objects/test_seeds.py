"""No use of procedural objects draws those of another."""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import combinations

import pytest

from megrasp_core.evaluation.object_pool import load_pool, validation_pool
from megrasp_core.objects import ObjectSeeds, training_objects, validation_objects


def seeds(names: Iterable[str]) -> set[int]:
    found = (re.search(r"procedural.*?(\d+)$", name) for name in names)
    return {int(match[1]) for match in found if match}


def test_the_ranges_share_no_seed() -> None:
    for one, other in combinations([use.value for use in ObjectSeeds], 2):
        assert one.stop <= other.start or other.stop <= one.start


def test_the_sets_share_no_object(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MEGRASP_ASSETS", raising=False)
    drawn = [
        seeds(training_objects(60).names),
        seeds(validation_objects(60).names),
        seeds(model.name for model in validation_pool(5)),
        seeds(model.name for model in load_pool(None)),
    ]
    assert [len(numbers) for numbers in drawn] == [60, 60, 5, 60]
    assert len(set.union(*drawn)) == 185


def test_validation_draws_what_it_always_drew() -> None:
    """Checkpoints of models that are there were chosen on these."""
    names = validation_objects(2, assets=False).names
    assert names == ("procedural/900000", "procedural/900001")
