"""env.sh in the shells of its users."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SHELLS = [shell for shell in ("bash", "dash", "zsh") if shutil.which(shell)]
KEPT = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE")


def sourced(shell: str, script: str, folder: Path, **extra: str) -> subprocess.CompletedProcess:
    environment = {name: value for name, value in os.environ.items() if name not in KEPT}
    return subprocess.run(
        [shell, "-c", script], cwd=folder, env=environment | extra, capture_output=True, text=True
    )


@pytest.mark.parametrize("shell", SHELLS)
def test_it_sets_what_is_needed_and_says_so(shell: str) -> None:
    script = '. launch_scripts/env.sh; echo "$FASTRTPS_DEFAULT_PROFILES_FILE"'
    done = sourced(shell, f"set -eu; {script}", ROOT)
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).is_file()
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST" in done.stderr


@pytest.mark.parametrize("shell", SHELLS)
def test_what_is_set_is_kept(shell: str) -> None:
    given = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "FASTRTPS_DEFAULT_PROFILES_FILE": "/x"}
    script = ". launch_scripts/env.sh; echo $ROS_AUTOMATIC_DISCOVERY_RANGE"
    done = sourced(shell, f"{script} $FASTRTPS_DEFAULT_PROFILES_FILE", ROOT, **given)
    assert done.stdout.split() == ["SUBNET", "/x"]
    assert "LOCALHOST" not in done.stderr


def test_from_elsewhere(tmp_path: Path) -> None:
    script = f". {ROOT}/launch_scripts/env.sh && echo sourced"
    assert "sourced" in sourced("bash", script, tmp_path).stdout
    if "dash" in SHELLS:
        refused = sourced("dash", script, tmp_path)
        assert "sourced" not in refused.stdout and "MEGRASP_ROOT" in refused.stderr
        assert "sourced" in sourced("dash", script, tmp_path, MEGRASP_ROOT=str(ROOT)).stdout


@pytest.mark.parametrize("shell", SHELLS)
def test_another_venv_and_the_nodes_on_the_path(shell: str, tmp_path: Path) -> None:
    """In a copy of the folder layout, since the real one may not be built."""
    nodes = tmp_path / "ros2_ws/install/megrasp_ros/lib/megrasp_ros"
    for folder in (nodes, tmp_path / "launch_scripts", tmp_path / "mine/bin"):
        folder.mkdir(parents=True)
    shutil.copy(ROOT / "launch_scripts/env.sh", tmp_path / "launch_scripts")
    (tmp_path / "mine/bin/activate").write_text("MINE=yes\n")
    script = '. launch_scripts/env.sh; . launch_scripts/env.sh; echo "$MINE $PATH"'
    done = sourced(shell, script, tmp_path, MEGRASP_VENV=str(tmp_path / "mine"))
    mine, path = done.stdout.split()
    assert mine == "yes" and path.split(":").count(str(nodes)) == 1
