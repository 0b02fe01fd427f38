"""Fixtures of more than one room."""

from __future__ import annotations

from pathlib import Path

import pytest
from jaw_and_boxes import Jaw
from made_runs import library_file


@pytest.fixture
def jaw() -> Jaw:
    """A jaw of few parts."""
    return Jaw()


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A packed library, since the command that makes scenes wants one."""
    return library_file(tmp_path_factory.mktemp("library"))
