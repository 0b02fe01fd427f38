"""Labelled scenes: laid out, seen, grasped in the heap; recipes from which they are made again."""

from .generation import SceneJob, build_scene, generate_scenes
from .layout import GRAVITY, Layout, SceneConfig, ViewShares, draw_layout, region_of
from .observing import scene_cameras
from .recipes import read_recipes, with_cloud, write_recipes
from .robust import RobustSettings, RobustTrials, robust_labels
from .robust_run import generate_robust

__all__ = [
    "GRAVITY",
    "Layout",
    "RobustSettings",
    "RobustTrials",
    "SceneConfig",
    "SceneJob",
    "ViewShares",
    "build_scene",
    "draw_layout",
    "generate_robust",
    "generate_scenes",
    "read_recipes",
    "region_of",
    "robust_labels",
    "scene_cameras",
    "with_cloud",
    "write_recipes",
]
