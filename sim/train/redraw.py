"""Pictures of the predicted Gaussians by the rasteriser of core/splat (sim/train/redraw.h, ctypes),
with gradients, and what the stage `render` minimises (section 3.5 of the paper): photographs drawn
again from the fused Gaussians of all views, their own and those of a place that the network has not
seen, and the depth where the frozen head is surest of it."""

from __future__ import annotations

import ctypes as c
import os

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

import data
import losses
import model

LIB = "build/x86_64-pic/libsim.so"
COLOUR = (8, 33, 58)  # constant band of the three colours among the raw channels
SURE = 83  # weight of a pixel in its cell, before the exponential
CELL_EPS, SCALE_UNIT, SCALE_MAX = 1e-6, 1e-3, 0.3  # core/splat/README.md 6
TOP = 0.3  # share of pixels whose depth is trusted, section 3.5 of the paper
TEXTURE, WINDOW = 0.02, 7  # deviation of display values in a window that stereo can match
AGREE, NEARER = 0.03, 0.95  # of depth: the same point; well before what is there


class Redraw(c.Structure):
    """struct redraw of sim/train/redraw.h."""

    _fields_ = [("n", c.c_int), ("degree", c.c_int), ("w", c.c_int), ("h", c.c_int),
                ("threads", c.c_int), ("background", c.c_float * 3), ("camera", c.c_float * 11),
                ("planes", c.c_void_p), ("radiance", c.c_void_p), ("depth", c.c_void_p),
                ("alpha", c.c_void_p), ("up_radiance", c.c_void_p), ("up_depth", c.c_void_p),
                ("up_alpha", c.c_void_p), ("grad", c.c_void_p)]


class Raster:
    """The library, and how many threads it may take."""

    def __init__(self, path: str, threads: int):
        if not os.path.exists(path):
            raise SystemExit(f"{path}: not there; `make libsim` builds it")
        self.lib, self.threads = c.CDLL(path), threads
        self.lib.sample_error.restype = c.c_char_p

    def run(self, planes: Tensor, camera: list[float], size: int, up: tuple | None = None):
        """Radiance (3, S, S), depth and alpha (S, S); with `up`, the gradient of the planes."""
        n = planes.shape[1]
        maps = [np.empty((k, size, size), np.float32) for k in (3, 1, 1)]
        q = Redraw(n, 0, size, size, self.threads, (c.c_float * 3)(1, 1, 1),
                   (c.c_float * 11)(*camera), planes.data_ptr(), *(m.ctypes.data for m in maps))
        if up is not None:
            grad = torch.empty_like(planes)
            q.up_radiance, q.up_depth = up[0].data_ptr(), up[1].data_ptr()
            q.grad = grad.data_ptr()
        if self.lib.redraw_run(c.byref(q)):
            raise RuntimeError(self.lib.sample_error().decode())
        if up is not None:
            return grad
        return torch.from_numpy(maps[0]), torch.from_numpy(maps[1][0]), torch.from_numpy(maps[2][0])


class Picture(torch.autograd.Function):
    """planes (14, N) on the CPU -> radiance, depth, alpha of one camera. Drawn again backward."""

    @staticmethod
    def forward(ctx, planes: Tensor, raster: Raster, camera: list[float], size: int):
        planes = planes.detach().float().contiguous()
        ctx.save_for_backward(planes)
        ctx.args = raster, camera, size
        return raster.run(planes, camera, size)

    @staticmethod
    def backward(ctx, d_radiance: Tensor, d_depth: Tensor, d_alpha: Tensor):
        raster, camera, size = ctx.args
        up = d_radiance.float().contiguous(), d_depth.float().contiguous()
        return raster.run(ctx.saved_tensors[0], camera, size, up), None, None, None


def camera_row(pose: Tensor, size: int) -> list[float]:
    """fx fy cx cy, q wxyz, t of sim/train/redraw.h from a pose of data.Batch."""
    t, q, f = pose[:3].tolist(), pose[3:7].tolist(), (size / 2 / torch.tan(pose[7:] / 2)).tolist()
    return [f[1], f[0], size / 2, size / 2, q[3], *q[:3], *t]


def points(depth: Tensor, pose: Tensor, middle: float = 0.5) -> Tensor:
    """(V, S, S, 3), at the middle of pixels, as network_sharpen places them; with 0 at their
    corners, as core/net/README.md 2.11 has it."""
    size = depth.shape[-1]
    u = (torch.arange(size, device=depth.device) + middle) * 2 / size - 1
    k = torch.tan(pose[:, 7:] / 2)
    x = u * k[:, 1, None, None] * depth
    y = u[:, None] * k[:, 0, None, None] * depth
    p = torch.stack([x, y, depth], -1) - pose[:, None, None, :3]
    return torch.einsum("vji,vhwj->vhwi", data.rotation(pose[:, [6, 3, 4, 5]]), p)


def observations(xyz: Tensor, depth: Tensor, pose: Tensor):
    """Each view: where points (N, 3) are in it, as (index, depth of the point, depth there), and
    which of them it has in its picture."""
    size = depth.shape[-1]
    for d, p in zip(depth, pose):
        at = xyz @ data.rotation(p[[6, 3, 4, 5]]).T + p[:3]
        z = at[:, 2].clamp_min(1e-4)
        k = torch.tan(p[7:] / 2)
        col, row = ((at[:, i] / z / k[1 - i] + 1) * size / 2 for i in (0, 1))
        inside = (at[:, 2] > 1e-4) & (col >= 0) & (col < size) & (row >= 0) & (row < size)
        i = row.clamp(0, size - 1).long() * size + col.clamp(0, size - 1).long()
        yield i, z, d.flatten()[i], inside


