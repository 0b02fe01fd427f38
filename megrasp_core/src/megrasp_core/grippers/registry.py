"""The registry: where grippers are found by name.

A search folder may hold a folder `cad`: descriptions of CAD models that lie under MEGRASP_ASSETS.
They are registered where that is set.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from pathlib import Path

from megrasp_core.errors import DescriptionError, UnknownGripperError

from .description import FILE_NAME
from .family import load_procedural
from .gripper import Gripper
from .model_file import ASSET_VARIABLE

SHARE = Path("share") / "gripper_descriptions"
PATH_VARIABLE = "MEGRASP_GRIPPER_PATH"
CAD_FOLDER = "cad"
CAD_SUFFIX = "_cad"


def search_folders(extra_paths: Iterable[str | Path] = ()) -> list[Path]:
    """Return the folders that are searched, first match wins.

    In this order: `extra_paths`, `MEGRASP_GRIPPER_PATH`, `share/gripper_descriptions` of every
    colcon prefix (`AMENT_PREFIX_PATH`), that of the Python prefix, `gripper_descriptions` of the
    checkout, that of the installed package.
    """
    folders = [Path(path) for path in extra_paths]
    folders += [Path(path) for path in os.environ.get(PATH_VARIABLE, "").split(":") if path]
    prefixes = [path for path in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if path]
    folders += [Path(prefix) / SHARE for prefix in (*prefixes, sys.prefix)]
    here = Path(__file__).resolve()
    folders += [parent / "gripper_descriptions" for parent in here.parents]
    folders.append(here.parents[1] / SHARE)
    found = dict.fromkeys(folder.expanduser().resolve() for folder in folders)
    return [folder for folder in found if folder.is_dir()]


def gripper_folders(extra_paths: Iterable[str | Path] = ()) -> dict[str, Path]:
    """Return name -> folder of every registered gripper, sorted by name; the name is the folder's.

    A search folder may hold grippers (`<name>/gripper.yaml`) or be one gripper's folder itself.
    CAD descriptions (`cad/<name>/gripper.yaml`) are left out where MEGRASP_ASSETS is not set.
    """
    folders = search_folders(extra_paths)
    out = _described(folders)
    if os.environ.get(ASSET_VARIABLE):
        out = {**cad_folders(extra_paths), **out}
    return dict(sorted(out.items()))


def cad_folders(extra_paths: Iterable[str | Path] = ()) -> dict[str, Path]:
    """Return name -> folder of every CAD description, whether or not MEGRASP_ASSETS is set."""
    return _described(folder / CAD_FOLDER for folder in search_folders(extra_paths))


def cad_twins(extra_paths: Iterable[str | Path] = ()) -> dict[str, str]:
    """Return the own descriptions that have a CAD twin: name -> name of the twin, `<name>_cad`."""
    cad = cad_folders(extra_paths)
    own = _described(search_folders(extra_paths))
    return {name: name + CAD_SUFFIX for name in sorted(own) if name + CAD_SUFFIX in cad}


def list_grippers(extra_paths: Iterable[str | Path] = ()) -> list[str]:
    """Return the names of all registered grippers, sorted."""
    return list(gripper_folders(extra_paths))


def load_gripper(name_or_folder: str | Path, extra_paths: Iterable[str | Path] = ()) -> Gripper:
    """Load a gripper by its registered name, from the folder (or path) of a `gripper.yaml`, or a
    procedural one by its name (`angular_000042`: kind and seed), which is made anew.

    Raises:
        UnknownGripperError: no such name, and no such folder (code 200).
        DescriptionError: the description is wrong, or is that of a CAD model and MEGRASP_ASSETS
            is not set (code 201).
    """
    registered = gripper_folders(extra_paths)
    folders = {**cad_folders(extra_paths), **registered}
    name = str(name_or_folder)
    if name in folders:
        gripper = Gripper.from_path(folders[name])
        if gripper.name != name:
            raise DescriptionError(
                f"{gripper.description.file}: 'name' is '{gripper.name}', but the folder, which "
                f"is the registered name, is called '{name}'; make them the same"
            )
        return gripper
    path = Path(name_or_folder).expanduser()
    if os.path.exists(path):
        return Gripper.from_path(path)
    procedural = load_procedural(name)
    if procedural is not None:
        return procedural
    raise UnknownGripperError(name, registered)


def _described(folders: Iterable[Path]) -> dict[str, Path]:
    """Return name -> folder of the grippers in the folders, first match wins."""
    out: dict[str, Path] = {}
    for folder in folders:
        if not folder.is_dir():
            continue
        candidates = [folder] if (folder / FILE_NAME).is_file() else sorted(folder.iterdir())
        for candidate in candidates:
            if (candidate / FILE_NAME).is_file():
                out.setdefault(candidate.name, candidate)
    return out
