"""The file of `megrasp finetune --grasps`: clouds, each with a grasp in it."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from megrasp_core.errors import DataError, MegraspError

from .common import read_region
from .synthesis_options import assumed_sensor
from .viewing import gravity_of, length_factor, sensor_of

if TYPE_CHECKING:
    from megrasp_core.training import GivenGrasp

__all__ = ["read_grasps"]

NEEDED = ("cloud", "world_from_gripper")
OPTIONAL = ("frame", "gravity", "sensor", "region", "scale")
EXPECTED = (
    'expected a JSON list of {"cloud": path, "world_from_gripper": [x, y, z, qx, qy, qz, qw]}, '
    f"optionally with {', '.join(OPTIONAL)}"
)
UNIT = 0.01
"""So far from 1 may the length of a quaternion be, whose numbers were rounded."""


def read_grasps(path: Path) -> list[GivenGrasp]:
    """The grasps of a file. Paths are relative to it; clouds are read and checked as those of
    `megrasp synthesize`.

    `frame` (`world`, `optical`), `gravity` and `sensor` (three numbers), `region` (path) and
    `scale` of an entry mean what the options of that command do; poses are in metres.

    Raises:
        DataError: the file or an entry is wrong.
        MegraspError: a cloud is; the message begins with the entry.
    """
    try:
        entries = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise DataError(f"grasps file {path} cannot be read ({error}); {EXPECTED}.") from None
    if not isinstance(entries, list) or not entries:
        raise DataError(f"grasps file {path} holds {_short(entries)}; {EXPECTED}.")
    grasps = []
    for number, entry in enumerate(entries, start=1):
        try:
            grasps.append(_grasp(entry, path.parent))
        except MegraspError as error:
            raise type(error)(f"{path}, entry {number}: {error}") from error
    return grasps


def _grasp(entry: Any, folder: Path) -> GivenGrasp:
    from megrasp_core.lie import matrix_from_pose7
    from megrasp_core.pointcloud import check_view, read_cloud
    from megrasp_core.synthesizer import SynthesisRequest
    from megrasp_core.training import GivenGrasp

    if not isinstance(entry, dict):
        raise DataError(f"it is {_short(entry)}; {EXPECTED}.")
    missing = [name for name in NEEDED if name not in entry]
    unknown = sorted(set(entry) - {*NEEDED, *OPTIONAL})
    if missing or unknown:
        raise DataError(
            f"it has {sorted(entry)}, "
            + " and ".join(
                f"{word} {', '.join(names)}"
                for word, names in (("lacks", missing), ("does not know", unknown))
                if names
            )
            + f"; {EXPECTED}."
        )
    pose = _numbers(entry, "world_from_gripper", 7)
    assert pose is not None
    length = float(np.linalg.norm(pose[3:]))
    if abs(length - 1.0) > UNIT:
        raise DataError(
            f"the quaternion {pose[3:].tolist()} of world_from_gripper has the length "
            f"{length:.4g}; expected 1, in the order qx, qy, qz, qw after x, y, z."
        )
    frame = entry.get("frame", "world")
    if frame not in ("world", "optical"):
        raise DataError(f'frame {_short(frame)} was given; expected "world" or "optical".')
    scale = entry.get("scale", 1.0)
    if isinstance(scale, bool) or not isinstance(scale, (int, float)):
        raise DataError(f"scale {_short(scale)} was given; expected metres per unit of the cloud.")
    file = _path(entry, "cloud", folder)
    region = _path(entry, "region", folder) if "region" in entry else None
    gravity, sensor = _numbers(entry, "gravity", 3), _numbers(entry, "sensor", 3)
    cloud = read_cloud(file, optical=frame == "optical").scaled(length_factor(scale))
    down = gravity_of(frame, _triple(gravity), False)
    box, walls = (None, True) if region is None else read_region(region)
    seen_from = sensor_of(cloud, frame, _triple(sensor))
    check_view(
        cloud.points, sensor=seen_from, gravity=down, region=box, optical=frame == "optical"
    )
    if seen_from is None:
        seen_from = assumed_sensor(cloud, down)
    request = SynthesisRequest(gravity=down, sensor=seen_from, region=box, walls=walls, seed=0)
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    return GivenGrasp(cloud, matrix_from_pose7(pose), request, file.name, digest)


def _path(entry: dict[str, Any], name: str, folder: Path) -> Path:
    value = entry[name]
    if not isinstance(value, str):
        raise DataError(f"{name} {_short(value)} was given; expected a path, as text.")
    return folder / value


def _numbers(entry: dict[str, Any], name: str, count: int) -> np.ndarray | None:
    value = entry.get(name)
    if value is None and name not in NEEDED:
        return None
    numbers = value if isinstance(value, list) else [value]
    if len(numbers) != count or not all(
        isinstance(v, (int, float)) and not isinstance(v, bool) and np.isfinite(v) for v in numbers
    ):
        raise DataError(
            f"{name} is {_short(value)} ({len(numbers)} given); expected {count} finite numbers "
            "in a list."
        )
    return np.array(numbers, dtype=np.float64)


def _triple(vector: np.ndarray | None) -> tuple[float, float, float] | None:
    if vector is None:
        return None
    x, y, z = vector.tolist()
    return x, y, z


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
