"""What `doctor` looks at on this machine: packages, shared memory, discovery, Fast DDS."""

from __future__ import annotations

import importlib.metadata
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from ament_index_python.packages import get_package_share_directory
from megrasp_msgs.msg import Grasp
from megrasp_msgs.srv import SynthesizeGrasps

import megrasp_core
from megrasp_ros.fast_dds import shared_memory_warning

from .check import Check

LIMITS = Path("/proc/sys/net/core")
PROFILE = "launch_scripts/config/fastdds.xml"


def installed_versions() -> dict[str, str]:
    """Package -> version of what has to fit together; those that are missing are left out."""
    share = Path(get_package_share_directory("megrasp_ros"))
    found = {
        "megrasp_core": megrasp_core.__version__,
        "megrasp_ros": ElementTree.parse(share / "package.xml").findtext("version", ""),
    }
    for name in ("numpy", "torch"):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def packages(versions: Mapping[str, str]) -> Check:
    """Whether core and nodes are of one version, and what they need is there."""
    told = ", ".join(f"{name} {version}" for name, version in versions.items())
    missing = [name for name in ("numpy", "torch") if name not in versions]
    if missing:
        return Check("packages", "fail", f"{told}; no {', '.join(missing)}: bash setup.sh")
    if versions["megrasp_core"] != versions["megrasp_ros"]:
        return Check(
            "packages",
            "fail",
            f"{told}; expected one version of both. Run launch_scripts/setup.sh in one checkout",
        )
    major = int(versions["numpy"].split(".")[0])
    if major > 2:
        return Check("packages", "warn", f"{told}; tried with numpy 1.26 to 2")
    return Check("packages", "ok", told)


def interfaces(kinds: Mapping[str, Any] | None = None) -> Check:
    """Whether the messages were built from this version's files."""
    kinds = kinds or {"SynthesizeGrasps": SynthesizeGrasps.Request, "Grasp": Grasp}
    expected = {"SynthesizeGrasps": {"target", "prefer"}, "Grasp": {"opening", "retreat"}}
    missing = [
        f"{name}.{field}"
        for name, fields in expected.items()
        for field in sorted(fields - set(kinds[name].get_fields_and_field_types()))
    ]
    if missing:
        text = f"{', '.join(missing)} missing; build the workspace again: launch_scripts/setup.sh"
        return Check("interfaces", "fail", text)
    return Check("interfaces", "ok", "messages are of this version")


def shared_memory(total: int | None = None) -> Check:
    """Whether clouds fit /dev/shm. total: its size in bytes, by default the machine's."""
    wrong = shared_memory_warning(total)
    return Check("shared memory", "warn" if wrong else "ok", wrong or "/dev/shm is large enough")


def discovery(environment: Mapping[str, str]) -> list[Check]:
    """Whether nodes can find each other by what the environment says."""
    return [_domain(environment), _range(environment)]


def _domain(environment: Mapping[str, str]) -> Check:
    text = environment.get("ROS_DOMAIN_ID", "0") or "0"
    if not re.fullmatch(r"\d+", text) or int(text) > 232:
        return Check("domain", "fail", f"ROS_DOMAIN_ID is {text!r}; expected 0 to 232")
    if int(text) > 101:
        return Check(
            "domain",
            "warn",
            f"ROS_DOMAIN_ID is {text}, whose ports other programs may hold; 0 to 101 are safe",
        )
    return Check("domain", "ok", f"ROS_DOMAIN_ID {text}; the server's must be the same")


def _range(environment: Mapping[str, str]) -> Check:
    asked = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    peers = environment.get("ROS_STATIC_PEERS", "")
    if environment.get("ROS_LOCALHOST_ONLY", "0") == "1":
        return Check(
            "discovery",
            "warn",
            "ROS_LOCALHOST_ONLY is 1, which is deprecated and wins: nodes of other machines are "
            "not seen. Unset it, and set ROS_AUTOMATIC_DISCOVERY_RANGE",
        )
    if asked not in ("", "SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT"):
        return Check(
            "discovery",
            "fail",
            f"ROS_AUTOMATIC_DISCOVERY_RANGE is {asked!r}; expected SUBNET, LOCALHOST or OFF",
        )
    if asked == "OFF" and not peers:
        return Check(
            "discovery",
            "fail",
            "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF and ROS_STATIC_PEERS empty: no node is seen. "
            "Set SUBNET, or name the machines",
        )
    if asked == "LOCALHOST" and not peers:
        return Check("discovery", "ok", "LOCALHOST: this machine only; SUBNET for others, too")
    return Check("discovery", "ok", f"{asked or 'SUBNET'}{', peers ' + peers if peers else ''}")


def profile(
    environment: Mapping[str, str], *, limits: Path = LIMITS, cloud_bytes: int = 0
) -> Check:
    """Whether Fast DDS is set up for large clouds.

    Args:
        environment: of the process.
        limits: folder with rmem_max and wmem_max.
        cloud_bytes: size of a cloud, where it is known.
    """
    middleware = environment.get("RMW_IMPLEMENTATION", "")
    if middleware and "fastrtps" not in middleware:
        text = f"RMW_IMPLEMENTATION is {middleware}: no profile of ours; tried with Fast DDS only"
        return Check("Fast DDS", "warn", text)
    names = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
    name, file = next(((n, environment[n]) for n in names if environment.get(n)), ("", ""))
    if not file:
        text = f"no profile: most clouds of 5 MB get lost. Set {names[1]} to {PROFILE}"
        return Check("Fast DDS", "warn", text)
    try:
        tree = ElementTree.parse(file)
    except (OSError, ElementTree.ParseError) as error:
        text = f"{name} is {file}, which cannot be read ({error}); expected {PROFILE}"
        return Check("Fast DDS", "fail", text)

    def largest(*tags: str) -> int:
        found = [
            int(element.text or 0)
            for element in tree.iter()
            if element.tag.rpartition("}")[2] in tags and (element.text or "").strip().isdigit()
        ]
        return max(found, default=0)

    for tag, limit in (("receiveBufferSize", "rmem_max"), ("sendBufferSize", "wmem_max")):
        path = limits / limit
        granted = int(path.read_text()) if path.is_file() else None
        if granted is not None and largest(tag) > granted:
            return Check(
                "Fast DDS",
                "fail",
                f"{file} asks for a {tag} of {largest(tag)} and the kernel grants {granted}: "
                f"nodes do not find each other. Take fastdds_small_buffers.xml beside it, or run "
                f"sysctl -w net.core.{limit}={largest(tag)}",
            )
    segment = largest("segment_size")
    if cloud_bytes and segment and segment < 2 * cloud_bytes:
        return Check(
            "Fast DDS",
            "warn",
            f"{file} has a segment of {segment / 1e6:.1f} MB for clouds of {cloud_bytes / 1e6:.1f}"
            f" MB; expected at least two clouds. Raise segment_size",
        )
    return Check("Fast DDS", "ok", file)
