"""Point clouds: files, regions, voxel means, normals, support plane, scene nodes."""

from megrasp_core.pointcloud.box import OrientedBox
from megrasp_core.pointcloud.cloud import Cloud
from megrasp_core.pointcloud.io import read_cloud, write_cloud
from megrasp_core.pointcloud.neighbours import estimate_normals, neighbours, remove_outliers
from megrasp_core.pointcloud.plane import Plane, PlaneSettings, support_plane
from megrasp_core.pointcloud.sampling import farthest_from_centroid, farthest_points
from megrasp_core.pointcloud.scene import (
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
from megrasp_core.pointcloud.voxels import VoxelGroups, voxel_means

__all__ = [
    "Cloud",
    "OrientedBox",
    "Plane",
    "PlaneSettings",
    "SceneNodes",
    "SceneSettings",
    "SurfacePoints",
    "SurfaceCloud",
    "VoxelGroups",
    "choose_nodes",
    "estimate_normals",
    "farthest_from_centroid",
    "farthest_points",
    "grown_region",
    "neighbours",
    "node_counts",
    "nodes_at",
    "read_cloud",
    "remove_outliers",
    "scene_nodes",
    "support_plane",
    "surface_cloud",
    "voxel_means",
    "write_cloud",
]
