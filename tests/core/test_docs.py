"""What the pages point at is there: files, headings, names of the code. What they mark as runnable
runs.
"""

from __future__ import annotations

import ast
import importlib
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = (
    "docker", "docs", "gripper_descriptions", "launch_scripts", "megrasp_core", "megrasp_ros",
    "models", "ros2_ws/src/megrasp_msgs",
)  # fmt: skip
PAGES = sorted([*ROOT.glob("*.md"), *(p for name in FOLDERS for p in (ROOT / name).rglob("*.md"))])
LINK = re.compile(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)")
FENCE = re.compile(r"^```.*?^```\n?", re.DOTALL | re.MULTILINE)
HEADING = re.compile(r"^#+ (.+?)\s*$", re.MULTILINE)
RUNNABLE = re.compile(r"<!-- runnable -->\n```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
NAME = re.compile(r"`(megrasp_core(?:\.\w+)+)`|from (megrasp_core(?:\.\w+)*) import (\w+)")


def targets(page: Path) -> Iterator[tuple[Path, str]]:
    """Every file that a page links to, and the heading in it, "" for none."""
    for link, anchor in LINK.findall(FENCE.sub("", page.read_text())):
        if "://" not in link and not link.startswith("mailto:"):
            yield (page.parent / link if link else page), anchor


def anchors(page: Path) -> set[str]:
    """What links can name of a page: its headings in small letters, without punctuation, hyphens
    for spaces.
    """
    headings = HEADING.findall(FENCE.sub("", page.read_text()))
    plain = (re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in headings)
    return {re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    missing = [str(target) for target, _ in targets(page) if not target.exists()]
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_headings(page: Path) -> None:
    missing = {
        f"{target.resolve().relative_to(ROOT)}#{anchor}"
        for target, anchor in targets(page)
        if anchor and anchor not in anchors(target)
    }
    assert not missing


def test_headings_are_found_as_they_are_linked(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# 16 cores: one `machine`\n```\n# no heading\n```\n## What [is](x.md) it?\n")
    assert anchors(page) == {"16-cores-one-machine", "what-is-it"}


WITH_BLOCKS = [page for page in PAGES if RUNNABLE.search(page.read_text())]


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_BLOCKS, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_is_marked_runnable_runs(page: Path, tmp_path: Path) -> None:
    """The marked blocks of a page one after another, in one empty folder."""
    # The command of the interpreter that runs the tests, whatever else is installed.
    programs = tmp_path / "programs"
    programs.mkdir()
    (programs / "megrasp").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m megrasp_core "$@"\n')
    (programs / "megrasp").chmod(0o755)
    path = os.pathsep.join([str(programs), str(Path(sys.executable).parent), os.environ["PATH"]])
    folder = tmp_path / "work"
    folder.mkdir()
    for language, block in RUNNABLE.findall(page.read_text()):
        program = [sys.executable, "-c"] if language == "python" else ["bash", "-euc"]
        done = subprocess.run(
            [*program, block],
            cwd=folder, env=os.environ | {"PATH": path},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, f"{block}\n{done.stdout}\n{done.stderr}"


def test_pages_have_blocks_that_run() -> None:
    assert ROOT / "docs" / "start.md" in WITH_BLOCKS


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


def described(file: Path) -> Iterator[str]:
    """Every docstring of a file, those after constants included."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            yield str(node.value.value)


@pytest.mark.parametrize("package", ["megrasp_core/src", "megrasp_ros/megrasp_ros"])
def test_files_that_docstrings_name_are_there(package: str) -> None:
    folders = ("docs", "launch_scripts", "megrasp_core/src", "megrasp_ros/megrasp_ros", "tests")
    there = [f"/{path.relative_to(ROOT)}" for name in folders for path in (ROOT / name).rglob("*")]
    missing = [
        f"{file.relative_to(ROOT)}: {name}"
        for file in sorted((ROOT / package).rglob("*.py"))
        for text in described(file)
        for name in re.findall(r"(?<![\w*<])(?:[a-z_][\w/]*\.py|docs/[\w/-]+\.md)\b", text)
        if not any(path.endswith(f"/{name}") for path in there)
    ]
    assert not missing
