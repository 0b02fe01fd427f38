"""`megrasp objects generate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from megrasp_core.cli.common import progress_bar, say

__all__ = ["generate"]


def generate(
    destination: tyro.conf.Positional[Path],
    count: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 20,
    seed: int = 0,
) -> int:
    """Write procedural objects, one folder each.

    Try: megrasp objects generate my_objects -n 50 --seed 3

    Args:
        destination: folder that the object folders go into.
        count: how many.
        seed: of the first; the others follow.
    """
    from megrasp_core.objects import generate_objects

    with progress_bar(count, "objects") as bar:
        folders = generate_objects(destination, count, seed, lambda done, total: bar.update())
    say(f"wrote {len(folders)} objects to {destination}")
    return 0
