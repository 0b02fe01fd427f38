"""MuJoCo simulation: worlds, the verdict on grasps, free-space trials, clutter, depth cameras."""

from megrasp_core.simulation.camera import (
    Camera,
    TopDownCamera,
    depth_to_points,
    look_at,
    ring_cameras,
)
from megrasp_core.simulation.clutter import (
    ClutterSettings,
    SettledScene,
    deepest_contact,
    settle,
)
from megrasp_core.simulation.depth_noise import EFFECTS, DepthNoise
from megrasp_core.simulation.free_space import FreeSpaceResult, FreeSpaceRig, FreeSpaceSettings
from megrasp_core.simulation.light import Light
from megrasp_core.simulation.motion import Shake
from megrasp_core.simulation.noise_presets import NOISES, noise_named
from megrasp_core.simulation.rendering import Snapshot, observe, render_depth, render_view
from megrasp_core.simulation.rigs import ViewName, rig, sparse_camera
from megrasp_core.simulation.start_collision import approach_path, start_depths
from megrasp_core.simulation.support import Bin
from megrasp_core.simulation.variation import Variation, varied
from megrasp_core.simulation.verdict import Reason, TrialSettings, Verdict, judge
from megrasp_core.simulation.view import View
from megrasp_core.simulation.world import World, WorldState, build_world

__all__ = [
    "EFFECTS",
    "NOISES",
    "Bin",
    "Camera",
    "ClutterSettings",
    "DepthNoise",
    "FreeSpaceResult",
    "FreeSpaceRig",
    "FreeSpaceSettings",
    "Light",
    "Reason",
    "SettledScene",
    "Shake",
    "Snapshot",
    "TopDownCamera",
    "TrialSettings",
    "Variation",
    "Verdict",
    "View",
    "ViewName",
    "World",
    "WorldState",
    "approach_path",
    "build_world",
    "deepest_contact",
    "depth_to_points",
    "judge",
    "look_at",
    "noise_named",
    "observe",
    "render_depth",
    "render_view",
    "rig",
    "ring_cameras",
    "settle",
    "sparse_camera",
    "start_depths",
    "varied",
]
