"""Every fast layer equals its e3nn form."""

from __future__ import annotations

import pytest
import torch
from e3nn import o3
from network_scenes import on_flat, scene, tokens

from megrasp_core.errors import InvalidRequestError
from megrasp_core.lie import PoseBatch
from megrasp_core.network import PRESETS, GraspModel, GripperCode, load_model, precision
from megrasp_core.network.convolution import (
    SELF_PATHS,
    Edges,
    ReducedConvolution,
    SelfProduct,
    harmonics,
)
from megrasp_core.network.decoder import KEYS, distance_factors, nearest_nodes
from megrasp_core.network.gripper_encoder import spread
from megrasp_core.network.irreps import EquivariantLinear, multiplicities, pack, unpack
from megrasp_core.network.kernels import nearest_points

IRREPS = "6x0e+4x1o+3x2e"


def test_linear_equals_e3nn():
    torch.manual_seed(0)
    mine = EquivariantLinear(IRREPS, "5x0e+2x1o+7x2e", bias=False).double()
    theirs = o3.Linear(IRREPS, "5x0e+2x1o+7x2e").double()
    flat = [mine.weights[str(ir.l)].detach() * mul**0.5 for mul, ir in o3.Irreps(IRREPS)]
    theirs.weight.data = torch.cat([w.flatten() for w in flat])
    x = torch.randn(9, o3.Irreps(IRREPS).dim, dtype=torch.float64)
    assert torch.allclose(on_flat(mine)(x), theirs(x), atol=1e-10)


def test_convolution_equals_e3nn_tensor_products():
    """Messages over the reduced paths against e3nn's TensorProduct of feature and harmonics."""
    torch.manual_seed(0)
    conv = ReducedConvolution(IRREPS, radial=5, hidden=8).double()
    n, k = 10, 4
    x = torch.randn(n, o3.Irreps(IRREPS).dim, dtype=torch.float64)
    vectors = torch.randn(n, k, 3, dtype=torch.float64)
    index = torch.randint(0, n, (n, k))
    basis = torch.rand(n, k, 5, dtype=torch.float64)
    mine = pack(conv(unpack(x, IRREPS), Edges(index, basis, harmonics(vectors))))

    c0, c1, c2 = 6, 4, 3
    paths = [(0, 0, 0), (1, 0, 1), (2, 0, 2), (0, 1, 1), (0, 2, 2), (1, 1, 0), (2, 2, 0)]
    sh = o3.spherical_harmonics("0e+1o+2e", vectors, normalize=True, normalization="component")
    weights = conv.radial(basis).split(conv._split, -1)
    features = {degree: part.mT for degree, part in unpack(x[index], IRREPS).items()}
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
            0: torch.cat([outs[0, 0, 0], outs[1, 1, 0], outs[2, 2, 0]], 1).mT,
            1: torch.cat([outs[1, 0, 1], outs[0, 1, 1]], 1).mT,
            2: torch.cat([outs[2, 0, 2], outs[0, 2, 2]], 1).mT,
        }
    )
    assert mine.shape[-1] == conv.irreps_out.dim == (c0 + c1 + c2) + 2 * c1 * 3 + 2 * c2 * 5
    assert torch.allclose(mine, wanted, atol=1e-10)


def test_self_product_equals_e3nn():
    torch.manual_seed(0)
    product = SelfProduct(IRREPS).double()
    x = torch.randn(7, o3.Irreps(IRREPS).dim, dtype=torch.float64)
    features = unpack(x, IRREPS)
    left = {degree: part.mT for degree, part in product.left(features).items()}
    right = {degree: part.mT for degree, part in product.right(features).items()}
    mine = {degree: part.mT for degree, part in product(features).items()}
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
        flat = left[l1].flatten(-2), right[l2].flatten(-2)
        wanted = oracle(*flat).reshape(7, c, 2 * l3 + 1)
        got = mine[l3].reshape(7, c, per_degree[l3], 2 * l3 + 1)[:, :, place[l3]]
        place[l3] += 1
        assert torch.allclose(got, wanted, atol=1e-10)


def test_features_keep_their_order_in_e3nns_layout():
    x = torch.randn(4, 5, o3.Irreps(IRREPS).dim)
    parts = unpack(x, IRREPS)
    assert [tuple(part.shape) for part in parts.values()] == [
        (4, 5, 1, 6),
        (4, 5, 3, 4),
        (4, 5, 5, 3),
    ]
    assert torch.equal(parts[1][..., 2, 1], x[..., 6 + 3 * 1 + 2])
    assert torch.equal(pack(parts), x)


@pytest.mark.parametrize(
    ("irreps", "lift"), [(IRREPS, None), ("6x0e+4x1o", (4, 3)), ("16x0e+8x1o+4x2e", (0, 0))]
)
def test_compiled_messages_equal_torch(irreps, lift):
    pytest.importorskip("numba", reason="numba is missing: pip install 'megrasp-core[kernels]'")
    torch.manual_seed(0)
    conv = ReducedConvolution(irreps, radial=5, hidden=8, lift=lift)
    index, vectors = torch.randint(0, 20, (30, 6)), torch.randn(30, 6, 3)
    edges = Edges(index, torch.rand(30, 6, 5), harmonics(vectors))
    flat = torch.randn(20, o3.Irreps(irreps).dim)
    found = []
    for compiled in (False, True):
        conv.compiled = compiled
        conv.zero_grad()
        x = flat.clone().requires_grad_()
        out = pack(conv(unpack(x, irreps), edges))
        (out * torch.linspace(-1.0, 1.0, out.numel()).view_as(out)).sum().backward()
        found.append([out.detach(), x.grad, *(p.grad.clone() for p in conv.parameters())])
    for plain, fused in zip(*found, strict=True):
        assert torch.allclose(plain, fused, atol=1e-5 * float(plain.abs().max()))


