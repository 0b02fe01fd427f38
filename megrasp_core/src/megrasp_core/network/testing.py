"""Equivariance checks for functions of geometry, in the spirit of e3nn's `assert_equivariant`.

The caller says how each input and output moves under a rigid motion D = (Q, u) of the world; the
check moves the inputs, calls the function, and compares with the moved outputs, motion by motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from megrasp_core.errors import InvalidRequestError
from megrasp_core.lie import so3, wigner

TOLERANCES = {torch.float64: 1e-9, torch.float32: 2e-4, torch.float16: 2e-2, torch.bfloat16: 5e-2}
"""Largest error per dtype, as a share of the output's largest component."""


@dataclass(frozen=True)
class EquivarianceCase:
    """One motion and one output.

    Attributes:
        motion: name of the motion.
        output: index of the output.
        kind: how that output moves.
        error: largest absolute difference.
        scale: largest absolute component of the output, at least `floor`.
        tolerance: allowed error / scale.
    """

    motion: str
    output: int
    kind: str
    error: float
    scale: float
    tolerance: float

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance; a NaN is not."""
        return self.error <= self.tolerance * self.scale

    def __str__(self) -> str:
        mark = "ok  " if self.passed else "FAIL"
        return (
            f"{mark} {self.motion:<22} output {self.output} ({self.kind}): error "
            f"{self.error:.3e}, scale {self.scale:.3e}, allowed {self.tolerance * self.scale:.3e}"
        )


def move(value: Tensor, kind: str, rotation: Tensor, translation: Tensor) -> Tensor:
    """A quantity after the motion (Q (3, 3), u (3,)) of the world.

    Args:
        value: any shape that fits `kind`.
        kind: "invariant"; "point" (..., 3); "vector" (..., 3); "rotation" (..., 3, 3) with
            columns in the world, such as R of world_from_tcp; "pose" (..., 4, 4); or irreps such
            as "8x0e+4x1o".
        rotation: Q.
        translation: u, in the unit of the points.

    Raises:
        InvalidRequestError: an unknown kind, or features that do not fit the irreps.
    """
    q = rotation.to(value.dtype) if value.is_floating_point() else rotation
    u = translation.to(q.dtype)
    if kind == "invariant":
        return value
    if kind == "point":
        return value @ q.T + u
    if kind == "vector":
        return value @ q.T
    if kind == "rotation":
        return q @ value
    if kind == "pose":
        moved = value.clone()
        moved[..., :3, :3] = q @ value[..., :3, :3]
        moved[..., :3, 3] = value[..., :3, 3] @ q.T + u
        return moved
    return wigner.rotate(value, kind, q)


def equivariance_report(
    function: Callable[..., Tensor | Sequence[Tensor]],
    inputs: Sequence[Tensor],
    kinds_in: Sequence[str],
    kinds_out: Sequence[str],
    *,
    trials: int = 3,
    distance: float = 1.0,
    tolerance: float | None = None,
    floor: float = 1e-3,
    generator: torch.Generator | None = None,
) -> list[EquivarianceCase]:
    """Errors of f(D x) against D f(x) for named and random motions; see `assert_equivariant`."""
    if len(inputs) != len(kinds_in):
        raise InvalidRequestError(f"got {len(inputs)} inputs and {len(kinds_in)} kinds for them")
    with torch.no_grad():
        expected_all = _as_list(function(*inputs))
        if len(expected_all) != len(kinds_out):
            raise InvalidRequestError(
                f"got {len(expected_all)} outputs and {len(kinds_out)} kinds for them"
            )
        cases = []
        for name, q, u in _motions(inputs[0], trials, distance, generator):
            moved = [move(x, k, q, u) for x, k in zip(inputs, kinds_in, strict=True)]
            outputs = _as_list(function(*moved))
            for i, kind in enumerate(kinds_out):
                expected = move(expected_all[i], kind, q, u).double()
                error = (outputs[i].double() - expected).abs()
                allowed = TOLERANCES[expected_all[i].dtype] if tolerance is None else tolerance
                size = float(expected.abs().max()) if expected.numel() else 0.0
                worst = float(error.max()) if error.numel() else 0.0
                cases.append(EquivarianceCase(name, i, kind, worst, max(size, floor), allowed))
    return cases


def assert_equivariant(
    function: Callable[..., Tensor | Sequence[Tensor]],
    inputs: Sequence[Tensor],
    kinds_in: Sequence[str],
    kinds_out: Sequence[str],
    *,
    trials: int = 3,
    distance: float = 1.0,
    tolerance: float | None = None,
    floor: float = 1e-3,
    generator: torch.Generator | None = None,
) -> list[EquivarianceCase]:
    """Check that a function commutes with rigid motions of the world, and return all cases.

    Motions: identity (repeatability), quarter turns about x, y, z, a half turn to top-down, a pure
    translation, and random rigid motions. Proper rotations only: Megrasp's parity is natural.

    Args:
        function: takes the inputs, returns a tensor or a sequence of tensors. It must be
            deterministic.
        inputs: tensors.
        kinds_in: one per input; see `move`.
        kinds_out: one per output.
        trials: random motions.
        distance: standard deviation of the translations' components, in the unit of the points.
        tolerance: allowed error over scale; by default by the output's dtype (`TOLERANCES`).
        floor: the least scale, so that outputs near zero are not compared digit by digit.
        generator: for the random motions; must live on the inputs' device.

    Raises:
        AssertionError: some case fails; the message lists every case.
        InvalidRequestError: counts or kinds do not fit.
    """
    cases = equivariance_report(
        function,
        inputs,
        kinds_in,
        kinds_out,
        trials=trials,
        distance=distance,
        tolerance=tolerance,
        floor=floor,
        generator=generator,
    )
    failed = sum(not case.passed for case in cases)
    if failed:
        lines = "\n".join(str(case) for case in cases)
        raise AssertionError(f"not equivariant in {failed} of {len(cases)} cases:\n{lines}")
    return cases


def _as_list(outputs: Tensor | Sequence[Tensor]) -> list[Tensor]:
    return [outputs] if isinstance(outputs, Tensor) else list(outputs)


def _motions(
    like: Tensor, trials: int, distance: float, generator: torch.Generator | None
) -> list[tuple[str, Tensor, Tensor]]:
    dtype = like.dtype if like.dtype == torch.float64 else torch.float32
    device = like.device
    zero = torch.zeros(3, dtype=dtype, device=device)
    eye = torch.eye(3, dtype=dtype, device=device)
    motions = [("identity", eye, zero)]
    for axis in range(3):
        turn = so3.exp(0.5 * math.pi * eye[axis])
        motions.append((f"quarter turn about {'xyz'[axis]}", turn, zero))
    down = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=dtype, device=device))
    motions.append(("top-down half turn", down, zero))

    def step() -> Tensor:
        return distance * torch.randn(3, generator=generator, dtype=dtype, device=device)

    motions.append(("translation", eye, step()))
    for trial in range(trials):
        q = so3.random_rotation(generator=generator, dtype=dtype, device=device)
        motions.append((f"random motion {trial + 1}", q, step()))
    return motions
