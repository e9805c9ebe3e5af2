"""The network that hdrig runs (core/net), at any dimensions, for training in PyTorch.

Names and shapes of all tensors are those of core/net/table.c, so a state_dict is a weights file.
Departures from the usual reading of such networks, kept on purpose because the C code has them:
the skip of a residual unit carries relu(x); the fusion attention has a scale of 1/8 whatever the
width of a head and its softmax includes the special tokens; the position grid is resampled with
antialiasing; the first view has camera and register tokens of its own.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from functools import lru_cache

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from complete import Complete

PATCH, SPECIAL, GRID = 14, 5, 37
RAW, SENSITIVITY, THETA, CURVE = 84, 4, 1926, 193
POSE_ROUNDS = 4


@dataclass
class Dims:
    """struct net_dims of core/net/table.h."""

    embed: int = 192
    heads: int = 6
    dino_depth: int = 3
    dino_heads: int = 6
    depth: int = 4
    keep: tuple = (0, 1, 2, 3)
    qk_layer: int = 2
    cam_depth: int = 2
    cam_heads: int = 6
    depth_feat: int = 48
    gs_feat: int = 64
    depth_oc: tuple = (48, 64, 96, 96)
    gs_oc: tuple = (48, 64, 96, 96)
    hdr: int = 32
    size: int = 224
    voxel: float = 0.004
    gauss: bool = True
    appearance: bool = True
    rope_bf16: bool = True  # hdrig convert takes every file as trained with rounded angles
    complete: bool = False

    def write(self, path: str) -> None:
        """As `hdrig convert --config` reads it."""
        with open(path, "w") as f:
            json.dump({"voxel_size": self.voxel, "model": asdict(self)}, f, indent=1)
            f.write("\n")


# ---- positions ----


def cubic(t: float) -> float:
    a, t = -0.5, abs(t)
    if t < 1:
        return ((a + 2) * t - (a + 3)) * t * t + 1
    return (((t - 5) * t + 8) * t - 4) * a if t < 2 else 0.0


@lru_cache(maxsize=16)
def resample_matrix(n: int) -> Tensor:
    """(n, GRID): antialiased cubic, half-pixel centres."""
    scale = GRID / n
    f = max(scale, 1.0)
    m = torch.zeros(n, GRID, dtype=torch.float64)
    for i in range(n):
        c = (i + 0.5) * scale
        lo, hi = max(int(c - 2 * f + 0.5), 0), min(int(c + 2 * f + 0.5), GRID)
        for j in range(lo, hi):
            m[i, j] = cubic((j - c + 0.5) / f)
    return (m / m.sum(1, keepdim=True)).float()


@lru_cache(maxsize=16)
def rope_angles(n: int, head: int, bf16: bool) -> Tensor:
    """(P, head / 2): rows first, then columns; special tokens have position 0."""
    quarter = head // 4
    freq = 100.0 ** (-torch.arange(quarter, dtype=torch.float32) / quarter)
    if bf16:
        freq = freq.bfloat16().float()
    at = torch.arange(n * n)
    pos = torch.stack([at // n + 1, at % n + 1], 1).float()
    pos = torch.cat([torch.zeros(SPECIAL, 2), pos])
    angle = (pos[:, :, None] * freq).flatten(1)
    return angle.bfloat16().float() if bf16 else angle


@lru_cache(maxsize=64)
def position_map(d: int, n: int) -> Tensor:
    """(d, n, n): 0.1 of the sinusoidal code of a square picture, core/net/README.md 2.5."""
    u = (2 * torch.arange(n, dtype=torch.float64) - (n - 1)) / (n * math.sqrt(2))
    w = 100.0 ** (-torch.arange(d // 4, dtype=torch.float64) / (d / 4))
    a = w[:, None] * u
    s, c = torch.sin(a), torch.cos(a)
    x = torch.cat([s, c])[:, None, :].expand(-1, n, n)
    y = torch.cat([s, c])[:, :, None].expand(-1, n, n)
    return (0.1 * torch.cat([x, y])).float()


def up(x: Tensor, n: int, corners: bool) -> Tensor:
    return F.interpolate(x, size=(n, n), mode="bilinear", align_corners=corners)


# ---- blocks ----


class LayerScale(nn.Module):
    def __init__(self, c: int, init: float):
        super().__init__()
        self.gamma = nn.Parameter(torch.full((c,), init))

    def forward(self, x: Tensor) -> Tensor:
        return x * self.gamma


class Attention(nn.Module):
    def __init__(self, c: int, heads: int, qk_norm: bool):
        super().__init__()
        self.heads, self.head = heads, c // heads
        self.qkv = nn.Linear(c, 3 * c)
        if qk_norm:
            self.q_norm = nn.LayerNorm(self.head)
            self.k_norm = nn.LayerNorm(self.head)
        self.proj = nn.Linear(c, c)
        self.qk_norm = qk_norm

    def forward(self, x: Tensor, turn: tuple | None, capture: list | None) -> Tensor:
        b, n, c = x.shape
        qkv = self.qkv(x).view(b, n, 3, self.heads, self.head).permute(2, 0, 3, 1, 4)
        q, k, v = qkv[0], qkv[1], qkv[2]
        if self.qk_norm:
            q, k = self.q_norm(q.float()), self.k_norm(k.float())
        if capture is not None:
            capture.append((q, k))
        if turn is not None:
            q, k = rotate(q, *turn), rotate(k, *turn)
        out = attend(q.to(v.dtype), k.to(v.dtype), v)
        return self.proj(out.transpose(1, 2).reshape(b, n, c))


MANY = 5000  # tokens from which on the products no longer fit: fused, a step takes a third


def attend(q: Tensor, k: Tensor, v: Tensor) -> Tensor:
    if q.device.type != "cpu" or q.dtype != torch.bfloat16 or q.shape[-2] > MANY:
        return F.scaled_dot_product_attention(q, k, v)
    a = torch.softmax(q @ k.transpose(-1, -2) * q.shape[-1] ** -0.5, -1)
    return a @ v  # with gradients, 1.5 to 6 times as fast as the fused kernel of PyTorch 2.13


def rotate(t: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """cos, sin: (tokens, head / 2); pairs (i, i + head / 4) within each half."""
    quarter = t.shape[-1] // 4
    s = t.unflatten(-1, (2, 2, quarter))
    a, b = s[..., 0, :], s[..., 1, :]
    c, d = cos.unflatten(-1, (2, quarter)), sin.unflatten(-1, (2, quarter))
    return torch.stack([a * c - b * d, b * c + a * d], -2).flatten(-3)


class Mlp(nn.Module):
    def __init__(self, c: int, hidden: int, out: int):
        super().__init__()
        self.fc1 = nn.Linear(c, hidden)
        self.fc2 = nn.Linear(hidden, out)

    def forward(self, x: Tensor) -> Tensor:
        return self.fc2(F.gelu(self.fc1(x)))


class Block(nn.Module):
    def __init__(self, c: int, heads: int, eps: float, qk_norm: bool, scale: float = 0.5):
        super().__init__()
        self.norm1 = nn.LayerNorm(c, eps)
        self.attn = Attention(c, heads, qk_norm)
        self.ls1 = LayerScale(c, scale)
        self.norm2 = nn.LayerNorm(c, eps)
        self.mlp = Mlp(c, 4 * c, c)
        self.ls2 = LayerScale(c, scale)

    def forward(self, x: Tensor, turn: tuple | None = None, capture: list | None = None) -> Tensor:
        x = x + self.ls1(self.attn(self.norm1(x), turn, capture))
        return x + self.ls2(self.mlp(self.norm2(x)))


# ---- backbone ----


class PatchProjection(nn.Module):
    def __init__(self, c: int):
        super().__init__()
        self.proj = nn.Conv2d(3, c, PATCH, PATCH)


class Dino(nn.Module):
    def __init__(self, d: Dims):
        super().__init__()
        c = d.embed
        self.cls_token = nn.Parameter(torch.zeros(1, 1, c))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + GRID * GRID, c))
        self.register_tokens = nn.Parameter(torch.zeros(1, SPECIAL - 1, c))
        self.mask_token = nn.Parameter(torch.zeros(1, c), requires_grad=False)
        self.patch_embed = PatchProjection(c)
        self.blocks = nn.ModuleList(
            Block(c, d.dino_heads, 1e-6, False) for _ in range(d.dino_depth)
        )
        self.norm = nn.LayerNorm(c, 1e-6)

    def forward(self, x: Tensor) -> Tensor:
        n = x.shape[-1] // PATCH
        m = resample_matrix(n).to(x.device)
        grid = self.pos_embed[0, 1:].float().view(GRID, GRID, -1)
        grid = torch.einsum("ay,yxc,bx->abc", m, grid, m).flatten(0, 1)
        patches = self.patch_embed.proj(x).flatten(2).transpose(1, 2) + grid
        first = self.cls_token + self.pos_embed[:, :1]
        first = torch.cat([first, self.register_tokens], 1).expand(len(x), -1, -1)
        t = torch.cat([first.to(patches.dtype), patches], 1)
        for b in self.blocks:
            t = b(t)
        return self.norm(t[:, SPECIAL:])


class Aggregator(nn.Module):
    def __init__(self, d: Dims):
        super().__init__()
        c = d.embed
        self.d = d
        self.camera_token = nn.Parameter(torch.zeros(1, 2, 1, c))
        self.register_token = nn.Parameter(torch.zeros(1, 2, SPECIAL - 1, c))
        self.patch_embed = Dino(d)
        self.frame_blocks = nn.ModuleList(Block(c, d.heads, 1e-5, True) for _ in range(d.depth))
        self.global_blocks = nn.ModuleList(Block(c, d.heads, 1e-5, True) for _ in range(d.depth))

    def forward(self, images: Tensor):
        """images (B, V, 3, S, S) in 0..1. Returns the kept layers (B, V, P, 2C) and q, k."""
        b, v = images.shape[:2]
        mean = images.new_tensor([0.485, 0.456, 0.406]).view(3, 1, 1)
        std = images.new_tensor([0.229, 0.224, 0.225]).view(3, 1, 1)
        patches = self.patch_embed(((images - mean) / std).flatten(0, 1))
        patches = patches.unflatten(0, (b, v))
        special = torch.cat([self.camera_token, self.register_token], 2)
        slot = torch.tensor([0] + [1] * (v - 1), device=images.device)
        special = special[:, slot].expand(b, -1, -1, -1).to(patches.dtype)
        x = torch.cat([special, patches], 2)
        p = x.shape[2]
        angle = rope_angles(images.shape[-1] // PATCH, self.d.embed // self.d.heads,
                            self.d.rope_bf16).to(images.device)
        one = (angle.cos(), angle.sin())
        all_ = (one[0].repeat(v, 1), one[1].repeat(v, 1))
        keep, qk = [], []
        for i in range(self.d.depth):
            x = self.frame_blocks[i](x.reshape(b * v, p, -1), one)
            frame = x.view(b, v, p, -1)
            x = self.global_blocks[i](x.view(b, v * p, -1), all_,
                                      qk if i == self.d.qk_layer else None)
            x = x.view(b, v, p, -1)
            if i in self.d.keep:
                keep.append(torch.cat([frame, x], -1))
        return keep, qk[0]


# ---- camera ----


class CameraHead(nn.Module):
    def __init__(self, d: Dims):
        super().__init__()
        c = 2 * d.embed
        self.empty_pose_tokens = nn.Parameter(torch.zeros(1, 1, 9))
        self.trunk = nn.ModuleList(Block(c, d.cam_heads, 1e-5, False) for _ in range(d.cam_depth))
        self.token_norm = nn.LayerNorm(c)
        self.trunk_norm = nn.LayerNorm(c)
        self.embed_pose = nn.Linear(9, c)
        self.poseLN_modulation = nn.Sequential(nn.SiLU(), nn.Linear(c, 3 * c))
        self.pose_branch = Mlp(c, c // 2, 9)

    def forward(self, last: Tensor) -> list[Tensor]:
        """Poses (B, V, 9) after each round, activated: T, quaternion xyzw, two FoV."""
        t = self.token_norm(last[:, :, 0].float())
        pose, out = None, []
        for _ in range(POSE_ROUNDS):
            e = self.embed_pose(self.empty_pose_tokens.expand(*t.shape[:2], -1)
                                if pose is None else pose.detach())
            shift, scale, gate = self.poseLN_modulation(e).chunk(3, -1)
            y = t + gate * (F.layer_norm(t, t.shape[-1:], eps=1e-6) * (1 + scale) + shift)
            for b in self.trunk:
                y = b(y)
            delta = self.pose_branch(self.trunk_norm(y)).float()
            pose = delta if pose is None else pose + delta
            out.append(torch.cat([pose[..., :7], F.relu(pose[..., 7:])], -1))
        return out


# ---- dense heads ----


class Rcu(nn.Module):
    def __init__(self, c: int):
        super().__init__()
        self.conv1 = nn.Conv2d(c, c, 3, padding=1)
        self.conv2 = nn.Conv2d(c, c, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        x = F.relu(x)
        return self.conv2(F.relu(self.conv1(x))) + x


class Fusion(nn.Module):
    def __init__(self, c: int, skip: bool):
        super().__init__()
        self.out_conv = nn.Conv2d(c, c, 1)
        if skip:
            self.resConfUnit1 = Rcu(c)
        self.resConfUnit2 = Rcu(c)

    def forward(self, a: Tensor, b: Tensor | None, n: int) -> Tensor:
        if b is not None:
            a = a + self.resConfUnit1(b)
        return up(self.out_conv(self.resConfUnit2(a)), n, True)  # 1x1: order does not matter


class Scratch(nn.Module):
    def __init__(self, feat: int, oc: tuple, tail: nn.Module):
        super().__init__()
        for k in range(4):
            setattr(self, f"layer{k + 1}_rn", nn.Conv2d(oc[k], feat, 3, padding=1, bias=False))
            setattr(self, f"refinenet{k + 1}", Fusion(feat, k < 3))
        self.output_conv1 = nn.Conv2d(feat, feat // 2, 3, padding=1)
        self.output_conv2 = tail


class Dpt(nn.Module):
    def __init__(self, c: int, feat: int, oc: tuple, tail: nn.Module):
        super().__init__()
        self.norm = nn.LayerNorm(c)
        self.projects = nn.ModuleList(nn.Conv2d(c, o, 1) for o in oc)
        self.resize_layers = nn.ModuleList([
            nn.ConvTranspose2d(oc[0], oc[0], 4, 4),
            nn.ConvTranspose2d(oc[1], oc[1], 2, 2),
            nn.Identity(),
            nn.Conv2d(oc[3], oc[3], 3, 2, 1),
        ])
        self.scratch = Scratch(feat, oc, tail)

    def trunk(self, keep: list[Tensor], size: int) -> Tensor:
        """keep: (N, P, C) each. Returns (N, feat / 2, size, size)."""
        g, s = size // PATCH, self.scratch
        maps = []
        for k in range(4):
            t = self.norm(keep[k][:, SPECIAL:]).transpose(1, 2).unflatten(2, (g, g))
            t = self.projects[k](t.contiguous(memory_format=torch.channels_last))
            t = self.resize_layers[k](t + position_map(t.shape[1], g).to(t))
            maps.append(getattr(s, f"layer{k + 1}_rn")(t))
        o = s.refinenet4(maps[3], None, g)
        o = s.refinenet3(o, maps[2], 2 * g)
        o = s.refinenet2(o, maps[1], 4 * g)
        o = s.refinenet1(o, maps[0], 8 * g)
        o = up(s.output_conv1(o), size, True)
        return o + position_map(o.shape[1], size).to(o)


class DepthHead(Dpt):
    def __init__(self, d: Dims):
        tail = nn.Sequential(nn.Conv2d(d.depth_feat // 2, 32, 3, padding=1), nn.ReLU(),
                             nn.Conv2d(32, 2, 1))
        super().__init__(2 * d.embed, d.depth_feat, d.depth_oc, tail)

    def forward(self, keep: list[Tensor], size: int) -> tuple[Tensor, Tensor]:
        """log depth and log of (confidence - 1), (N, size, size)."""
        o = self.scratch.output_conv2(self.trunk(keep, size)).float()
        return o[:, 0], o[:, 1]


class GaussHead(Dpt):
    def __init__(self, d: Dims):
        c = d.hdr
        tail = nn.Sequential(nn.Conv2d(c, c, 3, padding=1), nn.ReLU(), nn.Conv2d(c, RAW, 1))
        super().__init__(2 * d.embed, d.gs_feat, d.gs_oc, tail)
        self.input_merger = nn.Sequential(nn.Conv2d(3, c, 7, padding=3), nn.ReLU())
        for m in (tail, self.input_merger):
            m.requires_grad_(False)  # not part of the graph with exposures


# ---- appearance ----


def conv_relu(i: int, o: int, k: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(i, o, k, padding=k // 2), nn.ReLU())


class Code(nn.Module):
    """Code of the exposure relative to the middle, stops (B, V) to (B, V, d)."""

    def __init__(self, d: int):
        super().__init__()
        self.register_buffer("div_term", 2.0 ** (2 * torch.arange(d // 2) / d))

    def forward(self, stops: Tensor) -> Tensor:
        a = stops[..., None] * math.pi / 8 * self.div_term
        return torch.stack([a.sin(), a.cos()], -1).flatten(-2)


class Regression(nn.Module):
    def __init__(self, d: int):
        super().__init__()
        self.ln = nn.LayerNorm(d)
        self.v_mean_proj = nn.Linear(d, d)
        self.v_var_proj = nn.Linear(d, d)
        self.mean_out = nn.Sequential(nn.LayerNorm(d), nn.Linear(d, d), nn.ReLU(), nn.Linear(d, d))
        self.var_out = nn.Sequential(nn.LayerNorm(d), nn.Linear(d, d), nn.ReLU(), nn.Linear(d, d))
        self.exp_film = nn.Sequential(nn.Linear(3 * d, d), nn.ReLU(), nn.Linear(d, 2 * d))


class Upsample(nn.Module):
    def __init__(self, d: int):
        super().__init__()
        self.proj_guide = conv_relu(d, d, 7)
        self.proj_out = conv_relu(d, d, 7)


def head_mean(q: Tensor, k: Tensor, scale: float = 0.125) -> Tensor:
    """Mean over heads of softmax(q k), (B, N, M); one head at a time to save memory."""
    total = None
    for h in range(q.shape[1]):
        a = torch.softmax(q[:, h] @ k[:, h].transpose(1, 2) * scale, -1)
        total = a if total is None else total + a
    return total / q.shape[1]


class HdrHead(nn.Module):
    def __init__(self, d: Dims):
        super().__init__()
        c = d.hdr
        self.patch_embed = nn.Conv2d(3, c, PATCH, PATCH)
        self.pos_embed = Code(c)
        self.regression = Regression(c)
        self.guide_encoder = conv_relu(3, c, 7)
        self.scene_conv = conv_relu(c, c, 3)
        self.sensitivity_conv = nn.Sequential(nn.Conv2d(c, 32, 3, padding=1), nn.ReLU(),
                                              nn.Conv2d(32, SENSITIVITY, 1))
        self.hdr_upsample = Upsample(c)

    def attention(self, q: Tensor, k: Tensor, views: int) -> Tensor:
        """(B, V, M, V, M), rows sum to 1."""
        b, h, n, e = q.shape
        q = q.view(b, h, views, -1, e)[:, :, :, SPECIAL:].flatten(2, 3)
        a = head_mean(q.float(), k.float())
        a = a.view(b, views, -1, views, n // views)[..., SPECIAL:]
        return a / (a.sum((-1, -2), keepdim=True) + 1e-6)

    def fuse(self, images: Tensor, a: Tensor, code: Tensor, stops: Tensor):
        """Tokens of the scene and of the sensitivity, (B, V, M, d)."""
        r = self.regression
        b, v = images.shape[:2]
        x = self.patch_embed(images.flatten(0, 1)).flatten(2).transpose(1, 2).float()
        x = x.unflatten(0, (b, v))
        xn = r.ln(x)
        one = xn.mean(2)
        film = r.exp_film(torch.cat([code, one, one.mean(1, keepdim=True).expand_as(one)], -1))
        gamma, beta = film[:, :, None].chunk(2, -1)
        vm = r.v_mean_proj(xn) * (1 + gamma) + beta
        vv = r.v_var_proj(xn)
        w = a.sum(-1)
        w = w / (w.sum(-1, keepdim=True) + 1e-6)
        n = x.shape[2]
        aw = (a * w[..., None]).view(b, v * n, v * n)
        mean = (aw @ vm.reshape(b, v * n, -1)).view_as(vm)
        u = torch.einsum("bvnwm,bwmd->bvnwd", a, vv)
        c = (w[..., None] * u).sum(3, keepdim=True)
        span = (stops.amax(1) - stops.amin(1)).clamp_min(0.5).view(b, 1, 1, 1)
        var = (w[..., None] * (u - c) ** 2).sum(3) / span
        return x + r.mean_out(mean), r.var_out(var)

    def maps(self, images: Tensor, scene: Tensor, sens: Tensor):
        """Of flat views: guide, detail map U, sensitivity, all at full resolution."""
        size = images.shape[-1]
        g = size // PATCH
        guide = self.guide_encoder(images.contiguous(memory_format=torch.channels_last))
        to_map = lambda t: t.flatten(0, 1).transpose(1, 2).unflatten(2, (g, g))
        z = up(self.scene_conv(to_map(scene)), size, False)
        low = up(up(guide, g // 2, False), size, False)
        high = self.hdr_upsample.proj_guide(guide - low)
        u = self.hdr_upsample.proj_out(z + high)
        return guide, u, up(self.sensitivity_conv(to_map(sens)), size, False)


class ToneMapper(nn.Module):
    """Hypernetwork: parameters of the tone curves."""

    def __init__(self, d: Dims):
        super().__init__()
        c = d.hdr
        self.exp_proj = nn.Linear(c, c)
        self.enc = nn.Sequential(nn.Conv2d(2 * c + RAW + SENSITIVITY, c, PATCH, PATCH), nn.ReLU(),
                                 nn.Conv2d(c, c, 3, 2, 1))
        self.out = nn.Sequential(nn.Linear(4 * c, c), nn.ReLU(), nn.Linear(c, THETA))

    def forward(self, guide: Tensor, raw: Tensor, code: Tensor) -> Tensor:
        b, v = code.shape[:2]
        e = self.exp_proj(code).flatten(0, 1)[:, :, None, None]
        x = torch.cat([guide, raw, e.expand(-1, -1, *raw.shape[-2:]).to(raw.dtype)], 1)
        x = F.relu(self.enc(x)).float().flatten(2)
        z = torch.cat([x.mean(-1), x.amax(-1)], -1).unflatten(0, (b, v))
        return self.out(torch.cat([z.mean(1), z.amax(1)], -1)).float()


def tone(theta: Tensor, x: Tensor) -> Tensor:
    """Display value of x = log2 exposure: core/photo/README.md 2.1.
    theta (B, THETA), x (B, 3, ...)."""
    t = theta[:, : 3 * CURVE].view(len(theta), 3, CURVE)
    s = x.flatten(2)
    w1, b1, w2, b2 = (t[..., i : i + n, None] for i, n in ((0, 64), (64, 64), (128, 64), (192, 1)))
    h = torch.relu(w1.transpose(-1, -2) * s[..., None] + b1.transpose(-1, -2))
    return torch.sigmoid((h @ w2)[..., 0] + b2[..., 0]).view_as(x)


# ---- all ----


class Encoder(nn.Module):
    def __init__(self, d: Dims):
        super().__init__()
        self.aggregator = Aggregator(d)
        self.camera_head = CameraHead(d)
        self.depth_head = DepthHead(d)
        if d.gauss:
            self.gaussian_param_head = GaussHead(d)
        if d.appearance:
            self.hdr_head = HdrHead(d)
            c = d.hdr
            self.hdr_conv = nn.Sequential(nn.Conv2d(c, c, 3, padding=1), nn.ReLU(),
                                          nn.Conv2d(c, RAW, 1))
            self.generate_tonemapper = ToneMapper(d)
        if d.complete:  # no part of the forward pass
            self.complete = Complete()


class Net(nn.Module):
    def __init__(self, d: Dims):
        super().__init__()
        self.d = d
        self.encoder = Encoder(d)

    def backbone(self, images: Tensor):
        return self.encoder.aggregator(images)

    def gaussians(self, images: Tensor, keep: list[Tensor], qk: tuple, stops: Tensor):
        """Raw channels (B, V, 88, S, S) and theta (B, THETA). stops: log2 exposure - middle."""
        e = self.encoder
        b, v = images.shape[:2]
        code = e.hdr_head.pos_embed(stops)
        a = e.hdr_head.attention(*qk, v)
        scene, sens = e.hdr_head.fuse(images, a, code, stops)
        flat = images.flatten(0, 1)
        guide, u, s4 = e.hdr_head.maps(flat, scene, sens)
        d = e.gaussian_param_head.trunk([k.flatten(0, 1) for k in keep], images.shape[-1])
        raw = torch.cat([e.hdr_conv(d + u), s4], 1).float()
        theta = e.generate_tonemapper(guide, raw, code)
        return raw.unflatten(0, (b, v)), theta

    def forward(self, images: Tensor, stops: Tensor) -> dict:
        keep, qk = self.backbone(images)
        b, v, size = images.shape[0], images.shape[1], images.shape[-1]
        depth, conf = self.encoder.depth_head([k.flatten(0, 1) for k in keep], size)
        raw, theta = self.gaussians(images, keep, qk, stops)
        return {
            "keep": keep, "qk": qk, "pose": self.encoder.camera_head(keep[-1]),
            "log_depth": depth.unflatten(0, (b, v)), "conf": conf.unflatten(0, (b, v)),
            "raw": raw, "theta": theta,
        }


# ---- start values ----


def dct_filters(n: int) -> Tensor:
    """(n, 3, PATCH, PATCH), or as many as there are: cosines of rising frequency, four fifths of
    them for brightness while there are some, the rest for two colour differences. Amplitude grows
    with frequency as that of pictures falls."""
    i = torch.arange(PATCH, dtype=torch.float32)
    base = torch.cos(math.pi * (i[None] + 0.5) * i[:, None] / PATCH)
    order = sorted(((a * a + b * b, a, b) for a in range(PATCH) for b in range(PATCH)))
    colour = torch.tensor([[1.0, 1, 1], [1, 0, -1], [-0.5, 1, -0.5]])
    colour = colour / colour.norm(dim=1, keepdim=True)
    tint = max(n // 10, (n - len(order)) // 2)
    count = (n - 2 * tint, tint, tint)
    out = []
    for c, many in enumerate(count):
        for f2, a, b in order[:many]:
            f = torch.outer(base[a], base[b])
            f = f / f.norm() * (0.15 * (0.3 + math.sqrt(f2)) ** 0.9) * (1.0, 2.5, 2.5)[c]
            out.append(colour[c][:, None, None] * f)
    return torch.stack(out)


def sincos_grid(c: int) -> Tensor:
    """(GRID^2, c): smooth code of the position."""
    u = (torch.arange(GRID) + 0.5) / GRID * 2 - 1
    w = math.pi * 0.5 * 1.35 ** torch.arange(c // 4)
    w = w.clamp(max=math.pi * 8)
    a = torch.cat([torch.sin(u[:, None] * w), torch.cos(u[:, None] * w)], 1)
    y = a[:, None].expand(-1, GRID, -1)
    x = a[None].expand(GRID, -1, -1)
    return torch.cat([y, x], 2).reshape(GRID * GRID, c)


def init_block(b: Block, tie: bool, gamma: float = 1.0) -> None:
    for m in (b.attn.qkv, b.attn.proj, b.mlp.fc1, b.mlp.fc2):
        nn.init.trunc_normal_(m.weight, std=m.in_features**-0.5 * 0.8)
        nn.init.zeros_(m.bias)
    c = b.attn.proj.in_features
    if tie:  # look-alikes attend to each other from the start
        with torch.no_grad():
            b.attn.qkv.weight[c : 2 * c] = b.attn.qkv.weight[:c]
    if b.attn.qk_norm:
        nn.init.constant_(b.attn.q_norm.weight, gamma)
        nn.init.constant_(b.attn.k_norm.weight, gamma)


@torch.no_grad()
def init_geometry(net: Net) -> None:
    a, d = net.encoder.aggregator, net.d
    dino = a.patch_embed
    filters = dct_filters(d.embed)
    dino.patch_embed.proj.weight[: len(filters)] = filters
    dino.patch_embed.proj.bias.zero_()
    dino.pos_embed[0, 1:] = 0.3 * sincos_grid(d.embed)
    for t in (dino.cls_token, dino.register_tokens, a.camera_token, a.register_token):
        nn.init.normal_(t, std=0.5)
    for b in dino.blocks:
        init_block(b, False)
    for b in a.frame_blocks:
        init_block(b, False)
    for i, b in enumerate(a.global_blocks):
        init_block(b, True, 2.2 if i == d.qk_layer else 1.5)
    cam = net.encoder.camera_head
    for b in cam.trunk:
        init_block(b, False)
    cam.pose_branch.fc2.weight.mul_(0.1)
    cam.pose_branch.fc2.bias.copy_(torch.tensor([0, 0, 0, 0, 0, 0, 0.5, 0.5, 0.5]))
    cam.poseLN_modulation[1].weight.mul_(0.2)
    tail = net.encoder.depth_head.scratch.output_conv2[2]
    tail.weight.mul_(0.2)
    tail.bias.copy_(torch.tensor([0.0, 0.0]))
    for h in (net.encoder.depth_head, getattr(net.encoder, "gaussian_param_head", None)):
        for m in h.modules() if h is not None else ():
            if isinstance(m, nn.Conv2d) and m.kernel_size == (3, 3):
                nn.init.kaiming_normal_(m.weight, a=1.0)


def start_curve() -> Tensor:
    """(CURVE): logit of sRGB over log2 exposure as 64 ReLU units; half of them face left. Display
    0.5 is x = 0 (compare core/photo/response.c)."""
    x = torch.linspace(-12, 5, 4000, dtype=torch.float64)
    mid = math.log2(((0.5 + 0.055) / 1.055) ** 2.4)
    lin = torch.exp2(x + mid)
    s = torch.where(lin <= 0.0031308, 12.92 * lin, 1.055 * lin.clamp_max(1) ** (1 / 2.4) - 0.055)
    want = torch.logit(s.clamp(1 / 1024, 1 - 1 / 256))
    left, right = -torch.linspace(0, 11, 32).double(), torch.linspace(0, 4.5, 32).double()
    h = torch.cat([torch.relu(left[:, None] - x), torch.relu(x - right[:, None])])
    a = torch.cat([h, torch.ones(1, len(x), dtype=torch.float64)]).T
    ridge = 1e-2 * torch.eye(65, dtype=torch.float64)
    w = torch.linalg.solve(a.T @ a + ridge, a.T @ want)
    side = torch.cat([-torch.ones(32), torch.ones(32)])
    knot = torch.cat([left, -right]).float()
    return torch.cat([side, knot, w[:64].float(), w[64:].float()])


KNEES = (0.0, 0.04, 0.1, 0.2, 0.35, 0.55, 0.75, 0.92)  # display values
KNEE_GAIN = 8.0  # of their ramps, so that the position code added to them matters little
STOPS_GAIN = 2.5  # stops of a picture from what its tokens say of it, by regression


def inverse_curve() -> tuple[Tensor, float]:
    """Natural log of the radiance over display values as ramps that start at KNEES, and offset."""
    x = torch.linspace(-8, 2, 500, dtype=torch.float64)
    p = tone(start_curve().repeat(10)[None, :THETA].clone(), x.float().expand(1, 3, -1))
    p = p[0, 0].double()
    fair = torch.diff(p, prepend=p[:1]).clamp_min(1e-4).sqrt()[:, None]  # even over display values
    ramps = torch.relu(p[:, None] - torch.tensor(KNEES, dtype=torch.float64)) * KNEE_GAIN
    a = torch.cat([ramps, torch.ones(len(x), 1, dtype=torch.float64)], 1)
    b = a * fair
    w = torch.linalg.solve(b.T @ b + 1e-5 * torch.eye(len(KNEES) + 1),
                           b.T @ (fair[:, 0] * x * math.log(2)))
    return w[:-1].float(), float(w[-1])


def only(conv: nn.Conv2d, out: int, taps: dict[int, float], bias: float = 0.0) -> None:
    """Make an output the sum of some inputs at the centre of the kernel."""
    conv.weight[out] = 0
    for i, w in taps.items():
        conv.weight[out, i, conv.kernel_size[0] // 2, conv.kernel_size[1] // 2] = w
    conv.bias[out] = bias


@torch.no_grad()
def init_appearance(net: Net) -> None:
    """The branch starts as an inverse of sRGB: level of a patch by its token, detail by the guide
    (channels 0-5), exposure of the picture by the tokens (6, 7). Needs 32 channels or more; with
    fewer only the curves start sensibly."""
    e = net.encoder
    init_outputs(e)
    if net.d.hdr < 32:
        return
    h, last = e.hdr_head, e.hdr_conv[2]
    r, sig = h.regression, net.d.hdr - 1
    h.patch_embed.weight[:8] = 0
    h.patch_embed.bias[:8] = 0
    for c in range(3):
        h.patch_embed.weight[c, c] = 1 / PATCH**2
        only(h.guide_encoder[0], c, {c: 1.0})
        only(h.scene_conv[0], c, {c: 1.0})
        only(h.scene_conv[0], 3 + c, {})
        only(h.hdr_upsample.proj_guide[0], c, {c: 1.0})
        only(h.hdr_upsample.proj_guide[0], 3 + c, {c: -1.0})
    for c in (6, 7):
        only(h.scene_conv[0], c, {c: 1.0})
        only(h.hdr_upsample.proj_guide[0], c, {})
    init_stops(r, sig)
    e.gaussian_param_head.scratch.output_conv1.weight.mul_(0.1)
    ramps, offset = inverse_curve()
    n = len(KNEES)
    for c in range(3):
        last.weight[8 + 25 * c] = 0
        last.bias[8 + 25 * c] = offset / 0.28209479
        for k in range(n):
            only(h.hdr_upsample.proj_out[0], n * c + k, {c: KNEE_GAIN, 3 + c: -KNEE_GAIN},
                 -KNEE_GAIN * KNEES[k])
            last.weight[8 + 25 * c, n * c + k, 0, 0] = ramps[k] / 0.28209479
        for k, sign in ((3 * n, -1), (3 * n + 1, 1)):
            last.weight[8 + 25 * c, k, 0, 0] = sign * STOPS_GAIN * math.log(2) / 0.28209479
    for k in (0, 1):
        only(h.hdr_upsample.proj_out[0], 3 * n + k, {6 + k: 1.0})
    for k in range(3 * n + 2):
        only(e.hdr_conv[0], k, {k: 1.0})


def init_stops(r: Regression, sig: int) -> None:
    """Channel sig of the values is the sine of the exposure; its mean over the attention, which
    mostly stays in the own picture, comes out on channels 6 and 7, one for each sign."""
    film, out = r.exp_film, r.mean_out
    film[0].weight[:2] = 0
    film[0].bias[:2] = 0
    film[0].weight[0, 0], film[0].weight[1, 0] = 1.0, -1.0
    film[2].weight[sig + len(r.ln.weight)] = 0
    film[2].weight[sig + len(r.ln.weight), :2] = torch.tensor([1.0, -1.0])
    film[2].bias[sig + len(r.ln.weight)] = 0
    r.v_mean_proj.weight[sig] = 0
    r.v_mean_proj.bias[sig] = 0
    for k, sign in ((0, 1.0), (1, -1.0)):
        out[1].weight[k] = 0
        out[1].bias[k] = 0
        out[1].weight[k, sig] = sign
        out[3].weight[6 + k] = 0
        out[3].bias[6 + k] = 0
        out[3].weight[6 + k, k] = 1.0
    out[3].weight[:6] = 0
    out[3].bias[:6] = 0


def init_outputs(e: Encoder) -> None:
    last = e.hdr_conv[2]
    last.weight.mul_(0.1)
    last.bias.zero_()
    last.bias[0] = 2.2  # opacity 0.9
    last.bias[1:4] = 5.0  # 0.001 softplus(5) is half a pixel at 224 px
    last.bias[7] = 1.0
    out = e.generate_tonemapper.out[2]
    out.weight.mul_(0.02)
    out.bias.zero_()
    out.bias[: 3 * CURVE] = start_curve().repeat(3)


def make(d: Dims, seed: int = 1) -> Net:
    torch.manual_seed(seed)
    net = Net(d)
    init_geometry(net)
    if d.appearance:
        init_appearance(net)
    return net