@torch.no_grad()
def stereo(images: Tensor, truth: Tensor, pose: Tensor) -> Tensor:
    """(V, S, S): where the program would be sure of its depth from stereo: texture that another
    view sees too."""
    v, _, size, _ = images.shape
    grey = images.mean(1, keepdim=True)
    mean = lambda x: F.avg_pool2d(x, WINDOW, 1, WINDOW // 2, count_include_pad=False)
    rough = (mean(grey * grey) - mean(grey) ** 2)[:, 0] > TEXTURE**2
    xyz = points(truth, pose).reshape(-1, 3)
    shared = torch.zeros(v * size * size, dtype=torch.bool, device=truth.device)
    own = torch.arange(v, device=truth.device).repeat_interleave(size * size)
    for j, (_, z, there, inside) in enumerate(observations(xyz, truth, pose)):
        shared |= inside & ((there - z).abs() < AGREE * z) & (own != j)
    return rough & shared.view_as(rough) & (truth > 0)


@torch.no_grad()
def in_the_way(z: Tensor, sure: Tensor, pose: Tensor) -> Tensor:
    """(V, S, S): pixels of unsure depth through which another view is sure to look
    (network_sharpen leaves them out)."""
    gone = torch.zeros(z.numel(), dtype=torch.bool, device=z.device)
    seen = torch.where(sure, z, 0)
    for _, near, there, inside in observations(points(z, pose).reshape(-1, 3), seen, pose):
        gone |= inside & (near < NEARER * there)
    return gone.view_as(sure) & ~sure


def resized(raw: Tensor, factor: Tensor) -> Tensor:
    """raw (V, 88, S, S) with Gaussians `factor` (V, S, S) times as large (network_sharpen)."""
    y = (F.softplus(raw[:, 1:4]) * factor[:, None]).clamp_min(1e-12)
    return torch.cat([raw[:, :1], y + torch.log(-torch.expm1(-y)), raw[:, 4:]], 1)


def fuse(raw: Tensor, xyz: Tensor, cell: float) -> Tensor:
    """Planes (14, cells) of struct gaussians, degree 0, from raw (88, N) and points (N, 3):
    core/splat/README.md 6."""
    key, of = torch.unique(torch.round(xyz / cell).long(), dim=0, return_inverse=True)
    n, sure = len(key), raw[SURE]
    top = torch.full((n,), -torch.inf, device=raw.device)
    top = top.scatter_reduce(0, of, sure.detach(), "amax")
    w = torch.exp(sure - top[of])
    w = w / (torch.zeros_like(top).index_add(0, of, w) + CELL_EPS)[of]
    f = torch.cat([xyz.T, raw[list(range(8)) + list(COLOUR)]])
    f = torch.zeros(len(f), n, device=raw.device).index_add(1, of, f * w)
    scale = (SCALE_UNIT * F.softplus(f[4:7])).clamp(1e-12, SCALE_MAX)
    return torch.cat([f[:3], torch.log(scale), f[[10, 7, 8, 9]], f[3:4], f[11:14]])


def likeness(a: Tensor, b: Tensor) -> Tensor:
    """Mean SSIM of (3, S, S), windows of 7 pixels."""
    mean = lambda x: F.avg_pool2d(x[None], 7, 1)[0]
    ma, mb = mean(a), mean(b)
    va, vb = mean(a * a) - ma * ma, mean(b * b) - mb * mb
    vab = mean(a * b) - ma * mb
    return ((2 * ma * mb + 1e-4) * (2 * vab + 9e-4)
            / ((ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4))).mean()


def scene_loss(raster: Raster, raw: Tensor, theta: Tensor, log_depth: Tensor, conf: Tensor,
               b: data.Batch, cell: float) -> tuple[Tensor, dict]:
    """One scene: raw (V, 88, S, S), theta (THETA), the head's depth (V, S, S) and confidence for
    the first V views of b; all views of b are drawn, the others are new to it. Depth is what the
    program would have: true where stereo is sure, the head's at one scale per view elsewhere."""
    v, size = log_depth.shape[0], log_depth.shape[-1]
    pose, truth = b.pose[0, :v], b.depth[0, :v]
    sure = stereo(b.images[0, :v], truth, pose)
    gap = torch.where(truth > 0, truth.clamp_min(1e-4).log() - log_depth, torch.nan)
    gap = gap.flatten(1).nanmedian(1).values.nan_to_num()
    guess = torch.exp(log_depth + gap[:, None, None])
    depth = torch.where(sure, truth, guess)
    keep = ~in_the_way(depth, sure, pose).flatten()
    xyz = points(depth, pose).flatten(0, 2)[keep]
    raw = resized(raw, depth / guess).transpose(0, 1).flatten(1)[:, keep]
    planes = fuse(raw, xyz, cell).cpu()
    middle = losses.mid_stops(b.stops[:, :v])[0]
    total, figures = 0.0, {"seen": [], "new": []}
    for i in range(b.images.shape[1]):
        radiance, deep, _ = Picture.apply(planes, raster, camera_row(b.pose[0, i], size), size)
        x = torch.log2(radiance.to(theta) + 1e-6) + b.stops[0, i] - middle
        shown, want = model.tone(theta[None], x[None])[0], b.images[0, i]
        error = (shown - want).abs().mean()
        total = total + 0.8 * error + 0.2 * (1 - likeness(shown, want))
        figures["seen" if i < v else "new"].append((shown - want).square().mean().detach())
        if i < v:
            trust = (conf[i] >= torch.quantile(conf[i].flatten(), 1 - TOP)) & sure[i]
            total = total + 0.1 * ((deep.to(depth) - depth[i]).square() * trust).mean() / TOP
    db = {k: -10 * torch.log10(torch.stack(x).mean()) for k, x in figures.items() if x}
    return total / b.images.shape[1], db
