"""`megrasp data few`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import tyro

from megrasp_core.cli.common import say
from megrasp_core.errors import DataError, InvalidRequestError

__all__ = ["few"]


def few(
    data: Path,
    gripper: str,
    out: Path,
    num_grasps: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 10,
    seed: int = 1,
) -> int:
    """One grasp of each of some scenes, with its cloud, as `megrasp finetune` reads them.

    Only grasps that were tried in the scene and held are taken.

    Try:
      megrasp data scenes --validation --out scenes --library models/grasp_library \
        --gripper robotiq_2f140 -n 16 --trials 24
      megrasp data few --data scenes --gripper robotiq_2f140 --out few

    Args:
        data: folder of `data scenes`.
        gripper: name, or folder of a gripper.yaml, that the scenes have labels of.
        out: folder for grasps.json and the clouds.
        num_grasps: how many scenes, each with one grasp.
        seed: decides which scenes and which grasps.
    """
    import numpy as np

    from megrasp_core.grippers import load_gripper
    from megrasp_core.lie import matrix_from_pose7, pose7_from_matrix
    from megrasp_core.pointcloud import Cloud, write_cloud
    from megrasp_core.storage import Kind, SceneDataset

    if num_grasps < 1:
        raise InvalidRequestError(f"--num-grasps {num_grasps} was given; expected at least 1.")
    loaded, dataset = load_gripper(gripper), SceneDataset(data)
    rng = np.random.default_rng(seed)
    entries = []
    for index in rng.permutation(len(dataset)):
        scene = dataset[int(index)]
        labels = scene.labels.get(loaded.name)
        if labels is None or len(entries) == num_grasps:
            continue
        held = np.flatnonzero((labels.label == 1) & (labels.kind == Kind.JUDGED))
        if not len(held):
            continue
        tcp = matrix_from_pose7(labels.world_from_tcp[rng.choice(held)].astype(np.float64))
        cloud = Cloud(scene.points.astype(np.float64), viewpoint=scene.sensor.astype(np.float64))
        write_cloud(out / f"{scene.name}.npz", cloud)
        pose = pose7_from_matrix(tcp @ loaded.tcp_from_gripper)
        entries.append({"cloud": f"{scene.name}.npz", "world_from_gripper": pose.tolist()})
    if len(entries) < num_grasps:
        raise DataError(
            f"{data} has {len(entries)} scenes in which {loaded.name} held something; expected "
            f"{num_grasps}. Make more with `megrasp data scenes`."
        )
    (out / "grasps.json").write_text(json.dumps(entries, indent=1) + "\n")
    say(f"wrote {len(entries)} grasps to {out / 'grasps.json'}")
    return 0
