"""Triangle meshes: repair, rays against them, points on them, fewer triangles; farthest points."""

from .farthest import farthest_from_centroid, farthest_points
from .mesh import Mesh, joined
from .rays import Hits, RayScene
from .repair import Repair, is_closed, repaired, winding_number
from .sampling import SurfaceSample, sample_stratified, sample_uniform
from .simplifying import simplified
from .thinning import thinned

__all__ = [
    "Hits",
    "Mesh",
    "RayScene",
    "Repair",
    "SurfaceSample",
    "farthest_from_centroid",
    "farthest_points",
    "is_closed",
    "joined",
    "repaired",
    "sample_stratified",
    "sample_uniform",
    "simplified",
    "thinned",
    "winding_number",
]
