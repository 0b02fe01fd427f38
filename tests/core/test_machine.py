"""What says that memory was not enough."""

import numpy as np
import pytest
import torch

from megrasp_core.machine import is_out_of_memory


@pytest.mark.parametrize(
    "ask",
    [
        lambda: torch.empty(2**60, dtype=torch.uint8),
        lambda: np.empty(2**60, dtype=np.uint8),
        lambda: (_ for _ in ()).throw(MemoryError()),
        lambda: (_ for _ in ()).throw(torch.OutOfMemoryError("CUDA out of memory.")),
    ],
)
def test_full_memory_is_told_apart(ask):
    with pytest.raises((MemoryError, RuntimeError)) as error:
        next(ask(), None)
    assert is_out_of_memory(error.value)


def test_other_errors_are_not_that():
    assert not is_out_of_memory(RuntimeError("shapes do not fit"))
    assert not is_out_of_memory(ValueError("out of memory"))
