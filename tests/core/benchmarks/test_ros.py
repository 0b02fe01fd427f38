"""The core starts the program of the ROS package, and says when it is not there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from megrasp_core.benchmarks.ros import PROGRAM, bench_ros, find_bench_node
from megrasp_core.cli.app import main
from megrasp_core.errors import InvalidRequestError, MegraspError


def program(folder: Path, script: str) -> Path:
    path = folder / PROGRAM
    path.parent.mkdir(parents=True)
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return path


def test_it_is_found_in_any_prefix(tmp_path: Path) -> None:
    path = program(tmp_path / "second", "exit 0")
    prefixes = os.pathsep.join([str(tmp_path / "first"), "", str(tmp_path / "second")])
    assert find_bench_node(prefixes) == path


def test_without_a_workspace_the_command_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    with pytest.raises(InvalidRequestError, match="env"):
        find_bench_node()
    assert main(["bench", "--stage", "ros"]) == 2
    assert "launch_scripts/env.sh" in capsys.readouterr().err


def test_its_result_and_its_failure_are_passed_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    path = program(tmp_path, 'printf \'{"repeats": %s, "note": "%s"}\' "$2" "$4" > "$6"')
    assert bench_ros(repeats=3, note="two words") == {"repeats": 3, "note": "two words"}
    path.write_text("#!/bin/sh\nexit 1\n")
    with pytest.raises(MegraspError, match="exit code 1"):
        bench_ros(repeats=3, note="")
