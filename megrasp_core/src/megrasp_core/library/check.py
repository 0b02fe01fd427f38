"""Finds damage in grasp libraries and names it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from megrasp_core.errors import MegraspError
from megrasp_core.grippers import load_gripper
from megrasp_core.storage import DamagedError, GraspSet, open_npz, unfinished
from megrasp_core.storage.codec import QUATERNION
from megrasp_core.storage.integrity import Damage, Progress

from .grasp_library import library_files, pair_file, read_sets


def verify_library(path: str | Path, on_progress: Progress | None = None) -> list[Damage]:
    """Reads every byte of a grasp library; what is wrong with it, damage first.

    Labels of another version of a gripper's description are no damage, but a note says so.

    Args:
        path: packed file, folder of such, or folder of `megrasp data grasps`.
        on_progress: called with files read and files in all.

    Raises:
        DataError: there is no library, or it is of another version.
    """
    path = Path(path)
    files = library_files(path)
    found: list[Damage] = []
    where: dict[tuple[str, str], Path] = {}
    hashes: Counter[tuple[str, str]] = Counter()
    for number, file in enumerate(files):
        try:
            sets = read_sets(file)
            problems = _problems(file, sets)
        except DamagedError as error:
            sets, problems = [], [error.why]
        except OSError as error:
            sets, problems = [], [f"it cannot be read ({error})"]
        if problems:
            found.append(Damage(file, "; ".join(problems), _pairs(file, sets)))
        for entry in sets:
            hashes[entry.gripper, entry.gripper_hash] += 1
            pair = (entry.gripper, entry.object_name)
            if pair in where:
                text = f"{_pair(entry)} lies in {where[pair]} too; the later file counts"
                found.append(Damage(file, text, damaged=False))
            where[pair] = file
        if on_progress is not None:
            on_progress(number + 1, len(files))
    found.sort(key=lambda finding: not finding.damaged)
    return found + _versions(path, hashes) + (unfinished(path) if path.is_dir() else [])


def _problems(file: Path, sets: list[GraspSet]) -> list[str]:
    problems: list[str] = []
    with open_npz(file) as arrays:
        norm = np.linalg.norm(arrays["quaternion"] / QUATERNION, axis=1)
    if len(norm) and np.abs(norm - 1.0).max() > 1e-3:
        problems.append("some quaternions are not of unit length")
    for entry in sets:
        problems.extend(f"{_pair(entry)}: {problem}" for problem in _set_problems(entry))
    if "__" in file.stem and len(sets) == 1:
        expected = pair_file(Path(), sets[0].gripper, sets[0].object_name)
        if file.parts[-2:] != expected.parts:
            problems.append(f"it holds {_pair(sets[0])}, whose file is {expected}")
    return problems


def _set_problems(entry: GraspSet) -> list[str]:
    problems: list[str] = []
    if ((entry.reason == "") != entry.success).any():
        problems.append("successes have a reason for failing, or failures have none")
    if (entry.quality[~entry.success] != 0).any():
        problems.append("failures have a quality")
    if not len(entry.success) <= entry.tried <= entry.drawn:
        problems.append(
            f"{len(entry.success)} grasps of {entry.tried} tried and {entry.drawn} drawn"
        )
    return problems


def _pair(entry: GraspSet) -> str:
    return f"{entry.gripper} with {entry.object_name}"


def _pairs(file: Path, sets: list[GraspSet]) -> tuple[str, ...]:
    """What a damaged file holds; by its name, where it does not tell."""
    if sets:
        return tuple(_pair(entry) for entry in sets)
    if "__" in file.stem:
        return (f"{file.parent.name} with {file.stem.replace('__', '/')}",)
    return (f"all of {file.stem}",)


def _versions(path: Path, hashes: Counter[tuple[str, str]]) -> list[Damage]:
    """Notes of labels that belong to another description than the gripper's present one."""
    notes: list[Damage] = []
    for (gripper, digest), count in sorted(hashes.items()):
        try:
            if load_gripper(gripper).hash == digest:
                continue
            text = f"{count} pairs of {gripper} belong to another version of its description"
        except MegraspError as error:
            text = f"{count} pairs of {gripper}, whose description cannot be loaded ({error})"
        notes.append(Damage(path, text, damaged=False))
    return notes