def test_compiled_products_equal_torch():
    pytest.importorskip("numba", reason="numba is missing: pip install 'megrasp-core[kernels]'")
    torch.manual_seed(0)
    product = SelfProduct(IRREPS)
    flat = torch.randn(20, o3.Irreps(IRREPS).dim)
    found = []
    for compiled in (False, True):
        product.compiled = compiled
        product.zero_grad()
        x = flat.clone().requires_grad_()
        out = on_flat(product)(x)
        (out * torch.linspace(-1.0, 1.0, out.numel()).view_as(out)).sum().backward()
        found.append([out.detach(), x.grad, *(p.grad.clone() for p in product.parameters())])
    for plain, fused in zip(*found, strict=True):
        assert torch.allclose(plain, fused, atol=1e-5 * float(plain.abs().max()))


def test_compiled_kernels_without_numba_say_what_to_do(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InvalidRequestError, match=r"pip install 'megrasp-core\[kernels\]'"):
        GraspModel(PRESETS["tiny"]).use_kernels()


def test_bfloat16_is_used_only_where_the_processor_multiplies_it(monkeypatch):
    for flags, pays in (({"avx2", "avx512f"}, False), ({"amx_bf16"}, True)):
        monkeypatch.setattr(precision, "_processor_flags", lambda flags=flags: frozenset(flags))
        assert precision.low_precision_pays("cpu") is pays
        model = load_model("megrasp-bin")
        assert model.low_precision is pays


def test_irreps_of_other_parity_or_order_are_refused():
    for wrong in ("4x0e+2x1e", "2x1o+4x0e", "4x0e+2x3o"):
        with pytest.raises(ValueError, match="expected at most 0e, 1o, 2e"):
            multiplicities(wrong)


@pytest.mark.slow
def test_nearest_nodes_against_brute_force():
    torch.manual_seed(0)
    points, probes = torch.randn(200, 3), torch.randn(5, 8, 3)
    got = nearest_nodes(points, probes, 12).sort(-1).values
    distance = torch.cdist(probes, points).amin(1)
    wanted = distance.topk(12, largest=False).indices.sort(-1).values
    assert torch.equal(got, wanted)
    assert nearest_nodes(points[:7], probes, 7).shape == (5, 7)
    pytest.importorskip("numba", reason="numba is missing: pip install 'megrasp-core[kernels]'")
    assert torch.equal(nearest_points(points, probes, 12).sort(-1).values, wanted)
    same = nearest_points(points[:1].expand(9, 3), probes, 4)
    assert all(len(set(row)) == 4 for row in same.tolist()), "as many where all are as near"
    assert nearest_points(points[:7], probes, 7).sort(-1).values.tolist() == [list(range(7))] * 5


def test_distance_factors_give_minus_squared_distance():
    torch.manual_seed(0)
    q, k = torch.randn(4, 3), torch.randn(2, 6, 3)
    near_q, near_k = distance_factors(q, k, 0.5)
    product = near_q @ near_k.transpose(1, 2)
    wanted = -(torch.cdist(q.expand(2, -1, -1), k) / 0.5).square()
    assert torch.allclose(product[..., :6], wanted, atol=1e-4)
    assert torch.equal(product[..., 6], torch.zeros(2, 4)), "gravity is everywhere"
    assert product.shape[-1] % KEYS == 0
    assert torch.equal(product[..., 7:].exp(), torch.zeros(2, 4, 9)), "the rest is nowhere"


def test_selection_tokens_are_spread():
    points = torch.randn(64, 3)
    chosen = spread(points, 16)
    assert len(set(chosen.tolist())) == 16
    assert int(chosen[0]) == int(points.norm(dim=-1).argmin())


@torch.no_grad()
def test_low_precision_stays_close():
    """bfloat16 rounds the token part only: coordinates never pass through it."""
    torch.manual_seed(0)
    model = GraspModel(PRESETS["tiny"]).eval()
    nodes = scene()
    field = model.encode_scene(nodes)
    code = model.encode_gripper(tokens(model.config.gripper_tokens))
    poses = PoseBatch(torch.eye(3).expand(10, 3, 3), torch.as_tensor(nodes.points[:10]))
    s = torch.full((10,), 0.1)
    exact = model.predict(field, code, poses, s).residual
    model.low_precision = True
    rounded = model.predict(field, code, poses, s).residual
    assert not torch.equal(exact, rounded)
    assert (exact - rounded).abs().max() < 0.05 * exact.abs().max()


@torch.no_grad()
def test_one_gripper_a_pose_gives_what_each_gripper_gives():
    torch.manual_seed(0)
    model, nodes = GraspModel(PRESETS["tiny"]).eval(), scene()
    field = model.encode_scene(nodes)
    codes = model.encode_grippers([tokens(8, seed=1), tokens(8, seed=2)])
    poses = PoseBatch(torch.eye(3).expand(5, 3, 3), torch.as_tensor(nodes.points[:5]))
    s = torch.full((5,), 0.2)
    together = model.predict(field, GripperCode.of_poses(codes, [2, 3]), poses, s).residual
    for code, part in ((codes[0], slice(0, 2)), (codes[1], slice(2, 5))):
        alone = model.predict(field, code, poses.part(part), s[part]).residual
        assert torch.allclose(together[part], alone, atol=1e-5)
    assert not torch.allclose(together[0], together[2], atol=1e-4)
