"""Grasps that somebody gives for a gripper: the scenes they belong to, and what tells that they
are in another frame or unit than was said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DataError, MegraspError
from megrasp_core.grippers import Gripper
from megrasp_core.lie import pose7_from_matrix
from megrasp_core.pointcloud import Cloud, SceneSettings
from megrasp_core.ranking import GripperProbe, gripper_probe
from megrasp_core.synthesizer import Perceived, SynthesisRequest, perceive, pose_set

FARTHEST = 0.10
"""No TCP is farther (m) than this from what was seen of the object that it grasps."""
NEAR = 0.05
"""Read in another way, a grasp must come as near (m) to be named."""
UNUSABLE = ("collision", "empty")
"""Reasons of the check that a grasp which held does not have, but for gaps of the cloud."""

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GivenGrasp:
    """One grasp that holds, and the cloud of its scene.

    Attributes:
        cloud: in any frame, metres.
        world_from_gripper: (4, 4) gripper frame at the pre-grasp, in the frame of the cloud.
        request: gravity, sensor and region, as a synthesis for this cloud is asked for.
        name: of the cloud's file, for messages.
        digest: SHA-256 of that file.
    """

    cloud: Cloud
    world_from_gripper: Matrix
    request: SynthesisRequest
    name: str = ""
    digest: str = ""

    @property
    def pose7(self) -> list[float]:
        """`world_from_gripper` as seven numbers."""
        return pose7_from_matrix(self.world_from_gripper).tolist()


@dataclass(frozen=True, eq=False)
class GivenScene:
    """A given grasp in its preprocessed scene.

    Attributes:
        grasp: as given.
        seen: the scene.
        world_from_tcp: (4, 4).
    """

    grasp: GivenGrasp
    seen: Perceived
    world_from_tcp: Matrix


def given_scene(grasp: GivenGrasp, gripper: Gripper, settings: SceneSettings) -> GivenScene:
    """Preprocess a scene as a synthesis does.

    Raises:
        DataError: the grasp is far from everything that was seen; the message names the frame or
            unit in which it would not be.
        MegraspError: the cloud is of no use; the message begins with its name.
    """
    try:
        seen = perceive(grasp.cloud, grasp.request, settings)
    except MegraspError as error:
        raise type(error)(f"{grasp.name}: {error}") from error
    tcp = grasp.world_from_gripper @ gripper.gripper_from_tcp
    distance = _distance(seen, tcp)
    if distance > FARTHEST:
        raise DataError(_far(grasp, gripper, seen, distance))
    return GivenScene(grasp, seen, tcp)


def doubt(scenes: Sequence[GivenScene], gripper: Gripper) -> str | None:
    """What to ask whoever gave the grasps, where most of them collide with what was seen or close
    on nothing there.
    """
    probe = gripper_probe(gripper)
    as_given = sum(_usable(scene, scene.world_from_tcp, gripper, probe) for scene in scenes)
    if 2 * as_given > len(scenes):
        return None
    as_tcp = sum(_usable(s, s.grasp.world_from_gripper, gripper, probe) for s in scenes)
    told = (
        f"{len(scenes) - as_given} of {len(scenes)} grasps collide with what was seen, or close "
        "on nothing there"
    )
    if as_tcp > as_given:
        return (
            f"{told}; read as world_from_tcp only {len(scenes) - as_tcp} do. Is this "
            "world_from_tcp? Expected world_from_gripper, the frame of the gripper's description: "
            f"`megrasp gripper show {gripper.name}` has the TCP in it."
        )
    return (
        f"{told}. Expected world_from_gripper of the open gripper before it closes: +Z approach, "
        "+X closing, in the frame of the cloud. Look at one with `megrasp view`."
    )


def _usable(scene: GivenScene, tcp: Matrix, gripper: Gripper, probe: GripperProbe) -> bool:
    judge = scene.seen.judge
    assessed = judge.assess(pose_set(tcp[None], gripper, judge.request), probe, None)
    return str(assessed.check.reason[0]) not in UNUSABLE


def _distance(seen: Perceived, pose: Matrix) -> float:
    return float(np.linalg.norm(seen.surface.points - pose[:3, 3], axis=1).min())


def _far(grasp: GivenGrasp, gripper: Gripper, seen: Perceived, distance: float) -> str:
    given, gripper_from_tcp = grasp.world_from_gripper, np.asarray(gripper.gripper_from_tcp)
    scaled = given.copy()
    scaled[:3, 3] *= 0.001
    readings = {
        "in millimetres": scaled @ gripper_from_tcp,
        "as world_from_tcp": given,
        "as gripper_from_world": np.linalg.inv(given) @ gripper_from_tcp,
    }
    near = [name for name, tcp in readings.items() if _distance(seen, tcp) < NEAR]
    low, high = (f(seen.surface.points, axis=0).round(3).tolist() for f in (np.min, np.max))
    guess = f" Read {' or '.join(near)} it lies at the cloud: is it that?" if near else ""
    return (
        f"{grasp.name}: the TCP of the grasp is {distance:.3g} m from the nearest point of its "
        f"cloud, which reaches from {low} to {high}; expected at most {FARTHEST:g} m.{guess} Give "
        "world_from_gripper in metres and in the frame of the cloud."
    )
