"""The core knows nothing of ROS: neither in its source nor in what importing it loads."""

from __future__ import annotations

import ast
import pkgutil
import subprocess
import sys
from pathlib import Path

import megrasp_core

SOURCE = Path(megrasp_core.__file__).parent
ROS = {
    "rclpy",
    "ament_index_python",
    "builtin_interfaces",
    "geometry_msgs",
    "launch",
    "launch_ros",
    "megrasp_msgs",
    "megrasp_ros",
    "rcl_interfaces",
    "sensor_msgs",
    "sensor_msgs_py",
    "std_msgs",
    "tf2_ros",
    "visualization_msgs",
}


def imported(file: Path) -> set[str]:
    """Return the top-level packages a file imports, also inside functions."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module.partition(".")[0])
    return found


def test_no_file_imports_ros() -> None:
    files = sorted(SOURCE.rglob("*.py"))
    assert len(files) > 30
    offenders = {str(file.relative_to(SOURCE)): imported(file) & ROS for file in files}
    assert not {name: found for name, found in offenders.items() if found}


def test_importing_every_module_loads_no_ros() -> None:
    names = [info.name for info in pkgutil.walk_packages(megrasp_core.__path__, "megrasp_core.")]
    names = [name for name in names if not name.endswith("__main__")]
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
