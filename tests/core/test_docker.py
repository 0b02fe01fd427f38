"""What the Docker files name is in the repository; they are linted, but not built."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
FILES = sorted((ROOT / "docker").glob("Dockerfile*"))
SCRIPT = re.compile(r"\bbash ((?:launch_scripts|docker)/\S+\.sh)((?: --?[\w-]+)*)")


def instructions(file: Path) -> list[tuple[str, str]]:
    """(instruction, rest) of every instruction, continued lines joined."""
    text = re.sub(r"^#.*\n", "", file.read_text(), flags=re.MULTILINE).replace("\\\n", " ")
    return [
        (words[0], words[1]) for line in text.splitlines() if (words := line.split(maxsplit=1))
    ]


def test_there_are_two() -> None:
    assert [file.name for file in FILES] == ["Dockerfile", "Dockerfile.debian"]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_hadolint_finds_nothing(file: Path) -> None:
    if shutil.which("hadolint") is None:
        pytest.skip("hadolint is missing: pip install 'megrasp-core[lint]'")
    done = subprocess.run(["hadolint", file], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and not done.stdout, done.stdout


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_what_they_name_is_there(file: Path) -> None:
    found = instructions(file)
    setup = (ROOT / "launch_scripts" / "setup.sh").read_text()
    for name, rest in found:
        if name == "FROM":
            _, tag = rest.split(":")
            assert tag and tag != "latest"
        if name == "COPY":
            *sources, _ = [word for word in rest.split() if not word.startswith("--")]
            assert all((ROOT / source).exists() for source in sources), rest
        if name == "ARG":
            assert f"{{{rest.partition('=')[0]}:-" in setup, f"setup.sh does not read {rest}"
    called = SCRIPT.findall(file.read_text())
    assert {script for script, _ in called} == {"launch_scripts/setup.sh"}
    for _, options in called:
        assert all(option in setup for option in options.split()), options
    entry = next(rest for name, rest in found if name == "ENTRYPOINT")
    assert (ROOT / yaml.safe_load(entry)[-1]).is_file()


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_they_end_as_a_user(file: Path) -> None:
    users = [rest for name, rest in instructions(file) if name == "USER"]
    assert users and users[-1] not in ("0", "root")


def test_compose_builds_them() -> None:
    services = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text())["services"]
    build = services["grasp_server"]["build"]
    assert (ROOT / "docker" / build["context"] / build["dockerfile"]).resolve() in FILES
    assert services["camera"]["profiles"], "a camera is asked for"


def test_the_context_leaves_out_what_is_made() -> None:
    lines = (ROOT / ".dockerignore").read_text().split()
    assert {".git", ".venv", "ros2_ws/build", "ros2_ws/install", "ros2_ws/log", "out"} <= set(
        lines
    )
    tracked = subprocess.run(
        ["git", "ls-files", *(line for line in lines if "*" not in line)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert not tracked.stdout, "what is committed is wanted"
