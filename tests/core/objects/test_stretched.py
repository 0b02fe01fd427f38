"""Stretched copies are solid, balanced on their centre of mass, and held out with their source."""

from __future__ import annotations

import numpy as np
import pytest

from megrasp_core.errors import ObjectError
from megrasp_core.evaluation import object_pool
from megrasp_core.objects import (
    ObjectSet,
    mass_properties,
    procedural_object,
    stretched,
    stretched_name,
    training_objects,
    volume_of,
)
from megrasp_core.training import is_held_out

NUMBERS = range(12)


@pytest.mark.parametrize("number", NUMBERS)
def test_mass_and_inertia_are_those_of_the_stretched_pieces(number: int) -> None:
    model = procedural_object(number)
    copy = stretched(model, number)
    found = mass_properties(copy.pieces)
    before = mass_properties(model.pieces)
    assert found.volume > 0
    assert volume_of(copy.vertices, copy.faces) == pytest.approx(found.volume, rel=0.02)
    assert np.allclose(found.centre, 0.0, atol=1e-6)
    assert np.allclose(copy.inertia, found.inertia * copy.mass / found.volume, rtol=1e-6)
    growth = found.volume / before.volume
    assert copy.mass == pytest.approx(np.clip(model.mass * growth, 0.02, 1.5))


def test_copies_differ_and_come_again() -> None:
    model = procedural_object(3)
    copies = [stretched(model, number) for number in NUMBERS]
    assert len({tuple(copy.extents.round(6)) for copy in copies}) == len(copies)
    again = stretched(model, 5)
    assert np.array_equal(again.vertices, copies[5].vertices)
    factors = [copy.vertices[:, 0] / model.vertices[:, 0] for copy in copies]
    mirrored = [bool(np.median(factor) < 0) for factor in factors]
    assert 0 < sum(mirrored) < len(copies)


def test_a_set_brings_a_copy_back_by_its_name() -> None:
    name = stretched_name("procedural/000004", 9)
    assert np.array_equal(
        ObjectSet([name])[name].vertices, stretched(procedural_object(4), 9).vertices
    )
    with pytest.raises(ObjectError, match="stretched/<number>/<name of another>"):
        ObjectSet([])["stretched/000001/nothing"]


def test_a_copy_is_held_out_with_its_source() -> None:
    sources = [f"asset/train/ycb/{number}" for number in range(60)]
    held = [is_held_out(source) for source in sources]
    assert 0 < sum(held) < 60
    assert [is_held_out(stretched_name(source, 7)) for source in sources] == held


def test_training_objects_hold_other_copies_for_another_start(
    monkeypatch: pytest.MonkeyPatch, tmp_path
) -> None:
    monkeypatch.setenv("MEGRASP_ASSETS", str(tmp_path))
    monkeypatch.setattr(
        "megrasp_core.objects.object_set.asset_names", lambda split: ["asset/a", "asset/b"]
    )
    first, second = (training_objects(1, copies=3, start=start).names for start in (0, 7))
    assert first[:2] == second[:2] == ("asset/a", "asset/b")
    copies = [set(names[2:-1]) for names in (first, second)]
    assert [len(group) for group in copies] == [6, 6]
    assert not copies[0] & copies[1]
    assert all(name.endswith(("asset/a", "asset/b")) for group in copies for name in group)
    assert (first[-1], second[-1]) == ("procedural/000000", "procedural/000007")


def test_the_pool_of_the_score_holds_copies_of_each_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    # A procedural object stands for a scan, so that no assets are needed.
    monkeypatch.setattr(object_pool, "asset_names", lambda split: ["procedural/000001"])
    pool = object_pool.validation_pool(2, copies=3)
    scan = procedural_object(1)
    expected = [scan, *(stretched(scan, number) for number in range(3))]
    for model, other in zip(pool, expected):
        assert np.array_equal(model.vertices, other.vertices)
    assert len(pool) == 6
