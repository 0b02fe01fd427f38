"""Tools that hold by suction: told apart from grippers, and refused."""

from __future__ import annotations

NO_SUCTION = "suction tools are not supported; grippers need two fingers that close"
