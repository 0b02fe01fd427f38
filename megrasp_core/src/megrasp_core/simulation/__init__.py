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
from megrasp_core.simulation.depth_noise import DepthNoise
from megrasp_core.simulation.free_space import FreeSpaceResult, FreeSpaceRig, FreeSpaceSettings
from megrasp_core.simulation.motion import Shake
from megrasp_core.simulation.rendering import Snapshot, observe, render_depth, render_view
from megrasp_core.simulation.start_collision import approach_path, start_depths
from megrasp_core.simulation.support import Bin
from megrasp_core.simulation.verdict import Reason, TrialSettings, Verdict, judge
from megrasp_core.simulation.view import View
from megrasp_core.simulation.world import World, WorldState, build_world

__all__ = [
    "Bin",
    "Camera",
    "ClutterSettings",
    "DepthNoise",
    "FreeSpaceResult",
    "FreeSpaceRig",
    "FreeSpaceSettings",
    "Reason",
    "SettledScene",
    "Shake",
    "Snapshot",
    "TopDownCamera",
    "TrialSettings",
    "Verdict",
    "View",
    "World",
    "WorldState",
    "approach_path",
    "build_world",
    "deepest_contact",
    "depth_to_points",
    "judge",
    "look_at",
    "observe",
    "render_depth",
    "render_view",
    "ring_cameras",
    "settle",
    "start_depths",
]
