"""The grippers that the node can use: found by name, loaded once, read within a time limit.

Names come from clients, so nothing here may block for ever, grow without bound, or tell what is in
a file that is no gripper.yaml.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from megrasp_core.errors import DescriptionError
from megrasp_ros.bounded import StillRunningError, bounded
from megrasp_ros.errors import UnknownNameError, shortened

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

MOST = 64
"""Grippers that are kept loaded."""

SLICE = 0.1
"""How often somebody who waits looks up (s)."""

LOOK = 5.0
"""Longest time (s) to look what there is, and"""

LOAD = 60.0
"""to load a gripper."""

T = TypeVar("T")
Paths = Sequence[str]
Check = Callable[[], None]


class GripperShelf:
    """Finds, loads and keeps grippers; may be used from any thread."""

    def __init__(self) -> None:
        self._kept: OrderedDict[str, Gripper] = OrderedDict()
        self._loading: dict[str, threading.Event] = {}
        self._given_up: set[str] = set()
        self._lock = threading.Lock()

    def names(self, paths: Paths) -> list[str]:
        """Return the registered names. Raises DescriptionError when the folders cannot be read."""
        return list(self._folders(paths))

    def locate(self, name: str, paths: Paths, *, allow_paths: bool) -> str:
        """Return where a gripper is: its folder, its file, or the name of a procedural one.

        Raises UnknownNameError; DescriptionError when it cannot be looked up.
        """
        from megrasp_core.grippers import is_procedural

        folders = self._folders(paths)
        if name in folders:
            return str(folders[name])
        if is_procedural(name):
            return name
        if allow_paths and ("/" in name or name.startswith("~")):
            file = self._look(lambda: _description_file(name), name)
            if file is not None:
                return str(file)
        raise UnknownNameError(name, folders, allow_paths=allow_paths)

    def load(
        self,
        name: str,
        paths: Paths,
        *,
        allow_paths: bool = False,
        seconds: float = LOAD,
        check: Check | None = None,
    ) -> Gripper:
        """Return a gripper, loaded once.

        Args:
            name: registered, or of the procedural family; with `allow_paths` a folder, too.
            paths: further folders of grippers.
            allow_paths: see `name`.
            seconds: longest time for reading it.
            check: called again and again while it is read; may raise.

        Raises:
            UnknownNameError, DescriptionError, and what `check` raises.
        """
        place = self.locate(name, paths, allow_paths=allow_paths)
        end = time.monotonic() + seconds
        while True:
            with self._lock:
                if place in self._kept:
                    self._kept.move_to_end(place)
                    return self._kept[place]
                read = self._loading.get(place)
                if read is None:
                    read = self._loading[place] = threading.Event()
                    break
            # Somebody else is reading it.
            while not read.wait(SLICE):
                if check is not None:
                    check()
                if place in self._given_up or time.monotonic() > end:
                    raise _unreadable(name, "an earlier attempt is still going on")
        return self._read(place, name, paths, end - time.monotonic(), check)

    def forget(self) -> None:
        """Read descriptions from disk again when they are next needed."""
        with self._lock:
            self._kept.clear()

    def _read(
        self, place: str, name: str, paths: Paths, seconds: float, check: Check | None
    ) -> Gripper:
        from megrasp_core.grippers import gripper_folders, load_gripper

        def read() -> Gripper:
            try:
                registered = name in gripper_folders(paths)
                gripper = load_gripper(name if registered else place, paths)
                # Reads the files of the model once more.
                _ = gripper.hash
                with self._lock:
                    self._keep(place, gripper)
                return gripper
            finally:
                with self._lock:
                    self._given_up.discard(place)
                    self._loading.pop(place).set()

        try:
            return bounded(read, seconds, check)
        except StillRunningError as error:
            with self._lock:
                if place in self._loading:
                    self._given_up.add(place)
            raise _unreadable(name, str(error)) from None
        except OSError as error:
            raise _unreadable(name, f"{type(error).__name__}: {error.strerror}") from error

    def _keep(self, place: str, gripper: Gripper) -> None:
        self._kept[place] = gripper
        while len(self._kept) > MOST:
            self._kept.popitem(last=False)

    def _folders(self, paths: Paths) -> dict[str, Path]:
        # Outside the time limit: the first import takes longer than any disk.
        from megrasp_core.grippers import gripper_folders

        return self._look(lambda: gripper_folders(paths), ", ".join(paths))

    def _look(self, call: Callable[[], T], what: str) -> T:
        try:
            return bounded(call, LOOK)
        except StillRunningError as error:
            raise _unreadable(what, str(error)) from None
        except (OSError, RuntimeError, ValueError) as error:
            raise _unreadable(what, str(error)) from error


def _description_file(name: str) -> Path | None:
    """Return the gripper.yaml that a path leads to, None when there is none."""
    from megrasp_core.grippers import FILE_NAME

    try:
        path = Path(name).expanduser()
        file = (path / FILE_NAME if path.is_dir() else path).resolve(strict=True)
    except (OSError, RuntimeError, ValueError):
        return None
    # No other file is opened, a link to one included.
    return file if file.name == FILE_NAME and file.is_file() else None


def _unreadable(what: str, why: str) -> DescriptionError:
    return DescriptionError(
        f"{shortened(what, 200)!r} cannot be read ({shortened(why, 200)}); expected folders with "
        "a gripper.yaml on a disk that answers. Check the parameters gripper and gripper_paths."
    )
