"""The whole network: scene encoder, gripper encoder, decoder and heads."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor, nn

from megrasp_core.grippers import GripperTokens
from megrasp_core.lie import PoseBatch
from megrasp_core.pointcloud import SceneNodes, SurfacePoints

from .config import ModelConfig
from .convolution import ReducedConvolution, SelfProduct
from .decoder import Decoder
from .graph import SceneGraph, build_graph
from .gripper_encoder import GripperCode, GripperEncoder
from .info import ModelInfo
from .irreps import multiplicities
from .kernels import require_kernels
from .scene_encoder import SceneEncoder, SceneField, SurfaceInput


@dataclasses.dataclass(frozen=True)
class Prediction:
    """What the network says about noisy poses, all in the TCP frame.

    Attributes:
        residual: `(P, 6)` E[y | r_s]: translation, then rotation vector, in units of the noise.
        score: `(P, 3)` rotation score times s sigma_r.
    """

    residual: Tensor
    score: Tensor


class GraspModel(nn.Module):
    """p(world_from_tcp | gripper, scene, gravity) as a denoiser on SE(3) (docs/architecture.md,
    "Network").
    """

    def __init__(self, config: ModelConfig, *, model_id: str = "untrained") -> None:
        super().__init__()
        self.config = config
        self.info = ModelInfo(config, model_id)
        self.low_precision = False
        """Run the token part in bfloat16 (poses, features and the last layers stay as they
        are)."""
        self.scene_encoder = SceneEncoder(config)
        self.gripper_encoder = GripperEncoder(config)
        self.decoder = Decoder(config)
        self.confidence_decoder = Decoder(dataclasses.replace(config, decoder_blocks=1))
        dim, width = self.decoder.dim, config.width
        self.residual_head = _head(dim, width, 6)
        self.score_head = _head(dim, width, 3)
        self.confidence_head = _head(2 * dim, width, 1)
        scalars = multiplicities(config.coarse_irreps)[0]
        self.graspability_head = _head(scalars + width, width, 1)

    @property
    def model_id(self) -> str:
        """The model's name."""
        return self.info.model_id

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return next(self.parameters()).device

    @property
    def dtype(self) -> torch.dtype:
        """Type of the weights."""
        return next(self.parameters()).dtype

    def use_kernels(self) -> None:
        """Let compiled kernels do on a CPU what they do faster than torch; they are made at first
        use.

        Raises:
            InvalidRequestError: numba is missing.
        """
        require_kernels()
        for module in self.modules():
            if isinstance(module, (ReducedConvolution, SelfProduct, Decoder)):
                module.compiled = True

    def encode_scene(self, nodes: SceneNodes, graph: SceneGraph | None = None) -> SceneField:
        """Encode a preprocessed cloud; once per cloud.

        Args:
            nodes: centred points, normals, plane flags and gravity.
            graph: levels and neighbours; built from the points when absent.
        """
        graph = build_graph(nodes, self.config) if graph is None else graph

        def tensor(values: object, dtype: torch.dtype | None = None) -> Tensor:
            return torch.as_tensor(values, dtype=dtype or self.dtype, device=self.device)

        def points(cloud: SceneNodes | SurfacePoints) -> SurfaceInput:
            return SurfaceInput(
                tensor(cloud.points), tensor(cloud.normals), tensor(cloud.on_plane, torch.bool)
            )

        fine = self.config.fine_neighbours > 0 and nodes.surface is not None
        return self.scene_encoder(
            points(nodes),
            points(nodes.surface) if fine and nodes.surface is not None else None,
            tensor(nodes.gravity),
            graph.to(self.device),
        )

    def encode_gripper(self, tokens: GripperTokens) -> GripperCode:
        """Encode a gripper's open and closed points; once per gripper."""
        return self.encode_grippers([tokens])[0]

    def encode_grippers(self, tokens: Sequence[GripperTokens]) -> list[GripperCode]:
        """Encode several grippers, with equally many tokens, together."""

        def tensor(name: str) -> Tensor:
            values = np.stack([getattr(part, name) for part in tokens])
            return torch.as_tensor(values, dtype=self.dtype, device=self.device)

        return self.gripper_encoder(
            tensor("points"), tensor("normals"), tensor("closed"), tensor("displacement")
        )

    def predict(
        self, field: SceneField, code: GripperCode, poses: PoseBatch, s: Tensor
    ) -> Prediction:
        """Denoise poses.

        Args:
            field: the scene.
            code: the gripper.
            poses: P, scene_from_tcp, centred scene coordinates.
            s: `(P,)` noise levels in `[s_min, 1]`.
        """
        with self._tokens():
            feature = self.decoder(field, code, poses, s)
        feature = feature.to(self.dtype)
        return Prediction(self.residual_head(feature), self.score_head(feature))

    def confidence(self, field: SceneField, code: GripperCode, poses: PoseBatch) -> Tensor:
        """Logit `(P,)` that the verdict on these poses is success."""
        s = torch.full((len(poses),), self.config.s_min, dtype=self.dtype, device=self.device)
        with self._tokens():
            near = self.decoder.near_nodes(field, code, poses)
            shared = self.decoder(field, code, poses, s, near)
            own = self.confidence_decoder(field, code, poses, s, near)
        feature = torch.cat([shared, own], -1).to(self.dtype)
        return self.confidence_head(feature).squeeze(-1)

    def graspability(self, field: SceneField, code: GripperCode) -> Tensor:
        """Logit `(n_1,)` that a grasp of this gripper has its TCP near a node of the second
        level.
        """
        gripper = code.tokens.mean(0).expand(len(field.invariants), -1)
        return self.graspability_head(torch.cat([field.invariants, gripper], -1)).squeeze(-1)

    @contextmanager
    def _tokens(self) -> Iterator[None]:
        """Lower precision for the token part where it was asked for."""
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.low_precision):
            yield


def _head(dim: int, width: int, out: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(dim, 2 * width), nn.SiLU(), nn.Linear(2 * width, out))
