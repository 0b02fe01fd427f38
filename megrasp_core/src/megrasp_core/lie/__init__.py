"""Lie groups of grasp poses: SO(3), batches of poses, Wigner D, isotropic Gaussians on SO(3)."""

from .coupling import coupling, spherical_harmonics
from .pose import matrix_from_pose7, pose7_from_matrix
from .pose_batch import PoseBatch
from .precision import full_precision
from .wigner import irreps_dim, rotate, wigner_d, wigner_matrices

__all__ = [
    "PoseBatch",
    "coupling",
    "full_precision",
    "irreps_dim",
    "matrix_from_pose7",
    "pose7_from_matrix",
    "rotate",
    "spherical_harmonics",
    "wigner_d",
    "wigner_matrices",
]
