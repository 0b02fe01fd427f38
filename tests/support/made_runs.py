"""The `megrasp` command in processes of its own, on scenes and pairs that cost next to nothing.

Scenes are those of `dataset_records`, pairs those of `made_library`; all around them is the real
thing: command line, executors, files, signals. The processes are forked from a server that has
everything imported.
"""

from __future__ import annotations

import ctypes
import fnmatch
import functools
import logging
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path

from dataset_records import record
from executor_units import slow
from made_library import made_library, made_set

from megrasp_core.jobs import run_units
from megrasp_core.library import LabelSettings, pack_library
from megrasp_core.scenes import generate_scenes
from megrasp_core.storage import GraspSet, SceneDataset, SceneRecord
from megrasp_core.storage.scene_dataset import record_arrays

GRIPPER = "robotiq_2f85"
SCENES = 12
SHARD = 4
NO_DISK = 77


def scenes_command(out: Path, library: Path, workers: int = 1) -> list[str]:
    """Make `SCENES` scenes, in shards of `SHARD`."""
    return [
        *("data", "scenes", "--out", str(out), "--library", str(library)),
        *("-n", str(SCENES), "--workers", str(workers)),
        *("--gripper", GRIPPER, "--procedural", "2", "--no-assets"),
    ]


def grasps_command(out: Path) -> list[str]:
    """Label six objects."""
    return [
        *("data", "grasps", "--out", str(out), "--gripper", GRIPPER),
        *("--procedural", "6", "--no-assets"),
    ]


def library_file(folder: Path) -> Path:
    """A library, since the command wants one."""
    pack_library(made_library(), folder)
    return folder / f"{GRIPPER}.npz"


def made_record(seed: int) -> SceneRecord:
    """What takes the place of a built scene."""
    made = record(seed)
    return replace(made, labels={GRIPPER: made.labels["first"]})


def made_pair(unit: tuple[str, str]) -> GraspSet:
    """What takes the place of the labels of a pair."""
    from megrasp_core.library import cached_gripper

    number = int(unit[1][-1])
    tried = LabelSettings().trials  # or the next run would make it anew
    entry = made_set(unit[0], unit[1], 3 + number, ("slipped",) * number, 2 * tried, tried)
    return replace(entry, gripper_hash=cached_gripper(unit[0]).hash)


def contents(folder: Path) -> dict[str, list[tuple[str, bytes]]]:
    """Every array of every scene of a data set, to compare bit for bit."""
    return {
        one.name: [(key, value.tobytes()) for key, value in record_arrays(one).items()]
        for one in SceneDataset(folder)
    }


class Run:
    """One command under way.

    Args:
        command: what to run.
        pace: seconds a scene or pair takes.
        death: ("replace" or "unlink", pattern, n): the process is killed by SIGKILL where it would
            rename or delete the n-th file of such a name.
        limit: largest file that the process may write (bytes).
        disk: (folder, size, copy): a file system of that size lies at `folder` for the process
            alone, and is copied in the end; `NO_DISK` is the exit code where none can be mounted.
    """

    def __init__(
        self,
        command: list[str],
        *,
        pace: float = 0.0,
        death: tuple[str, str, int] | None = None,
        limit: int | None = None,
        disk: tuple[Path, str, Path] | None = None,
    ) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["megrasp_core.cli", "megrasp_core.scenes"])
        self._reader, writer = context.Pipe(duplex=False)
        os.set_blocking(self._reader.fileno(), False)
        self._said = b""
        arguments = (command, writer, pace, death, limit, disk)
        self._process = context.Process(target=_inside, args=arguments)
        self._process.start()
        writer.close()

    @property
    def pid(self) -> int:
        """Of the process, and of its group."""
        assert self._process.pid is not None
        return self._process.pid

    def ended(self, seconds: float = 60.0) -> int:
        """Its exit code, or minus the signal that ended it."""
        self._process.join(seconds)
        assert self._process.exitcode is not None, f"still at work; it said {self.said()}"
        return self._process.exitcode

    def said(self) -> str:
        """Standard output and standard error."""
        with suppress(BlockingIOError):
            while more := os.read(self._reader.fileno(), 65536):
                self._said += more
        return self._said.decode()

    def workers(self) -> list[int]:
        """Process numbers of its workers."""
        found = []
        for entry in Path("/proc").iterdir():
            if not entry.name.isdigit():
                continue
            try:
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                words = (entry / "cmdline").read_bytes()
            except (OSError, IndexError, ValueError):
                continue
            if parent == self.pid and b"spawn_main" in words:
                found.append(int(entry.name))
        return found


def until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.01)


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and waits to be collected does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (OSError, IndexError):
        return False


def _inside(
    command: list[str],
    writer: Connection,
    pace: float,
    death: tuple[str, str, int] | None,
    limit: int | None,
    disk: tuple[Path, str, Path] | None,
) -> None:
    os.setsid()
    os.dup2(writer.fileno(), 1)
    os.dup2(writer.fileno(), 2)
    sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
    signal.signal(signal.SIGINT, signal.default_int_handler)
    logging.getLogger().handlers.clear()
    if disk is not None:
        try:
            _mount(*disk[:2])
        except OSError as error:
            sys.stderr.write(f"{error}\n")
            sys.stderr.flush()
            os._exit(NO_DISK)
    if limit is not None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    if death is not None:
        _die_at(*death)
    code = _run(command, pace)
    if disk is not None:
        shutil.copytree(disk[0], disk[2])
    sys.exit(code)


def _run(command: list[str], pace: float) -> int:
    """The command with made-up scenes and pairs."""
    from megrasp_core import scenes
    from megrasp_core.cli import main
    from megrasp_core.library import labelling
    from megrasp_core.scenes import generation

    def cheap(make, function, units, config=None, *, on_result, on_progress=None):
        return run_units(
            functools.partial(slow, seconds=pace),
            units,
            config,
            on_result=lambda unit, _: on_result(unit, make(unit)),
            on_progress=on_progress,
        )

    generation.run_units = functools.partial(cheap, made_record)
    labelling.run_units = functools.partial(cheap, made_pair)
    scenes.generate_scenes = functools.partial(generate_scenes, shard_size=SHARD)
    return main(command)


def _die_at(what: str, pattern: str, count: int) -> None:
    original, seen = getattr(Path, what), []

    def deadly(self: Path, *args, **options):
        if fnmatch.fnmatch(self.name, pattern) and self.exists():
            seen.append(self)
            if len(seen) == count:
                os.kill(os.getpid(), signal.SIGKILL)
        return original(self, *args, **options)

    setattr(Path, what, deadly)


def _mount(folder: Path, size: str) -> None:
    """A small file system at `folder`, for this process; root is not needed where user namespaces
    are allowed.
    """
    user, group = os.getuid(), os.getgid()
    library = ctypes.CDLL(None, use_errno=True)

    def checked(result: int) -> None:
        if result:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))

    new_user, new_mounts = 0x10000000, 0x00020000
    checked(library.unshare(new_user | new_mounts))
    Path("/proc/self/setgroups").write_text("deny")
    Path("/proc/self/uid_map").write_text(f"0 {user} 1")
    Path("/proc/self/gid_map").write_text(f"0 {group} 1")
    options = f"size={size}".encode()
    checked(library.mount(b"disk", str(folder).encode(), b"tmpfs", 0, options))
