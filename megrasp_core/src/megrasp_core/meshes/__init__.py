"""Triangle meshes: repair, rays against them, points on them, fewer triangles; farthest points."""

from .farthest import farthest_from_centroid, farthest_points
from .mesh import Mesh, joined
from .rays import Hits, RayScene
from .repair import Repair, repaired
from .sampling import SurfaceSample, sample_stratified, sample_uniform
from .simplifying import simplified
from .surfaces import SurfaceScene
from .thinning import thinned

__all__ = [
    "Hits",
    "Mesh",
    "RayScene",
    "Repair",
    "SurfaceSample",
    "SurfaceScene",
    "farthest_from_centroid",
    "farthest_points",
    "joined",
    "repaired",
    "sample_stratified",
    "sample_uniform",
    "simplified",
    "thinned",
]
