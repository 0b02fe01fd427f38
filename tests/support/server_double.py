"""The real node grasp_server with a test double in place of the synthesizer.

The parameter `model` says how the double behaves: `quick` and `slow` return grasps above the
cloud's centre, `none` finds nothing, `memory` runs out of memory, `short` does unless few poses
are computed at a time, `preferring` scores robotiq_3f higher, `broken` fails, `damaged` cannot be
loaded, `late` takes its time to be.
"""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import numpy as np

from megrasp_core.errors import CancelledError, ModelError
from megrasp_core.grippers import load_gripper
from megrasp_core.pointcloud import only_support_left
from megrasp_core.synthesizer import RankedGrasp, Synthesis, SynthesisRequest, pose_set
from megrasp_ros.server.grasp_server import main

STEPS = 20
SLOW_STEP = 0.25
FEW = 16
LATE = 8.0


class DoubleSynthesizer:
    """Answers like megrasp_core.synthesizer.GraspSynthesizer, without a network."""

    def __init__(self, behaviour: str) -> None:
        trained = {"robotiq_2f85": load_gripper("robotiq_2f85").hash}
        self.model = SimpleNamespace(
            model_id=behaviour, info=SimpleNamespace(trained_grippers=trained)
        )
        self.behaviour = behaviour
        self.gripper = None
        self.threads: set[int] = set()

    def model_for(self, gripper) -> SimpleNamespace:
        return self.model

    def set_gripper(self, gripper) -> None:
        self.gripper = gripper

    def synthesize(
        self, cloud, *, num_grasps, drawn, seed, on_step, on_poses, cancelled, exclude, **options
    ):
        self.threads.add(threading.get_ident())
        assert len(self.threads) == 1, "the synthesizer belongs to one thread"
        for step in range(STEPS):
            if cancelled():
                raise CancelledError("stopped")
            time.sleep(SLOW_STEP if self.behaviour == "slow" else 0.0)
            on_step("sample", step + 1, STEPS)
            on_poses(pose_set(np.eye(4)[None], self.gripper, SynthesisRequest()))
        on_step("rank", 1, 1)
        at_once = options.get("at_once")
        if self.behaviour == "memory" or (
            self.behaviour == "short" and (at_once is None or at_once > FEW)
        ):
            raise MemoryError(f"no room for {at_once or 'all'} poses")
        if self.behaviour == "broken":
            raise KeyError("a bug")
        rng = np.random.default_rng(seed)
        # Above the centre of what stands out, so that it is known where the grasps have to be.
        down = np.asarray(options["gravity"])
        target = options["target"]
        points = cloud.points if target is None else cloud.points[cloud.labels == target]
        height = -points @ down
        centre = points[height > height.max() - 0.02].mean(axis=0)
        nearest = np.linalg.norm(cloud.points - centre, axis=1).argmin()
        label = 0 if cloud.labels is None else int(cloud.labels[nearest])
        best = 0.95 if self.behaviour == "preferring" and "3f" in self.gripper.name else 0.9
        grasps = []
        for rank in range(0 if self.behaviour == "none" else num_grasps):
            tcp = np.eye(4)
            tcp[:3, :3] = _turned_to(down) @ _about_z(rng.uniform(0, np.pi))
            tcp[:3, 3] = centre
            gripper = tcp @ np.linalg.inv(self.gripper.gripper_from_tcp)
            approach = gripper.copy()
            approach[:3, 3] -= options["approach_distance"] * gripper[:3, 2]
            grasps.append(
                RankedGrasp(
                    world_from_tcp=tcp,
                    world_from_gripper=gripper,
                    world_from_gripper_approach=approach,
                    world_from_gripper_retreat=approach,
                    score=best - 0.01 * rank,
                    width=0.03,
                    clearance=0.01,
                    tilt=0.0,
                    collision_free=True,
                    width_tolerance=0.004,
                    opening=0.06,
                    object=label or None,
                )
            )
        return Synthesis(
            grasps=grasps,
            rejected={"collision": drawn - len(grasps), "tilt": 0},
            timing={"perceive": 0.01, "encode": 0.02, "sample": 0.03, "rank": 0.04, "total": 0.1},
            seed=seed,
            drawn=drawn,
            evaluations=1,
            gripper=self.gripper.name,
            model="double",
            notes=("made up",),
            hints=() if grasps else ("All collide: try another gripper.",),
            bin_empty=only_support_left(cloud.points, options["region"], down),
        )


def _turned_to(direction: np.ndarray) -> np.ndarray:
    x = np.cross([0.0, 1.0, 0.3], direction)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction], axis=1)


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def make(model: str | None, device: str, threads: int | None) -> DoubleSynthesizer:
    if model == "late":
        time.sleep(LATE)
    if model == "damaged":
        raise ModelError(
            "model.safetensors of 'damaged' does not fit; expected a model folder. Set `model`."
        )
    return DoubleSynthesizer(model or "quick")


if __name__ == "__main__":
    main(factory=make)
