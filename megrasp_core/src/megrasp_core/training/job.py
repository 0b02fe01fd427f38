"""Where a training run reads and writes, and on what it runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from megrasp_core.errors import InvalidRequestError

from .processes import Team

__all__ = ["TrainingJob"]


@dataclass(frozen=True)
class TrainingJob:
    """Where a run reads and writes, and on what it runs; nothing of it changes what is learnt.

    Attributes:
        data: folders of scene data sets, or device packs; one that still grows is read again at
            checkpoints.
        out: folder for the checkpoint, `losses.jsonl`, `losses.png` and the averaged model.
        validation: data sets of objects that training never sees; without, a tenth of the objects
            of `data` is held out.
        device: where to train.
        processes: that this run starts to share a step's scenes, one thread each; on a CPU only.
        place: this process among those that a launcher has started to share them, of which the
            first one writes; None: there was no launcher.
        seconds: of this stretch, after which the run is saved and left; None: to the end of the
            plan.
        compiled: use compiled kernels, which need numba.
    """

    data: tuple[Path, ...]
    out: Path
    validation: tuple[Path, ...] = ()
    device: str = "cpu"
    processes: int = 1
    seconds: float | None = None
    compiled: bool = False
    place: Team | None = None

    def __post_init__(self) -> None:
        if self.processes < 1 or (self.size > 1 and self.device != "cpu"):
            raise InvalidRequestError(
                f"{self.size} processes on {self.device} were asked for; expected at least one, "
                "and several only on cpu."
            )
        if self.place is not None and self.processes > 1:
            raise InvalidRequestError(
                f"{self.processes} processes were asked for in a process that a launcher has "
                "started; expected the launcher to start all of them. Leave --processes out."
            )

    @property
    def size(self) -> int:
        """How many processes train."""
        return self.processes if self.place is None else self.place.size
