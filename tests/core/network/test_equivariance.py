"""The claim of docs/architecture.md: with the graph fixed, everything turns with the scene."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from network_scenes import motions, moved, on_flat, scene, tokens
from scipy.spatial.transform import Rotation

from megrasp_core.errors import InvalidRequestError
from megrasp_core.lie import PoseBatch, wigner
from megrasp_core.network import PRESETS, GraspModel, ModelConfig, build_graph
from megrasp_core.network.convolution import (
    Block,
    Edges,
    ReducedConvolution,
    SelfProduct,
    harmonics,
)
from megrasp_core.network.irreps import (
    EquivariantLinear,
    EquivariantNorm,
    Gate,
    Irreps,
    pack,
    unpack,
)

IRREPS = "8x0e+4x1o+3x2e"
TOLERANCE = {torch.float32: 1e-4, torch.float64: 1e-10}


@pytest.fixture(params=[torch.float32, torch.float64], ids=["float32", "float64"])
def dtype(request):
    return request.param


def relative(a: torch.Tensor, b: torch.Tensor) -> float:
    return float((a - b).abs().max() / b.abs().max())


def shaken(module: torch.nn.Module, dtype: torch.dtype) -> torch.nn.Module:
    """All parameters random, so that none hides an error by being 0 or 1."""
    generator = torch.Generator().manual_seed(3)
    for parameter in module.parameters():
        parameter.data += 0.3 * torch.randn(parameter.shape, generator=generator)
    return module.to(dtype)


@pytest.mark.parametrize("layer", [EquivariantNorm, Gate, SelfProduct, EquivariantLinear])
def test_pointwise_layers_are_equivariant(layer, dtype):
    module = shaken(layer(IRREPS, IRREPS) if layer is EquivariantLinear else layer(IRREPS), dtype)
    irreps_in, irreps_out = module.irreps_in, module.irreps_out
    run = on_flat(module)
    x = torch.randn(20, irreps_in.dim, dtype=dtype, generator=torch.Generator().manual_seed(0))
    for turn, _ in motions(5):
        rotation = torch.as_tensor(turn, dtype=dtype)
        turned_in = run(wigner.rotate(x, irreps_in, rotation))
        turned_out = wigner.rotate(run(x), irreps_out, rotation)
        assert relative(turned_in, turned_out) < TOLERANCE[dtype]


@pytest.mark.parametrize("make", ["convolution", "block"])
def test_message_passing_is_equivariant(make, dtype):
    torch.manual_seed(0)
    n, k = 30, 6
    vectors = 0.02 * torch.randn(n, k, 3, dtype=dtype)
    vectors[:, 0] = 0.0
    index = torch.randint(0, n, (n, k))
    basis = torch.rand(n, k, 5, dtype=dtype)
    x = torch.randn(n, Irreps.of(IRREPS).dim, dtype=dtype)
    if make == "convolution":
        module = shaken(ReducedConvolution(IRREPS, 5, 8), dtype)
    else:
        module = shaken(Block(IRREPS, IRREPS, irreps_target=IRREPS, radial=5, hidden=8), dtype)

    def run(x, v):
        features, edges = unpack(x, IRREPS), Edges(index, basis, harmonics(v))
        given = (features, edges) if make == "convolution" else (features, features, edges)
        return pack(module(*given))

    for turn, _ in motions(4):
        rotation = torch.as_tensor(turn, dtype=dtype)
        turned_in = run(wigner.rotate(x, IRREPS, rotation), vectors @ rotation.T)
        turned_out = wigner.rotate(run(x, vectors), module.irreps_out, rotation)
        assert relative(turned_in, turned_out) < TOLERANCE[dtype]


FINE = dataclasses.replace(PRESETS["tiny"], fine_neighbours=12)
"""A network that gathers voxel points of the surface first."""


def _model(dtype: torch.dtype, config: ModelConfig = PRESETS["tiny"]) -> GraspModel:
    torch.manual_seed(0)
    return shaken(GraspModel(config), dtype).eval()


def _poses(count: int, dtype: torch.dtype) -> PoseBatch:
    rotation = Rotation.random(count, random_state=5).as_matrix()
    # Identity and top-down poses are where an Euler-angle Wigner D breaks.
    rotation[0] = np.eye(3)
    rotation[1] = np.diag([1.0, -1.0, -1.0])
    shift = np.random.default_rng(5).uniform(-0.1, 0.1, (count, 3))
    return PoseBatch(torch.as_tensor(rotation, dtype=dtype), torch.as_tensor(shift, dtype=dtype))


@torch.no_grad()
@pytest.mark.parametrize("config", [PRESETS["tiny"], FINE], ids=["nodes", "fine"])
def test_scene_features_turn_with_the_scene(dtype, config):
    model, nodes = _model(dtype, config), scene()
    graph = build_graph(nodes, model.config)
    still = model.encode_scene(nodes, graph)
    for turn, shift in motions(3):
        rotation = torch.as_tensor(turn, dtype=dtype)
        field = model.encode_scene(moved(nodes, turn, shift), graph)
        for now, before in zip(field.features, still.features):
            wanted = wigner.rotate(before, model.config.token_irreps, rotation)
            assert relative(now, wanted) < TOLERANCE[dtype]
        assert relative(field.invariants, still.invariants) < TOLERANCE[dtype]


@torch.no_grad()
@pytest.mark.parametrize("gravity", ["known", "unknown"])
def test_prediction_is_invariant_in_the_tcp_frame(dtype, gravity):
    """p(D r | g, D o_s, D gamma) = p(r | g, o_s, gamma), through all heads."""
    model, nodes = _model(dtype), scene()
    if gravity == "unknown":
        nodes.gravity[:] = 0.0
    graph = build_graph(nodes, model.config)
    code = model.encode_gripper(tokens(model.config.gripper_tokens))
    poses = _poses(12, dtype)
    s = torch.linspace(0.03, 1.0, 12, dtype=dtype)

    def heads(nodes, poses):
        field = model.encode_scene(nodes, graph)
        prediction = model.predict(field, code, poses, s)
        confidence = model.confidence(field, code, poses)
        return prediction.residual, prediction.score, confidence, model.graspability(field, code)

    still = heads(nodes, poses)
    assert still[0].std(0).min() > 1e-3, "the prediction must depend on the pose to test anything"
    for turn, shift in motions(3, seed=2):
        d = torch.as_tensor(turn, dtype=dtype)
        now = heads(
            moved(nodes, turn, shift),
            PoseBatch(
                d @ poses.rotation,
                poses.translation @ d.T + torch.as_tensor(shift, dtype=dtype),
            ),
        )
        for a, b in zip(now, still):
            assert relative(a, b) < TOLERANCE[dtype]


@torch.no_grad()
def test_prediction_sees_gravity_and_scene():
    model, nodes = _model(torch.float64), scene()
    graph = build_graph(nodes, model.config)
    code = model.encode_gripper(tokens(model.config.gripper_tokens))
    poses = _poses(6, torch.float64)
    s = torch.full((6,), 0.3, dtype=torch.float64)
    field = model.encode_scene(nodes, graph)
    still = model.predict(field, code, poses, s).residual
    nodes.gravity[:] = [1.0, 0.0, 0.0]
    tilted = model.predict(model.encode_scene(nodes, graph), code, poses, s).residual
    other = model.encode_gripper(tokens(model.config.gripper_tokens, seed=9))
    swapped = model.predict(field, other, poses, s).residual
    assert relative(tilted, still) > 1e-3
    assert relative(swapped, still) > 1e-3


def test_rebuilt_graph_keeps_almost_all_edges():
    nodes = scene(800)
    graph = build_graph(nodes, PRESETS["tiny"])
    shares = []
    for turn, shift in motions(5):
        again = build_graph(moved(nodes, turn, shift), PRESETS["tiny"])
        shares.append(float((again.same[0].sort(-1).values != graph.same[0].sort(-1).values)
                            .double().mean()))  # fmt: skip
    assert max(shares) < 0.01


@torch.no_grad()
def test_a_fine_network_sees_what_lies_between_the_nodes():
    model, nodes = _model(torch.float64, FINE), scene()
    graph = build_graph(nodes, model.config)
    assert graph.fine.shape == (len(nodes.points), 12)
    still = model.encode_scene(nodes, graph).features[0]
    surface = nodes.surface
    assert surface is not None
    bent = dataclasses.replace(surface, normals=np.roll(surface.normals, 1, axis=1))
    other = model.encode_scene(dataclasses.replace(nodes, surface=bent), graph).features[0]
    assert relative(other, still) > 1e-3
    with pytest.raises(InvalidRequestError, match="without their surface"):
        build_graph(dataclasses.replace(nodes, surface=None), model.config)
