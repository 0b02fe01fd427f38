"""Grippers of the family by name: a name holds kind and seed, so it is enough to make the gripper
again.
"""

from __future__ import annotations

import functools
import re
import tempfile
from pathlib import Path

from megrasp_core.grippers.gripper import Gripper

from .draw import draw_parameters
from .ranges import FAMILY_KINDS
from .sample import name_of, sample_gripper
from .writing import write_gripper

_NAME = re.compile(rf"({'|'.join(FAMILY_KINDS)})_(\d{{6}})")


def procedural_gripper_name(seed: int) -> str:
    """Name of the gripper of a seed, such as `angular_000042`."""
    return name_of(draw_parameters(seed))


def procedural_rack(count: int) -> list[str]:
    """Names of the grippers of the seeds 0 to `count` - 1."""
    return [procedural_gripper_name(seed) for seed in range(count)]


def is_procedural(name: str) -> bool:
    """Whether a name is one of the family's."""
    return _NAME.fullmatch(name) is not None


def load_procedural(name: str) -> Gripper | None:
    """The gripper of a name of the family, made anew; None for any other name."""
    match = _NAME.fullmatch(name)
    if match is None:
        return None
    description, model = sample_gripper(int(match[2]), match[1])
    return Gripper.from_path(write_gripper(Path(_folder().name), description, model))


@functools.lru_cache(maxsize=1)
def _folder() -> tempfile.TemporaryDirectory[str]:
    """Where this process keeps their files: a loaded gripper reads its own again for its hash."""
    return tempfile.TemporaryDirectory(prefix="megrasp_grippers_", ignore_cleanup_errors=True)
