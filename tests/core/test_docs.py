"""What the pages point at is there: files, and names of the code."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = (
    "docs", "gripper_descriptions", "launch_scripts", "megrasp_core", "megrasp_ros", "models",
    "ros2_ws/src/megrasp_msgs",
)  # fmt: skip
PAGES = sorted([*ROOT.glob("*.md"), *(p for name in FOLDERS for p in (ROOT / name).rglob("*.md"))])
LINK = re.compile(r"\]\(([^)#\s]+)(#[^)\s]*)?\)")
NAME = re.compile(r"`(megrasp_core(?:\.\w+)+)`|from (megrasp_core(?:\.\w+)*) import (\w+)")


def targets(page: Path) -> Iterator[Path]:
    """Every file that a page links to."""
    for link, _ in LINK.findall(page.read_text()):
        if "://" not in link and not link.startswith("mailto:"):
            yield page.parent / link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    missing = [str(target) for target in targets(page) if not target.exists()]
    assert not missing


def test_names_of_the_code_exist() -> None:
    checked = 0
    for page in PAGES:
        for dotted, module, name in NAME.findall(page.read_text()):
            whole = dotted or f"{module}.{name}"
            assert _exists(whole), f"{page.relative_to(ROOT)} names {whole}"
            checked += 1
    assert checked > 5


def _exists(dotted: str) -> bool:
    try:
        importlib.import_module(dotted)
    except ImportError:
        module, _, name = dotted.rpartition(".")
        return bool(module) and hasattr(importlib.import_module(module), name)
    return True
