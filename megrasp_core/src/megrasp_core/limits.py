"""What one synthesis may be asked for; a module of its own, so that a program can know it before
the network's libraries are loaded.
"""

from __future__ import annotations

MAX_GRASPS = 1000
"""Most grasps that one call returns."""

MAX_EDGE = 100.0
"""Longest edge of a region (m): no hall is longer, and a bin in millimetres is."""

MAX_DRAWN = 4096
"""Most poses that one call draws."""
