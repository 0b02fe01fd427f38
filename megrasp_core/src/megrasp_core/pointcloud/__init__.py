"""Point clouds: files, regions, voxel means, normals, support plane, scene nodes."""

from .bins import BinSettings, FoundBin, find_bin
from .box import OrientedBox
from .cloud import Cloud
from .depth_image import DepthImage, DepthImageSettings
from .depth_points import camera_matrix, depth_cloud, depth_points, read_depth_cloud
from .emptiness import check_not_upside_down, only_support_left
from .gravity import unit_gravity
from .io import read_cloud, without_zeros, write_cloud
from .knn import neighbours
from .plane import Plane, PlaneSettings, support_plane
from .scene import (
    SceneNodes,
    SceneSettings,
    SurfaceCloud,
    SurfacePoints,
    choose_nodes,
    grown_region,
    node_counts,
    nodes_at,
    scene_nodes,
    surface_cloud,
)
from .unseen_structure import UnseenStructure, level_floor, unseen_structure
from .view_check import check_view
from .views import View, by_sensor
from .voxels import VoxelGroups, voxel_means

__all__ = [
    "BinSettings",
    "Cloud",
    "FoundBin",
    "DepthImage",
    "DepthImageSettings",
    "OrientedBox",
    "Plane",
    "PlaneSettings",
    "SceneNodes",
    "SceneSettings",
    "SurfaceCloud",
    "SurfacePoints",
    "UnseenStructure",
    "View",
    "VoxelGroups",
    "by_sensor",
    "camera_matrix",
    "check_not_upside_down",
    "check_view",
    "choose_nodes",
    "depth_cloud",
    "depth_points",
    "find_bin",
    "grown_region",
    "level_floor",
    "neighbours",
    "node_counts",
    "only_support_left",
    "nodes_at",
    "read_cloud",
    "read_depth_cloud",
    "scene_nodes",
    "support_plane",
    "surface_cloud",
    "unit_gravity",
    "unseen_structure",
    "voxel_means",
    "without_zeros",
    "write_cloud",
]
