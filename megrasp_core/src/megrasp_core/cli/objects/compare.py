"""`megrasp objects compare`."""

from __future__ import annotations

from pathlib import Path

import tyro

from megrasp_core.cli.common import emit

__all__ = ["compare"]


def compare(
    prepared: tyro.conf.Positional[Path],
    reference: tyro.conf.Positional[Path],
    out: Path | None = None,
) -> int:
    """Compare convex pieces of objects with those of others of the same names.

    Try: megrasp objects compare my_objects reference --out pieces.json

    Args:
        prepared: folder of objects.
        reference: folder of objects, at any depth.
        out: result file (JSON); standard output without it.
    """
    from megrasp_core.benchmarks.object_pieces import compare_pieces

    emit(compare_pieces(prepared, reference), out)
    return 0
