"""Point clouds: files, regions, voxel means, normals, support plane, scene nodes."""

from .bins import BinSettings, FoundBin, find_bin
from .box import OrientedBox
from .cloud import Cloud
from .emptiness import only_support_left
from .io import read_cloud, write_cloud
from .knn import estimate_normals, neighbours, remove_outliers
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
from .voxels import VoxelGroups, voxel_means

__all__ = [
    "BinSettings",
    "Cloud",
    "FoundBin",
    "OrientedBox",
    "Plane",
    "PlaneSettings",
    "SceneNodes",
    "SceneSettings",
    "SurfaceCloud",
    "SurfacePoints",
    "VoxelGroups",
    "choose_nodes",
    "estimate_normals",
    "find_bin",
    "grown_region",
    "neighbours",
    "node_counts",
    "only_support_left",
    "nodes_at",
    "read_cloud",
    "remove_outliers",
    "scene_nodes",
    "support_plane",
    "surface_cloud",
    "voxel_means",
    "write_cloud",
]
