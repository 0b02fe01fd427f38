"""One version: that of `megrasp_core.__version__`, wherever a file has to repeat it."""

from __future__ import annotations

import re
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import megrasp_core

ROOT = Path(__file__).parents[2]
PACKAGES = (
    "gripper_descriptions", "launch_scripts", "megrasp_ros", "models", "ros2_ws/src/megrasp_msgs",
)  # fmt: skip


def test_every_place_has_the_version() -> None:
    found = {
        name: ElementTree.parse(ROOT / name / "package.xml").findtext("version")
        for name in PACKAGES
    }
    citation = (ROOT / "CITATION.cff").read_text()
    found["CITATION.cff"] = re.findall(r"^version: (\S+)$", citation, re.MULTILINE)[0]
    found["installed"] = version("megrasp-core")
    assert set(found.values()) == {megrasp_core.__version__}, found
    assert f"## {megrasp_core.__version__}" in (ROOT / "CHANGELOG.md").read_text()
