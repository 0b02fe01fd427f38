"""Finds damage in scene data sets, names it, and moves it aside without losing what is whole."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from megrasp_core.errors import DataError

from .files import DamagedError, NpzFile, leftovers, open_npz, set_aside, write_npz
from .inspection import record_problems
from .records import SceneRecord
from .scene_dataset import SCENE_NAME, read_manifest, read_record, scene_files, shard_names

Progress = Callable[[int, int], object]


@dataclass(frozen=True)
class Damage:
    """Something about a file of a data folder.

    Attributes:
        file: which.
        problem: what is wrong, in words.
        lost: what in it cannot be used, as far as known: names of scenes, or pairs.
        kept: what in it is whole none the less.
        damaged: whether it must be made anew; otherwise it is worth knowing, no more.
    """

    file: Path
    problem: str
    lost: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()
    damaged: bool = True

    def __str__(self) -> str:
        lost = f"; lost: {_spans(self.lost)}" if self.lost else ""
        kept = f"; whole: {len(self.kept)} others" if self.kept else ""
        return f"{'damaged' if self.damaged else 'note'}: {self.file}: {self.problem}{lost}{kept}"


def verify_dataset(folder: str | Path, on_progress: Progress | None = None) -> list[Damage]:
    """Reads every byte of a scene data set; what is wrong with it, damage first.

    Args:
        folder: data set folder; it may grow meanwhile.
        on_progress: called with files read and files in all.

    Raises:
        DataError: the data set is of another version.
    """
    folder = Path(folder)
    found: list[Damage] = []
    known: set[str] = set()
    counted = 0
    try:
        manifest = read_manifest(folder)
        known = set(map(str, manifest.get("grippers") or ()))
        counted = int((manifest.get("counts") or {}).get("scenes", 0))
    except DamagedError as error:
        found.append(Damage(folder / "manifest.json", error.why))
    except DataError:
        if (folder / "manifest.json").exists():
            raise
        found.append(Damage(folder / "manifest.json", "it is missing"))
    names: set[str] = set()
    files = [path for part in scene_files(folder) for path in part]
    for number, path in enumerate(files):
        try:
            finding, whole = check_scenes(path, lambda record: record_problems(record, known))
        except OSError as error:
            finding, whole = Damage(path, f"it cannot be read ({error})"), []
        names.update(whole)
        if finding is not None:
            found.append(finding)
        if on_progress is not None:
            on_progress(number + 1, len(files))
    if len(names) < counted and not any(finding.lost for finding in found):
        text = f"it counts {counted} scenes, {len(names)} are there"
        found.append(Damage(folder / "manifest.json", text, damaged=False))
    return found + unfinished(folder)


def check_scenes(
    path: Path, problems: Callable[[SceneRecord], list[str]]
) -> tuple[Damage | None, list[str]]:
    """Reads a loose scene or a shard.

    Args:
        path: the file.
        problems: says what is wrong with a record that can be read.

    Returns:
        What is wrong with the file, None where nothing is, and the names of its whole scenes.

    Raises:
        OSError: it cannot be read, which says nothing about what it holds.
    """
    loose = path.stem.startswith("scene_")
    wrong: list[str] = []
    whole: list[str] = []
    lost: list[str] = []
    try:
        with open_npz(path) as file:
            if not loose:
                wrong.extend(_index_problems(file))
            for name in [path.stem] if loose else _scenes_in(file):
                try:
                    record = read_record(file, "" if loose else f"{name}/", name)
                    faults = _faults(record, problems)
                except DamagedError as error:
                    faults = [error.why]
                wrong.extend(f"{name}: {fault}" for fault in faults)
                (lost if faults else whole).append(name)
    except DataError as error:
        if not path.exists():
            # A generator at work has moved the scene into a shard.
            return None, []
        wrong = [error.why if isinstance(error, DamagedError) else str(error)]
        lost, whole = [path.stem] if loose else _names_in_bytes(path), []
    if not wrong:
        return None, whole
    more = f" and {len(wrong) - 3} more" if len(wrong) > 3 else ""
    return Damage(path, "; ".join(wrong[:3]) + more, tuple(lost), tuple(whole)), whole


def move_aside(finding: Damage, folder: Path) -> Path | None:
    """Moves a damaged file to `<folder>/damaged/`, once the whole scenes of a shard are written as
    files of their own; its new path, None where there is no file.
    """
    if not finding.file.exists():
        return None
    if finding.kept:
        with open_npz(finding.file) as file:
            for name in finding.kept:
                target = folder / "scenes" / f"{name}.npz"
                if not target.exists():
                    part = [key for key in file if key.startswith(f"{name}/")]
                    write_npz(target, {key.partition("/")[2]: file[key] for key in part})
    return set_aside(finding.file, folder)


def unfinished(folder: Path) -> list[Damage]:
    """Notes of what killed runs were writing."""
    text = "not finished by a run that was killed or is still at work; no reader minds it"
    return [Damage(path, text, damaged=False) for path in leftovers(folder)]


def _faults(record: SceneRecord, problems: Callable[[SceneRecord], list[str]]) -> list[str]:
    try:
        return problems(record)
    except (ValueError, TypeError, IndexError) as error:
        return [f"its arrays do not fit together ({error})"]


def _index_problems(file: NpzFile) -> list[str]:
    try:
        missing = set(_scenes_in(file)) ^ set(shard_names(file))
    except DamagedError as error:
        return [error.why]
    return [f"its list of scenes is wrong about {_spans(missing)}"] if missing else []


def _scenes_in(file: NpzFile) -> list[str]:
    """Names of the scenes in a shard, from its arrays, in their order."""
    return list(dict.fromkeys(key.partition("/")[0] for key in file if "/" in key))


def _names_in_bytes(path: Path) -> list[str]:
    """Names of the scenes in a shard that cannot be opened: they stand before every array."""
    found = re.finditer(rb"%b(?=/)" % SCENE_NAME.encode(), path.read_bytes())
    return sorted({name[0].decode() for name in found})


def _spans(names: Iterable[str]) -> str:
    """Names, those of consecutive scenes joined."""

    def place(item: tuple[int, str]) -> str | int:
        digits = re.fullmatch(SCENE_NAME, item[1])
        return int(digits[1]) - item[0] if digits else item[1]

    parts: list[str] = []
    for _, group in groupby(enumerate(sorted(names)), place):
        run = [name for _, name in group]
        parts.append(run[0] if len(run) == 1 else f"{run[0]} to {run[-1]} ({len(run)})")
    return ", ".join(parts)
