"""The tables of packed and pile in docs/evaluation.md:
`python -m megrasp_core.cli.clutter_page docs/evaluation.md docs/results/clutter_*.json`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from megrasp_core.evaluation.clutter_removal.table import clutter_tables

from .common import block_writer

__all__ = ["MARK"]

MARK = "clutter"

if __name__ == "__main__":
    page, *files = (Path(argument) for argument in sys.argv[1:])
    results = [json.loads(file.read_text()) for file in files]
    block_writer(page, MARK)(clutter_tables(results))
