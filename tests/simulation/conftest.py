"""Fixtures of the simulation tests."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

# Tests are imported by path (import mode importlib); their helper module needs sys.path.
sys.path.insert(0, str(Path(__file__).parent))

from jaw_and_boxes import Jaw


@pytest.fixture
def jaw() -> Jaw:
    """Return the jaw."""
    return Jaw()
