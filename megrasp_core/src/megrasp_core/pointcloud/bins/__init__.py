"""Finding a bin in a cloud: rim, walls, depth, fill."""

from .find import find_bin
from .found import DepthFrom, FoundBin
from .settings import BinSettings

__all__ = ["BinSettings", "DepthFrom", "FoundBin", "find_bin"]
