"""The helper modules of these tests must be importable in spawned processes too."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A packed library, since the command that makes scenes wants one."""
    from made_runs import library_file

    return library_file(tmp_path_factory.mktemp("library"))
