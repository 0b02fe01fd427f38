"""Lie groups of grasp poses: SO(3), SE(3), Wigner D matrices, isotropic Gaussians on SO(3)."""

from megrasp_core.lie import igso3, pose, se3, so3, wigner
from megrasp_core.lie.pose import matrix_from_pose7, pose7_from_matrix
from megrasp_core.lie.wigner import irreps_dim, rotate, wigner_d, wigner_matrices

__all__ = [
    "igso3",
    "irreps_dim",
    "matrix_from_pose7",
    "pose",
    "pose7_from_matrix",
    "rotate",
    "se3",
    "so3",
    "wigner",
    "wigner_d",
    "wigner_matrices",
]
