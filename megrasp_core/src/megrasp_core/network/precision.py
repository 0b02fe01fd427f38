"""Whether sixteen bits are faster than thirty-two on a device."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import torch

_FLAGS = frozenset({"avx512_bf16", "amx_bf16", "bf16"})
"""Of processors that multiply bfloat16 themselves (x86-64 and, last, ARM); elsewhere it is
emulated, which takes longer than float32."""


def low_precision_pays(device: str | torch.device) -> bool:
    """Whether bfloat16 in the token part saves time on a device."""
    if torch.device(device).type == "cuda":
        return torch.cuda.is_bf16_supported()
    return bool(_FLAGS & _processor_flags())


@lru_cache(maxsize=1)
def _processor_flags() -> frozenset[str]:
    """Of the processor, as Linux tells them; none elsewhere."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return frozenset()
    for line in lines:
        name, _, value = line.partition(":")
        if name.strip() in ("flags", "Features"):
            return frozenset(value.split())
    return frozenset()
