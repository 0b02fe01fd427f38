"""xacro files read as the URDF that they expand to (extra `xacro`)."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from xml.etree import ElementTree

from megrasp_core.errors import DescriptionError

from .meshes import MeshFinder

SUFFIX = ".xacro"
NAMESPACE = "xacro"
FIND = re.compile(r"\$\(find ([\w-]+)\)")


def is_xacro(path: Path) -> bool:
    """Whether a file is one: by its suffix, or by elements of xacro's namespace."""
    if path.suffix.lower() == SUFFIX:
        return True
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except (ElementTree.ParseError, LookupError, ValueError):
        return False
    return any(NAMESPACE in str(element.tag) for element in root.iter())


def expand(path: Path, packages: Mapping[str, Path], arguments: Mapping[str, str]) -> str:
    """Return the URDF that a xacro file expands to.

    Args:
        path: the file.
        packages: ROS package name -> folder, for `$(find name)`.
        arguments: what stands after `name:=` on xacro's command line.

    Raises:
        DescriptionError: no xacro is installed, or the file cannot be expanded.
    """
    run = _expander()
    if run is None:
        made = f"{path.name.partition('.')[0]}.urdf"
        raise DescriptionError(
            f"{path} is a xacro file, and nothing that reads these is installed; expected "
            "xacrodoc: pip install 'megrasp-core[xacro]'. Or expand it where ROS is: xacro "
            f"{path.name} > {made}"
        )
    try:
        return run(path, _found(path, packages), dict(arguments))
    except Exception as error:  # xacro evaluates Python expressions: anything may come
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise DescriptionError(
            f"{path} cannot be expanded by xacro; it says: {reason}. Missing arguments are given "
            "with --xacro-arg NAME:=VALUE, missing packages with --package NAME=FOLDER"
        ) from error


Expander = Callable[[Path, Mapping[str, Path], dict[str, str]], str]


def _expander() -> Expander | None:
    """Return what expands a file: xacrodoc, or ROS's own xacro; None without either."""
    for module, run in (("xacrodoc", _by_xacrodoc), ("xacro", _by_xacro)):
        try:
            importlib.import_module(module)
        except ImportError:
            continue
        return run
    return None


def _by_xacrodoc(path: Path, packages: Mapping[str, Path], arguments: dict[str, str]) -> str:
    xacrodoc = importlib.import_module("xacrodoc")
    places = importlib.import_module("xacrodoc.packages")
    places.update_package_cache({name: str(folder) for name, folder in packages.items()})
    document = xacrodoc.XacroDoc.from_file(str(path), subargs=arguments, resolve_packages=False)
    return str(document.to_urdf_string())


def _by_xacro(path: Path, packages: Mapping[str, Path], arguments: dict[str, str]) -> str:
    xacro = importlib.import_module("xacro")
    return str(xacro.process_file(str(path), mappings=arguments).toxml())


def _found(path: Path, packages: Mapping[str, Path]) -> dict[str, Path]:
    """Return the folders of the packages that the file and those beside it name."""
    finder = MeshFinder(path.parent, packages)
    out = dict(packages)
    for file in [path, *sorted(path.parent.glob(f"*{SUFFIX}"))]:
        for name in FIND.findall(file.read_text(encoding="utf-8", errors="replace")):
            folder = finder.package(name)
            if folder is not None:
                out.setdefault(name, folder)
    return out
