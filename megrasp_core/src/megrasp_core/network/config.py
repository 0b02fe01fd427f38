"""Shapes and sizes of the network, as stored in `config.json` of a model."""

from __future__ import annotations

import dataclasses
from typing import Any

from megrasp_core.errors import ModelError

from .irreps import multiplicities


@dataclasses.dataclass(frozen=True)
class ModelConfig:
    """Sizes of one network (docs/architecture.md, "Network").

    Irreps are written as e3nn does; parity is natural (0e, 1o, 2e).
    """

    fine_irreps: str = "32x0e+16x1o+8x2e"
    """Features of the finest level."""
    coarse_irreps: str = "64x0e+32x1o+16x2e"
    """Features of the coarser levels."""
    token_irreps: str = "48x0e+16x1o+8x2e"
    """What a node hands to the decoder, before it is turned into the TCP frame."""
    level_ratio: int = 4
    """Nodes of a level divided by nodes of the next."""
    levels: int = 3
    """Of the encoder, each with fewer nodes."""
    blocks: tuple[int, ...] = (1, 2, 2)
    """Convolution blocks on the way down, per level; the way up has one each."""
    neighbours: int = 16
    """Nodes that a convolution gathers, within a level and from the finer one."""
    up_neighbours: int = 4
    """Nodes of the coarser level that a node gathers on the way up."""
    radii: tuple[float, ...] = (0.04, 0.08, 0.16)
    """Range (m) of the radial basis per level."""
    fine_neighbours: int = 0
    """Voxel points that a node of the finest level gathers in the first block instead of
    neighbouring nodes; 0: neighbouring nodes. Nodes lie a centimetre apart, voxel points 4 mm."""
    fine_radius: float = 0.016
    """Range (m) of the radial basis among the voxel points."""
    radial_functions: int = 12
    """Functions of the distance that weigh an edge."""
    radial_hidden: int = 32
    """Width of the small network that makes weights of them."""
    width: int = 128
    """Width of the decoder's tokens."""
    heads: int = 4
    """Of the attention; they share the width."""
    decoder_blocks: int = 3
    """In which gripper tokens attend to nodes."""
    gripper_tokens: int = 32
    """Tokens per posture; open and closed together are twice as many."""
    gripper_layers: int = 2
    """In which gripper tokens attend to each other, once a gripper."""
    scene_tokens: tuple[int, ...] = (96, 48, 32)
    """Nodes per level that a pose looks at."""
    selection_tokens: int = 16
    """Gripper tokens that decide which nodes are near (farthest points of all tokens)."""
    position_scale: float = 0.10
    """Length (m) by which coordinates are divided before the Fourier features."""
    position_octaves: int = 5
    """Fourier frequencies of a coordinate, each twice the one before."""
    sigma_t: float = 0.08
    """Noise of the translation per axis at level 1 (m)."""
    sigma_r: float = 2.0
    """Noise of the rotation at level 1 (rad)."""
    s_min: float = 0.03
    """Lowest level of noise."""

    def __post_init__(self) -> None:
        """Refuse sizes that do not go together.

        Raises:
            ModelError: they do not.
        """
        wrong = []
        for name in ("blocks", "radii", "scene_tokens"):
            entries = list(getattr(self, name))
            if len(entries) != self.levels:
                wrong.append(f"{name} {entries} has not {self.levels} entries, one a level")
        if self.levels < 2:
            wrong.append(f"levels {self.levels} is below 2")
        if self.heads < 1 or self.width % self.heads:
            wrong.append(f"width {self.width} cannot be divided by heads {self.heads}")
        for name in ("fine_irreps", "coarse_irreps", "token_irreps"):
            try:
                degrees = set(multiplicities(getattr(self, name)))
            except ValueError:
                degrees = set()
            if degrees != {0, 1, 2}:
                wrong.append(f"{name} {getattr(self, name)!r} is not of the form 32x0e+16x1o+8x2e")
        if wrong:
            raise ModelError(
                f"the network's sizes do not go together: {'; '.join(wrong)}. Change them, or "
                "take a preset as it is."
            )

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> ModelConfig:
        """Read a config; unknown names are an error that lists the valid ones.

        Raises:
            ModelError: an unknown field.
        """
        names = {f.name for f in dataclasses.fields(cls)}
        unknown = sorted(set(values) - names)
        if unknown:
            raise ModelError(
                f"network config has unknown fields {unknown}; expected some of {sorted(names)}. "
                "The model was made by another version: install that version or retrain."
            )
        lists: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in values.items()
        }
        return cls(**lists)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return dataclasses.asdict(self)


PRESETS: dict[str, ModelConfig] = {
    "tiny": ModelConfig(
        fine_irreps="8x0e+4x1o+2x2e",
        coarse_irreps="8x0e+4x1o+2x2e",
        token_irreps="8x0e+4x1o+2x2e",
        blocks=(1, 1, 1),
        width=16,
        heads=2,
        decoder_blocks=1,
        gripper_tokens=8,
        scene_tokens=(16, 8, 8),
        selection_tokens=8,
    ),
    "small": ModelConfig(
        fine_irreps="16x0e+8x1o+4x2e",
        coarse_irreps="32x0e+16x1o+8x2e",
        token_irreps="32x0e+8x1o+4x2e",
        width=64,
        gripper_tokens=16,
        scene_tokens=(48, 24, 16),
    ),
    "base": ModelConfig(),
}
"""`tiny` for tests, `small` for training on a CPU, `base` for a GPU."""
