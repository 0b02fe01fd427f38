"""How two steerable features of degrees l <= 2 couple to a third, and spherical harmonics.

Basis, order, signs and normalisation are e3nn's, which is the oracle in tests; importing it takes
as long as importing torch. Of natural parity all couplings come from one thing: degree 1 is a
vector, degree 2 a symmetric traceless matrix (`wigner.l2_basis`), and couplings are products of
these.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from megrasp_core.errors import InvalidRequestError

from .wigner import MAX_L, l2_basis

__all__ = ["coupling", "spherical_harmonics"]


def coupling(l1: int, l2: int, l3: int) -> Tensor:
    """The invariant tensor (2 l1 + 1, 2 l2 + 1, 2 l3 + 1) of three degrees, float64, of norm 1
    (e3nn's `wigner_3j`).

    Raises:
        InvalidRequestError: a degree over 2, or degrees that do not couple with natural parity
            (their sum must be even and none more than the sum of the others).
    """
    degrees = (l1, l2, l3)
    if (
        min(degrees) < 0
        or max(degrees) > MAX_L
        or sum(degrees) % 2
        or 2 * max(degrees) > sum(degrees)
    ):
        raise InvalidRequestError(
            f"got degrees {degrees}; expected three of 0, 1, 2 with an even sum, none more than "
            "the sum of the others, for example (1, 1, 2)"
        )
    if 0 in degrees:
        size = 2 * max(degrees) + 1
        result = torch.eye(size, dtype=torch.float64) / math.sqrt(size)
        return result.unsqueeze(degrees.index(0)) if size > 1 else result.unsqueeze(0)
    matrices = l2_basis(torch.float64, torch.device("cpu")).view(3, 3, 5)
    if degrees == (2, 2, 2):
        product = torch.einsum("abi,bcj,cak->ijk", matrices, matrices, matrices)
        # What cancels leaves noise of the last bit, and those who multiply skip only zeros.
        product[product.abs() < 1e-12] = 0.0
        return product / product.norm()
    # (1, 1, 2) in some order: the degree of 2 goes where it was asked for.
    return (matrices / math.sqrt(5)).movedim(2, degrees.index(2)).contiguous()


def spherical_harmonics(unit: Tensor) -> dict[int, Tensor]:
    """Of degrees 1 and 2 at unit vectors (..., 3): {1: (..., 3), 2: (..., 5)}, component
    normalised, so that the mean square of each component over the sphere is 1.
    """
    x, y, z = unit.unbind(-1)
    root3, root5, root15 = math.sqrt(3), math.sqrt(5), math.sqrt(15)
    second = torch.stack(
        [
            root15 * x * z,
            root15 * x * y,
            root5 * (y.square() - 0.5 * (x.square() + z.square())),
            root15 * y * z,
            0.5 * root15 * (z.square() - x.square()),
        ],
        dim=-1,
    )
    return {1: root3 * unit, 2: second}
