"""Colours of cloud files as shares of 1."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def as_shares(values: NDArray, dtype: np.dtype) -> NDArray[np.float64]:
    """Colours (N, 3) in 0..1 of values of a type; whole numbers are shares of its largest."""
    scale = float(np.iinfo(dtype).max) if np.issubdtype(dtype, np.integer) else 1.0
    return values.astype(np.float64) / scale


def unpacked(packed: NDArray[np.uint32]) -> NDArray[np.float64]:
    """Colours (N, 3) in 0..1 of numbers 0xRRGGBB (N,)."""
    return np.stack([(packed >> shift) & 255 for shift in (16, 8, 0)], axis=1) / 255.0


def packed(colors: NDArray[np.float64]) -> NDArray[np.uint32]:
    """Numbers 0xRRGGBB (N,) of colours (N, 3) in 0..1."""
    steps = np.rint(255.0 * np.clip(colors, 0.0, 1.0)).astype(np.uint32)
    return np.asarray((steps[:, 0] << 16) | (steps[:, 1] << 8) | steps[:, 2], np.uint32)
