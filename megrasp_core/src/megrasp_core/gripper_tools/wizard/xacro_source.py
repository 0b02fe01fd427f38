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
INCLUDED = re.compile(r"<xacro:include\s[^>]*filename\s*=\s*[\"']([^\"']+)[\"']")
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
    found, missing = _packages(path, packages)
    try:
        return run(path, found, dict(arguments))
    except Exception as error:  # xacro evaluates Python expressions: anything may come
        if missing:
            given = " ".join(f"--package {name}=/folder/of/{name}" for name in missing)
            raise DescriptionError(
                f"{path} cannot be expanded by xacro: it needs the ROS packages "
                f"{', '.join(missing)}, which are not found. Say where they lie: {given}"
            ) from error
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
    """Expand with the finder of packages that xacrodoc puts into xacro; its own reader of files
    forgets where a file lies, so that includes beside it are not found.
    """
    importlib.import_module("xacrodoc")
    places = importlib.import_module("xacrodoc.packages")
    # It keeps what it found for the life of the process, files of another gripper too.
    places.reset()
    places.walk_up_from(str(path.resolve()))
    places.update_package_cache({name: str(folder) for name, folder in packages.items()})
    try:
        return _by_xacro(path, packages, arguments)
    finally:
        places.reset()


def _by_xacro(path: Path, packages: Mapping[str, Path], arguments: dict[str, str]) -> str:
    xacro = importlib.import_module("xacro")
    return str(xacro.process_file(str(path), mappings=arguments).toxml())


def _packages(path: Path, given: Mapping[str, Path]) -> tuple[dict[str, Path], list[str]]:
    """Return the folders of the packages that a file and what it includes name, and the names of
    those that are not found.
    """
    finder = MeshFinder(path.parent, given)
    found, missing = dict(given), []
    left, seen = [path], set()
    while left:
        file = left.pop()
        if file in seen or not file.is_file():
            continue
        seen.add(file)
        text = file.read_text(encoding="utf-8", errors="replace")
        for name in FIND.findall(text):
            folder = finder.package(name)
            if folder is not None:
                found.setdefault(name, folder)
            elif name not in missing:
                missing.append(name)
        for name in INCLUDED.findall(text):
            named = FIND.sub(lambda m: str(found.get(m[1], m[0])), name)
            left.append(file.parent / named)
    return found, missing
