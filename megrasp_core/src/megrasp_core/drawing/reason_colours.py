"""Colours of the reasons against grasps, the same in every picture."""

from __future__ import annotations

from types import MappingProxyType

__all__ = ["RETURNED", "reason_colour"]

RETURNED = "#149a49"
_COLOURS = MappingProxyType(
    {
        "": RETURNED,
        "collision": "#d62728",
        "unseen": "#7b4bb3",
        "workspace": "#1f4e9c",
        "tilt": "#17a2b8",
        "empty": "#8c6d31",
        "sweep": "#ff7f0e",
        "object": "#c2185b",
        "excluded": "#555555",
        "score": "#e0b000",
        "duplicate": "#8fbf8f",
        "surplus": "#b9d7b9",
        "unrefined": "#c8c8c8",
    }
)


def reason_colour(reason: str) -> str:
    """#rrggbb of a reason of `REASONS`; "" is a returned grasp."""
    return _COLOURS.get(reason, "#000000")
