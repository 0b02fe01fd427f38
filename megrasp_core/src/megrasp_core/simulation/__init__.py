"""MuJoCo simulation: worlds, the verdict on grasps, free-space trials, clutter, depth cameras."""

from .assembly import Guard
from .camera import Camera, TopDownCamera, depth_to_points, look_at, ring_cameras
from .clutter import ClutterSettings, SettledScene, deepest_contact, settle
from .depth_noise import EFFECTS, DepthNoise
from .free_space import FreeSpaceResult, FreeSpaceRig, FreeSpaceSettings, label_timestep
from .light import Light
from .motion import Shake
from .noise_presets import NOISES, noise_named
from .rendering import Snapshot, observe, render_depth, render_view
from .rigs import ViewName, rig, sparse_camera
from .start_collision import START_DEPTH, approach_path, start_contacts, start_depths
from .support import Bin
from .variation import Variation, varied
from .verdict import Reason, TrialSettings, Verdict, judge
from .view import View
from .world import World, WorldState, build_world

__all__ = [
    "Bin",
    "Camera",
    "ClutterSettings",
    "DepthNoise",
    "EFFECTS",
    "FreeSpaceResult",
    "FreeSpaceRig",
    "FreeSpaceSettings",
    "Guard",
    "Light",
    "NOISES",
    "Reason",
    "START_DEPTH",
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
    "label_timestep",
    "look_at",
    "noise_named",
    "observe",
    "render_depth",
    "render_view",
    "rig",
    "ring_cameras",
    "settle",
    "sparse_camera",
    "start_contacts",
    "start_depths",
    "varied",
]
