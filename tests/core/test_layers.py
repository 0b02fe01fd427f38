"""Who imports whom: layers point down, there are no cycles, the core knows nothing of ROS.

The layers are those of docs/architecture.md. Imports inside functions and under TYPE_CHECKING
count like all others.
"""

from __future__ import annotations

import ast
import graphlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import megrasp_core

SOURCE = Path(megrasp_core.__file__).parent
LAYERS = (
    {"lie", "meshes", "jobs", "errors", "limits", "machine", "ranges"},
    {"grippers", "objects", "pointcloud"},
    {"ranking", "diffusion", "network", "storage", "simulation"},
    {"cell", "drawing", "synthesizer", "scenes", "library"},
    {
        "evaluation",
        "training",
        "self_labelling",
        "gripper_tools",
        "benchmarks",
        "service",
        "explanation",
    },
    {"viewer"},
    {"cli"},
    {"__main__"},
)
ROOMS = {
    "benchmarks", "cell", "cli", "drawing", "evaluation", "gripper_tools", "self_labelling",
}  # fmt: skip
"""Packages whose modules are separate things: these are imported, not names of the package."""
ROS = {
    "ament_index_python", "builtin_interfaces", "geometry_msgs", "launch", "launch_ros",
    "megrasp_msgs", "megrasp_ros", "rcl_interfaces", "rclpy", "sensor_msgs", "sensor_msgs_py",
    "std_msgs", "tf2_ros", "visualization_msgs",
}  # fmt: skip


def module_name(path: Path) -> str:
    """Dotted name of a file of the core."""
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in sorted(SOURCE.rglob("*.py"))}


def imports(module: str) -> set[tuple[str, str]]:
    """(module or package, name) of everything that a module of the core imports; the name is ""
    where a whole module is.
    """
    path = MODULES[module]
    base = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {(alias.name, "") for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package = base[: len(base) - node.level + 1] if node.level else []
            full = ".".join([*package, *([node.module] if node.module else [])])
            for alias in node.names:
                whole = f"{full}.{alias.name}"
                # A name that stands for a function of the package is not its module.
                exported = f"{full}.{alias.name}" in MODULES and not _exports(full, alias.name)
                found.add((whole, "") if exported else (full, alias.name))
    return found


def _exports(package: str, name: str) -> bool:
    path = MODULES.get(package)
    if path is None or path.name != "__init__.py":
        return False
    tree = ast.parse(path.read_text())
    return any(
        isinstance(node, ast.ImportFrom)
        and node.module is not None
        and name in {alias.asname or alias.name for alias in node.names}
        for node in tree.body
    )


def package_of(module: str) -> str:
    """The room in the core: the first name after the core's own."""
    return [*module.split("."), ""][1]


GRAPH = {module: imports(module) for module in MODULES}


def test_every_package_has_a_layer() -> None:
    packages = {package_of(module) for module in MODULES} - {""}
    assert packages == set().union(*LAYERS)


def test_layers_point_down_only() -> None:
    rank = {package: level for level, layer in enumerate(LAYERS) for package in layer}
    upward = {
        (module, target)
        for module, targets in GRAPH.items()
        for target, _ in targets
        if target.startswith("megrasp_core.")
        and package_of(module)
        and rank[package_of(target)] > rank[package_of(module)]
    }
    assert not upward


@pytest.mark.parametrize("of", ["packages", "modules"])
def test_there_are_no_cycles(of: str) -> None:
    graph: dict[str, set[str]] = {}
    for module, targets in GRAPH.items():
        for target, _ in targets:
            if target not in MODULES or target == module:
                continue
            # What a package's own modules take from it goes by way of its __init__.
            a, b = (
                (package_of(module), package_of(target)) if of == "packages" else (module, target)
            )
            if a != b:
                graph.setdefault(a, set()).add(b)
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(f"a cycle: {' <- '.join(error.args[1])}")


def test_names_come_from_their_package() -> None:
    past = set()
    for module, targets in GRAPH.items():
        for target, name in targets:
            parts = target.split(".")
            if len(parts) < 3 or parts[0] != "megrasp_core" or parts[1] == package_of(module):
                continue
            if parts[1] not in ROOMS and _exports(".".join(parts[:2]), name):
                past.add(f"{module}: {name} of {target}")
    assert not past


def test_no_file_imports_ros() -> None:
    assert len(MODULES) > 200
    offenders = {
        module: found
        for module, targets in GRAPH.items()
        if (found := {target.partition(".")[0] for target, _ in targets} & ROS)
    }
    assert not offenders


@pytest.mark.slow
def test_importing_every_module_loads_no_ros() -> None:
    names = [info.name for info in pkgutil.walk_packages(megrasp_core.__path__, "megrasp_core.")]
    code = (
        "import importlib, sys\n"
        f"for name in {names!r}:\n"
        "    importlib.import_module(name)\n"
        f"print(sorted({ROS!r} & {{name.partition('.')[0] for name in sys.modules}}))\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "[]"
