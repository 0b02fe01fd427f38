"""What doctor says of the machine, for machines that are and are not in order."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from megrasp_ros.call.checks import machine

CONFIG = Path(__file__).parents[3] / "launch_scripts" / "config"
VERSIONS = {"megrasp_core": "1.0", "megrasp_ros": "1.0", "numpy": "2.1.0", "torch": "2.13.0"}


@pytest.mark.parametrize(
    ("change", "level", "text"),
    [
        ({}, "ok", "megrasp_core 1.0, megrasp_ros 1.0"),
        ({"megrasp_ros": "0.9"}, "fail", "expected one version of both"),
        ({"torch": None}, "fail", "no torch"),
        ({"numpy": "3.0.0"}, "warn", "tried with numpy 1.26 to 2"),
    ],
)
def test_versions(change: dict, level: str, text: str) -> None:
    given = {name: value for name, value in (VERSIONS | change).items() if value is not None}
    check = machine.packages(given)
    assert check.level == level and text in check.text


def test_this_machine_is_told() -> None:
    found = machine.installed_versions()
    assert {"megrasp_core", "megrasp_ros", "numpy", "torch"} == set(found)
    assert machine.interfaces().level == "ok"


def test_messages_of_another_version() -> None:
    old = SimpleNamespace(get_fields_and_field_types=lambda: {"id": "uint32", "retreat": "Pose"})
    check = machine.interfaces({"SynthesizeGrasps": old, "Grasp": old})
    assert check.level == "fail"
    assert "SynthesizeGrasps.prefer" in check.text and "Grasp.opening" in check.text


def test_shared_memory() -> None:
    assert machine.shared_memory(2**30).level == "ok"
    small = machine.shared_memory(64 * 2**20)
    assert small.level == "warn" and "--shm-size" in small.text


@pytest.mark.parametrize(
    ("environment", "what", "level", "text"),
    [
        ({}, "domain", "ok", "0"),
        ({"ROS_DOMAIN_ID": "62"}, "domain", "ok", "62"),
        ({"ROS_DOMAIN_ID": "seven"}, "domain", "fail", "expected 0 to 232"),
        ({"ROS_DOMAIN_ID": "233"}, "domain", "fail", "expected 0 to 232"),
        ({"ROS_DOMAIN_ID": "150"}, "domain", "warn", "0 to 101 are safe"),
        ({}, "discovery", "ok", "SUBNET"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, "discovery", "ok", "this machine only"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "localhost"}, "discovery", "fail", "expected SUBNET"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, "discovery", "fail", "no node is seen"),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "ROS_STATIC_PEERS": "10.0.0.2"},
            "discovery",
            "ok",
            "10.0.0.2",
        ),
        ({"ROS_LOCALHOST_ONLY": "1"}, "discovery", "warn", "deprecated"),
    ],
)
def test_discovery(environment: dict, what: str, level: str, text: str) -> None:
    check = next(each for each in machine.discovery(environment) if each.what == what)
    assert check.level == level and text in check.text


def limits(folder: Path, size: int) -> Path:
    for name in ("rmem_max", "wmem_max"):
        (folder / name).write_text(f"{size}\n")
    return folder


def test_profiles(tmp_path: Path) -> None:
    name = "FASTRTPS_DEFAULT_PROFILES_FILE"
    large, small = ({name: str(CONFIG / f"{stem}.xml")} for stem in (
        "fastdds", "fastdds_small_buffers"))  # fmt: skip
    wide = limits(tmp_path, 4194304)
    assert machine.profile(large, limits=wide).level == "ok"
    assert machine.profile({}, limits=wide).level == "warn"
    other = machine.profile({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, limits=wide)
    assert other.level == "warn" and "rmw_cyclonedds_cpp" in other.text
    gone = machine.profile({name: str(tmp_path / "gone.xml")}, limits=wide)
    assert gone.level == "fail" and "cannot be read" in gone.text
    (tmp_path / "broken.xml").write_text("<profiles>")
    assert machine.profile({name: str(tmp_path / "broken.xml")}, limits=wide).level == "fail"
    tight = machine.profile(large, limits=limits(tmp_path, 212992))
    assert tight.level == "fail" and "fastdds_small_buffers.xml" in tight.text
    assert machine.profile(small, limits=tmp_path).level == "ok"
    huge = machine.profile(small, limits=tmp_path, cloud_bytes=20_000_000)
    assert huge.level == "warn" and "Raise segment_size" in huge.text
