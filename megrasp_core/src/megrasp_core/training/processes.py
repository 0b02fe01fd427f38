"""Several processes that train one model: each takes a part of a step's scenes, their gradients
are added up. A run starts them on its own machine, or a launcher such as torchrun does on many.

One thread a process: two threads in one process wait for each other on a busy machine.
"""

from __future__ import annotations

import ctypes
import dataclasses
import datetime
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import torch
import torch.distributed as dist
from torch import Tensor, nn

from megrasp_core.errors import InvalidRequestError, TrainingError

_MMAP_MAX, _TRIM_THRESHOLD, _TOP_PAD = -4, -1, -2
"""Parameters of glibc's `mallopt`."""


@contextmanager
def tuned_process() -> Iterator[None]:
    """Within, this process keeps the memory that it frees, and its thread rounds the smallest
    numbers to zero.

    Tensors of more than 32 MB are otherwise mapped anew, page by page, at every use, and products
    with denormal numbers take many times longer. Memory is kept where the C library is glibc.
    """
    _keep_memory(True)
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)
        _keep_memory(False)


def _keep_memory(keep: bool) -> None:
    allocator = ctypes.CDLL(None)
    if hasattr(allocator, "mallopt"):
        allocator.mallopt(_MMAP_MAX, 0 if keep else 65536)
        allocator.mallopt(_TRIM_THRESHOLD, 2**31 - 1 if keep else 2**17)
        allocator.mallopt(_TOP_PAD, 2**26 if keep else 2**17)


LAUNCHER = ("RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT")
"""Environment variables by which launchers tell a process its place."""
START = datetime.timedelta(minutes=3)
"""How long a process waits for the others to start."""
PATIENCE = datetime.timedelta(hours=1)
"""How long it waits for them later: one of them may write a checkpoint."""


class PeerLostError(TrainingError):
    """Another process of the run has ended."""


@dataclasses.dataclass(frozen=True)
class Team:
    """The processes of a run, seen from one of them.

    Attributes:
        rank: of this process; 0 writes.
        size: how many there are.
    """

    rank: int = 0
    size: int = 1

    @property
    def leads(self) -> bool:
        """Whether this one writes checkpoints and decides when to end."""
        return self.rank == 0

    @staticmethod
    def launched(environment: Mapping[str, str]) -> Team | None:
        """The processes that a launcher has started, as its variables RANK, WORLD_SIZE,
        MASTER_ADDR and MASTER_PORT tell; None where they are not all set, or this one is alone.

        Raises:
            InvalidRequestError: rank and size are no numbers that fit.
        """
        if not all(environment.get(name) for name in LAUNCHER):
            return None
        given = environment["RANK"], environment["WORLD_SIZE"]
        try:
            rank, size = map(int, given)
        except ValueError:
            rank = size = -1
        if not 0 <= rank < size:
            raise InvalidRequestError(
                f"RANK {given[0]} and WORLD_SIZE {given[1]} are set; expected the number of a "
                "process, from 0, and how many there are. Start with torchrun, or unset them."
            )
        return Team(rank, size) if size > 1 else None

    def met(self, port: int | None = None) -> Team:
        """Meet the others and wait until all are there.

        Args:
            port: of this machine; None: where the launcher's variables say.

        Raises:
            TrainingError: they are not all there in time.
        """
        rank, size = self.rank, self.size
        try:
            if port is None:
                store, _, _ = next(
                    dist.rendezvous(  # pyright: ignore[reportPrivateImportUsage]
                        "env://", rank, size, timeout=START
                    )
                )
            else:
                store = dist.TCPStore(  # pyright: ignore[reportPrivateImportUsage]
                    "127.0.0.1", port, size, rank == 0, timeout=START
                )
            dist.init_process_group(
                "gloo", store=store, rank=rank, world_size=size, timeout=PATIENCE
            )
        except (dist.DistError, RuntimeError) as error:
            raise TrainingError(
                f"{size} processes were to train together and did not meet within "
                f"{START.total_seconds():.0f} s ({error}). See what the others wrote to standard "
                "error; a script that trains needs `if __name__ == '__main__':`."
            ) from error
        return self

    def leave(self) -> None:
        """The end of the run."""
        if self.size > 1 and dist.is_initialized():
            dist.destroy_process_group()

    def slots(self, count: int) -> range:
        """Which of a step's scenes are this process's."""
        return range(self.rank, count, self.size)

    def add_up(self, parameters: Sequence[nn.Parameter], numbers: Tensor) -> Tensor:
        """Replace the gradients by their sum over all processes, and return the sum of `numbers`
        (float64).

        A parameter without a gradient in any process keeps none, so that the optimiser leaves it
        alone as it would in one process.

        Raises:
            PeerLostError: another process has ended.
        """
        if self.size == 1:
            return numbers
        here = torch.tensor([p.grad is not None for p in parameters], dtype=torch.float32)
        flat = torch.cat(
            [
                here,
                *(
                    torch.zeros(p.numel()) if p.grad is None else p.grad.flatten().cpu()
                    for p in parameters
                ),
            ]
        )
        with _together():
            dist.all_reduce(flat)
            dist.all_reduce(numbers)
        start = len(parameters)
        for parameter, somewhere in zip(parameters, flat[:start].tolist(), strict=True):
            part = flat[start : start + parameter.numel()]
            start += parameter.numel()
            if somewhere:
                parameter.grad = part.view_as(parameter).to(parameter.device)
        return numbers

    def told(self, value: list[str]) -> list[str]:
        """The leader's list, in every process.

        Raises:
            PeerLostError: another process has ended.
        """
        if self.size == 1:
            return value
        content: list[object] = [value]
        with _together():
            dist.broadcast_object_list(content, src=0)
        told = content[0]
        assert isinstance(told, list)
        return told


@contextmanager
def _together() -> Iterator[None]:
    """Within, nothing can fail but what needs the other processes."""
    try:
        yield
    except RuntimeError as error:  # the errors of torch.distributed, and gloo's own
        raise PeerLostError(
            f"a process that shares the training ended ({str(error).splitlines()[0]}). See its "
            "message on standard error, then go on with --resume."
        ) from error


def free_port() -> int:
    """A port of this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
