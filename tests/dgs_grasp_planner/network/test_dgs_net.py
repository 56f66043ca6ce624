"""The whole network: equivariance, independence of the batch, a dense reference, gradients, number formats."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F

from dgs_grasp_planner.network import PRESETS, DGSNet, NetworkConfig, VoxelBatch
from dgs_grasp_planner.network.attention import Block
from dgs_grasp_planner.network.fixed_shapes import FixedShapes
from dgs_grasp_planner.network.geometry import kernel_offsets
from dgs_grasp_planner.network.rotation import matrix_from_6d
from dgs_grasp_planner.network.sparse_conv import SparseConvolution
from tests.dgs_grasp_planner.network.clouds import batch_of, cloud

TINY = PRESETS["tiny"]
CONFIGS = {
    "tiny": TINY,
    "shapes": replace(TINY, name="shapes", fixed_shapes=2),
    "paper-like": replace(
        TINY,
        name="paper-like",
        frame="camera",
        features=("ones", "xyz"),
        rotation_hypotheses=1,
        stem_convolutions=2,
        module_two_convolutions=2,
        module_two_layers=2,
    ),
}


def network(config: NetworkConfig) -> DGSNet:
    torch.manual_seed(0)
    return DGSNet(config).double().eval()


def as_double(batch: VoxelBatch) -> VoxelBatch:
    return batch.to("cpu", torch.float64)


@torch.no_grad()
def outputs(net: DGSNet, batch: VoxelBatch) -> list[torch.Tensor]:
    one, two = net(as_double(batch))
    return [*one, *two]


@pytest.mark.parametrize("name", CONFIGS)
def test_permuting_the_points_permutes_the_output(name: str) -> None:
    config = CONFIGS[name]
    net, points = network(config), cloud(1500)
    permutation = torch.randperm(len(points), generator=torch.Generator().manual_seed(5))
    straight, permuted = batch_of([points], config), batch_of([points[permutation]], config)
    for a, b in zip(outputs(net, straight), outputs(net, permuted), strict=True):
        torch.testing.assert_close(
            a[straight.point_voxel][permutation], b[permuted.point_voxel], rtol=0, atol=1e-5
        )


@pytest.mark.parametrize("name", CONFIGS)
def test_a_batch_of_two_equals_two_single_runs(name: str) -> None:
    config = CONFIGS[name]
    net = network(config)
    # The second cloud is so small that its coarse levels are shorter than a patch.
    clouds = [cloud(3000), cloud(20, 1)]
    both = batch_of(clouds, config)
    assert any(patches.mask is not None for level in both.levels for patches in level.patches)
    singles = [outputs(net, batch_of([c], config)) for c in clouds]
    for together, *apart in zip(outputs(net, both), *singles, strict=True):
        torch.testing.assert_close(together, torch.cat(apart), rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.parametrize("with_pairs", [True, False])
def test_module_two_at_rows_equals_the_whole(name: str, with_pairs: bool) -> None:
    config = CONFIGS[name]
    net, batch = network(config), as_double(batch_of([cloud(3000), cloud(20, 1)], config, with_pairs))
    with torch.no_grad():
        one = net.module_one(batch)
        hypothesis = one.hypothesis_logits.argmax(1)
        whole = net.module_two(one, hypothesis, batch)
        last = batch.levels[0].rows - 1
        rows = torch.tensor([0, 17, last, 5, 17])
        part = net.module_two(one, hypothesis, batch, rows)
    for a, b in zip(whole, part, strict=True):
        torch.testing.assert_close(a[rows], b, rtol=0, atol=1e-12)


def test_fixed_shapes_answer_with_the_shape_of_the_hypothesis_and_an_offset_of_its_own() -> None:
    net, batch = network(CONFIGS["shapes"]), as_double(batch_of([cloud(300)], CONFIGS["shapes"]))
    assert isinstance(net.two, FixedShapes)
    net.two.shapes[1] = 0.5
    with torch.no_grad():
        one = net.module_one(batch)
        first, second = (net.module_two(one, torch.full((len(one.features),), k), batch) for k in (0, 1))
    assert (first.j_end == 0.0).all() and (second.j_end == 0.5).all() and (second.j_init == 0.5).all()
    assert not torch.allclose(first.offset, second.offset)
    joints = torch.tensor([[0.1], [0.4]]).expand(2, net.two.shapes.shape[-1])
    assert net.two.nearest(joints, joints).tolist() == [0, 1]


def _dense_convolution(convolution: SparseConvolution, x: torch.Tensor, grid: torch.Tensor) -> torch.Tensor:
    """By loops over neighbours."""
    rows = {tuple(xyz): row for row, xyz in enumerate(grid.tolist())}
    bias = 0.0 if convolution.bias is None else convolution.bias
    out = torch.zeros(len(x), convolution.weight.shape[2], dtype=x.dtype) + bias
    for row, xyz in enumerate(grid.tolist()):
        for k, offset in enumerate(kernel_offsets().tolist()):
            source = rows.get(tuple(a + b for a, b in zip(xyz, offset, strict=True)))
            if source is not None:
                out[row] += x[source] @ convolution.weight[k]
    return out


def _dense_block(block: Block, x: torch.Tensor, grid: torch.Tensor) -> torch.Tensor:
    """The block in plain words: attention written out over the whole cloud."""
    x = x + block.position_norm(block.position_linear(_dense_convolution(block.position, x, grid)))
    q, k, v = block.attention.qkv(block.norm1(x)).chunk(3, dim=1)
    dim = x.shape[1] // block.attention.heads
    heads = []
    for h in range(block.attention.heads):
        part = slice(h * dim, (h + 1) * dim)
        heads.append((q[:, part] @ k[:, part].t() / dim**0.5).softmax(1) @ v[:, part])
    x = x + block.attention.out(torch.cat(heads, 1))
    return x + block.mlp(block.norm2(x))


@torch.no_grad()
def _dense_backbone(net: DGSNet, x: torch.Tensor, grid: torch.Tensor) -> torch.Tensor:
    """Encoder-decoder by dictionaries of voxels, for a cloud that fits into one patch."""
    backbone = net.backbone
    stem = backbone.stem
    x = F.gelu(stem.norms[0](_dense_convolution(stem.convolutions[0], x, grid)))
    skips, grids, parents = [], [], []
    for level, blocks in enumerate(backbone.encoder):
        if level:
            coarse, parent = torch.unique(grid >> 1, dim=0, return_inverse=True)
            projected = backbone.down[level - 1].linear(x)
            pooled = torch.stack([projected[parent == row].amax(0) for row in range(len(coarse))])
            x, grid = F.gelu(backbone.down[level - 1].norm(pooled)), coarse
            parents.append(parent)
        for block in blocks:
            x = _dense_block(block, x, grid)
        skips.append(x)
        grids.append(grid)
    for level in range(len(skips) - 2, -1, -1):
        up = backbone.up[level]
        x = up.skip(skips[level]) + up.coarse(x)[parents[level]]
        for block in backbone.decoder[level]:
            x = _dense_block(block, x, grids[level])
    return x


def test_backbone_against_a_straightforward_dense_reference() -> None:
    config = replace(TINY, patch_size=512)
    net = network(config)
    batch = as_double(batch_of([cloud(150)], config))
    assert batch.levels[0].rows < 512
    lattice = torch.floor(batch.centres.float() / config.voxel_size).long()
    origin = (lattice.amin(0) >> (config.levels - 1)) << (config.levels - 1)
    with torch.no_grad():
        sparse = net.backbone(batch.features, batch.levels)
    dense = _dense_backbone(net, batch.features, lattice - origin)
    torch.testing.assert_close(sparse, dense, rtol=0, atol=1e-9)


def test_gradcheck_of_the_whole_network() -> None:
    config = replace(
        TINY,
        encoder_channels=(4, 4),
        encoder_depths=(1, 1),
        decoder_channels=(4,),
        decoder_depths=(1,),
        head_dim=4,
        module_two_width=4,
        patch_size=8,
        mlp_ratio=1,
        rotation_hypotheses=1,
    )
    net = network(config)
    batch = as_double(batch_of([cloud(9, 3)], config))
    names = [
        "backbone.stem.convolutions.0.weight",
        "one.rotation.out.weight",
        "two.mix.weight",
        "two.out.bias",
    ]
    values = [dict(net.named_parameters())[name].detach().clone().requires_grad_() for name in names]

    def run(*parameters: torch.Tensor) -> tuple[torch.Tensor, ...]:
        one, two = torch.func.functional_call(net, dict(zip(names, parameters, strict=True)), (batch,))
        return (*one, *two)

    assert torch.autograd.gradcheck(run, values, fast_mode=True)


def test_every_parameter_gets_a_gradient() -> None:
    net = DGSNet(TINY).train()
    one, two = net(batch_of([cloud(500)], TINY))
    sum(value.square().mean() for value in (*one, *two)).backward()
    assert [name for name, p in net.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0] == []


def test_bf16_stays_near_fp32() -> None:
    """Tolerance: 98 % of voxels in the same class; medians of rotation 2 deg, offset 2 mm, joints 0.05 rad."""
    config = PRESETS["fast"]
    torch.manual_seed(0)
    net = DGSNet(config).eval()
    batch = batch_of([cloud(1500)], config)
    with torch.inference_mode():
        one, two = net(batch)
        net.bfloat16()
        one16, two16 = net(batch.to("cpu", torch.bfloat16))
    same = (one.score_logits.argmax(1) == one16.score_logits.argmax(1)).float().mean()
    assert same > 0.98
    a, b = matrix_from_6d(one.rotation6d), matrix_from_6d(one16.rotation6d.float())
    cosine = (torch.einsum("vkij,vkij->vk", a, b) - 1) / 2
    assert torch.rad2deg(cosine.clamp(-1, 1).acos()).median() < 2.0
    assert (two.offset - two16.offset.float()).abs().median() < 0.002
    assert (two.j_end - two16.j_end.float()).abs().median() < 0.05


def test_hypotheses_start_spread_and_downwards() -> None:
    config = PRESETS["fast"]
    one = DGSNet(config).one
    k = config.rotation_hypotheses
    rotation = matrix_from_6d(one.rotation.out.bias[: 6 * k].view(k, 6).detach())
    assert (rotation[:, 2, 2] < -0.8).all(), "approach axes point down"
    torch.testing.assert_close(torch.linalg.det(rotation), torch.ones(k))
    cosine = (torch.einsum("aij,bij->ab", rotation, rotation) - 1) / 2
    between = torch.rad2deg(cosine.clamp(-1, 1).acos()) + 360 * torch.eye(k)
    assert between.min() > 40.0
