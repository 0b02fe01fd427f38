"""What the camera sees of a scene: the same noise and preprocessing as at inference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from megrasp_core.objects import ObjectSet
from megrasp_core.pointcloud import SurfaceCloud, surface_cloud
from megrasp_core.simulation import Camera, TopDownCamera, build_world, observe, rig

from .layout import CAMERA, GRAVITY, Layout, SceneConfig, stream


def scene_cameras(seed: int, config: SceneConfig, *, in_bin: bool) -> list[Camera]:
    """The cameras of a scene: over bins top-down, a little moved and tilted; over tables this or
    another of the config's views.
    """
    rng = stream(seed, CAMERA)
    view = "top_down" if in_bin else config.views.drawn(rng)
    if view != "top_down":
        return rig(view, rng)
    width, height = config.image
    nominal = TopDownCamera(config.camera_height, width_px=width, height_px=height)
    shift = rng.uniform(-1.0, 1.0, size=3) * config.camera_shift
    tilt = rng.uniform(-1.0, 1.0, size=3) * config.camera_tilt
    pose = np.array(nominal.world_from_camera, np.float64)
    pose[:3, 3] += shift
    pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(tilt).as_matrix()
    return [replace(nominal, world_from_camera=pose)]


def scene_surface(
    layout: Layout, seed: int, config: SceneConfig, objects: ObjectSet
) -> SurfaceCloud:
    """Renders the scene of a layout with the camera and the noise of its seed and preprocesses the
    cloud.

    Raises:
        EmptyRegionError: nothing of the region was seen.
    """
    world = build_world([objects[name] for name in layout.object_names], bin=layout.bin)
    world.set_object_poses(layout.matrices)
    cameras = scene_cameras(seed, config, in_bin=layout.bin is not None)
    cloud = observe(
        world, cameras if len(cameras) > 1 else cameras[0], config.noise, stream(seed, CAMERA, 1)
    )
    return surface_cloud(
        cloud,
        sensor=cloud.viewpoint,
        gravity=np.array(GRAVITY),
        region=layout.region,
        settings=config.surface,
    )
