"""Why these grasps, and why not there: one synthesis, explained (docs/explain.md)."""

from .explain import Explanation, explain, refused
from .near_miss import NearMiss, near_misses
from .page import write_explanation
from .setup_findings import SetupFindings, setup_findings

__all__ = [
    "Explanation",
    "NearMiss",
    "SetupFindings",
    "explain",
    "near_misses",
    "refused",
    "setup_findings",
    "write_explanation",
]
