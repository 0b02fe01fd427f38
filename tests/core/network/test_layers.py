"""Every fast layer equals its e3nn form."""

from __future__ import annotations

import pytest
import torch
from e3nn import o3
from network_scenes import tokens

from megrasp_core.network import PRESETS, GraspModel
from megrasp_core.network.convolution import SELF_PATHS, ReducedConvolution, SelfProduct, harmonics
from megrasp_core.network.decoder import distance_factors, nearest_nodes
from megrasp_core.network.gripper_encoder import spread
from megrasp_core.network.irreps import EquivariantLinear, multiplicities, pack, unpack

IRREPS = "6x0e+4x1o+3x2e"


def test_linear_equals_e3nn():
    torch.manual_seed(0)
    mine = EquivariantLinear(IRREPS, "5x0e+2x1o+7x2e", bias=False).double()
    theirs = o3.Linear(IRREPS, "5x0e+2x1o+7x2e").double()
    flat = [mine.weights[str(ir.l)].detach() * mul**0.5 for mul, ir in o3.Irreps(IRREPS)]
    theirs.weight.data = torch.cat([w.flatten() for w in flat])
    x = torch.randn(9, o3.Irreps(IRREPS).dim, dtype=torch.float64)
    assert torch.allclose(mine(x), theirs(x), atol=1e-10)


def test_convolution_equals_e3nn_tensor_products():
    """Messages over the reduced paths against e3nn's TensorProduct of feature and harmonics."""
    torch.manual_seed(0)
    conv = ReducedConvolution(IRREPS, radial=5, hidden=8).double()
    n, k = 10, 4
    x = torch.randn(n, o3.Irreps(IRREPS).dim, dtype=torch.float64)
    vectors = torch.randn(n, k, 3, dtype=torch.float64)
    index = torch.randint(0, n, (n, k))
    basis = torch.rand(n, k, 5, dtype=torch.float64)
    mine = conv(x, index, basis, harmonics(vectors))

    c0, c1, c2 = 6, 4, 3
    paths = [(0, 0, 0), (1, 0, 1), (2, 0, 2), (0, 1, 1), (0, 2, 2), (1, 1, 0), (2, 2, 0)]
    sh = o3.spherical_harmonics("0e+1o+2e", vectors, normalize=True, normalization="component")
    weights = conv.radial(basis).split(conv._split, -1)
    features = unpack(x[index], IRREPS)
    outs: dict[tuple, torch.Tensor] = {}
    for (l1, l2, l3), w in zip(paths, weights):
        count = w.shape[-1]
        part = features[l1][..., :count, :]
        single = o3.TensorProduct(
            f"{count}x{l1}{'eo'[l1 % 2]}",
            f"1x{l2}{'eo'[l2 % 2]}",
            f"{count}x{l3}{'eo'[l3 % 2]}",
            [(0, 0, 0, "uvu", True)],
            irrep_normalization="component",
            path_normalization="none",
            shared_weights=False,
        ).double()
        y = sh[..., l2**2 : (l2 + 1) ** 2]
        edge = single(part.flatten(-2), y, w)
        outs[(l1, l2, l3)] = edge.sum(1).reshape(n, count, 2 * l3 + 1) / k**0.5
    wanted = pack(
        {
            0: torch.cat([outs[0, 0, 0], outs[1, 1, 0], outs[2, 2, 0]], 1),
            1: torch.cat([outs[1, 0, 1], outs[0, 1, 1]], 1),
            2: torch.cat([outs[2, 0, 2], outs[0, 2, 2]], 1),
        }
    )
    assert mine.shape[-1] == conv.irreps_out.dim == (c0 + c1 + c2) + 2 * c1 * 3 + 2 * c2 * 5
    assert torch.allclose(mine, wanted, atol=1e-10)


def test_self_product_equals_e3nn():
    torch.manual_seed(0)
    product = SelfProduct(IRREPS).double()
    x = torch.randn(7, o3.Irreps(IRREPS).dim, dtype=torch.float64)
    left = unpack(product.left(x), product.common)
    right = unpack(product.right(x), product.common)
    mine = unpack(product(x), product.irreps_out)
    c = product.channels
    place = {0: 0, 1: 0, 2: 0}
    per_degree = {0: 3, 1: 4, 2: 4}
    for l1, l2, l3 in SELF_PATHS:
        oracle = o3.TensorProduct(
            f"{c}x{l1}{'eo'[l1 % 2]}",
            f"{c}x{l2}{'eo'[l2 % 2]}",
            f"{c}x{l3}{'eo'[l3 % 2]}",
            [(0, 0, 0, "uuu", False)],
            irrep_normalization="component",
            path_normalization="none",
        ).double()
        wanted = oracle(left[l1].flatten(-2), right[l2].flatten(-2)).reshape(7, c, 2 * l3 + 1)
        got = mine[l3].reshape(7, c, per_degree[l3], 2 * l3 + 1)[:, :, place[l3]]
        place[l3] += 1
        assert torch.allclose(got, wanted, atol=1e-10)


def test_irreps_of_other_parity_or_order_are_refused():
    for wrong in ("4x0e+2x1e", "2x1o+4x0e", "4x0e+2x3o"):
        with pytest.raises(ValueError, match="expected at most 0e, 1o, 2e"):
            multiplicities(wrong)


def test_nearest_nodes_against_brute_force():
    torch.manual_seed(0)
    points, probes = torch.randn(200, 3), torch.randn(5, 8, 3)
    got = nearest_nodes(points, probes, 12).sort(-1).values
    distance = torch.cdist(probes, points).amin(1)
    wanted = distance.topk(12, largest=False).indices.sort(-1).values
    assert torch.equal(got, wanted)
    assert nearest_nodes(points[:7], probes, 7).shape == (5, 7)


def test_distance_factors_give_minus_squared_distance():
    torch.manual_seed(0)
    q, k = torch.randn(4, 3), torch.randn(2, 6, 3)
    near_q, near_k = distance_factors(q, k, 0.5)
    product = near_q @ near_k.transpose(1, 2)
    wanted = -(torch.cdist(q.expand(2, -1, -1), k) / 0.5).square()
    assert torch.allclose(product[..., :-1], wanted[..., :-1], atol=1e-4)
    assert torch.equal(product[..., -1], torch.zeros(2, 4))


def test_selection_tokens_are_spread():
    points = torch.randn(64, 3)
    chosen = spread(points, 16)
    assert len(set(chosen.tolist())) == 16
    assert int(chosen[0]) == int(points.norm(dim=-1).argmin())


@torch.no_grad()
def test_low_precision_stays_close():
    """bfloat16 rounds the token part only: coordinates never pass through it."""
    from network_scenes import scene

    torch.manual_seed(0)
    model = GraspModel(PRESETS["tiny"]).eval()
    nodes = scene()
    field = model.encode_scene(nodes)
    code = model.encode_gripper(tokens(model.config.gripper_tokens))
    rotation = torch.eye(3).expand(10, 3, 3)
    translation = torch.as_tensor(nodes.points[:10])
    s = torch.full((10,), 0.1)
    exact = model.predict(field, code, rotation, translation, s).residual
    model.low_precision = True
    rounded = model.predict(field, code, rotation, translation, s).residual
    assert (exact - rounded).abs().max() < 0.05 * exact.abs().max()
