"""Pieces of objects against those of others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from megrasp_core.benchmarks.object_pieces import compare_pieces
from megrasp_core.errors import ObjectError
from megrasp_core.objects import ConvexPiece, procedural_object, save_object


def test_pieces_that_cover_less_have_a_smaller_share(tmp_path: Path) -> None:
    whole = procedural_object(0)
    small = tuple(ConvexPiece(0.5 * vertices, faces) for vertices, faces in whole.pieces)
    for root, model in (("ours", replace(whole, pieces=small)), ("theirs/set", whole)):
        save_object(model, tmp_path / root / "thing")
    save_object(whole, tmp_path / "ours" / "other")
    found = compare_pieces(tmp_path / "ours", tmp_path / "theirs")["objects"]
    assert list(found) == ["thing"]
    assert found["thing"]["pieces"] == [len(whole.pieces)] * 2
    assert found["thing"]["covered"][0] < 0.9 and found["thing"]["covered"][1] == 1.0
    ours, theirs = found["thing"]["litres"]
    assert ours == pytest.approx(theirs / 8.0, rel=0.01)
    with pytest.raises(ObjectError, match=r"no object of .* has the name of one of"):
        compare_pieces(tmp_path / "ours" / "other", tmp_path / "theirs")
