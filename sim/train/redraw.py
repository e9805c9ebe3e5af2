"""Pictures of the predicted Gaussians by the rasteriser of core/splat (sim/redraw.h, ctypes),
with gradients, and what the stage `render` minimises (paper 3.4): photographs drawn again from the
fused Gaussians of all views, their own and those of a place that the network has not seen, and the
depth where the frozen head is surest of it."""

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
CELL_EPS, SCALE_UNIT, SCALE_MAX = 1e-6, 1e-3, 0.3  # model-spec 2.11, 2.12
TOP = 0.3  # share of pixels whose depth is trusted, paper 3.4


class Redraw(c.Structure):
    """struct redraw of sim/redraw.h."""

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
    """fx fy cx cy, q wxyz, t of sim/redraw.h from a pose of data.Batch."""
    t, q, f = pose[:3].tolist(), pose[3:7].tolist(), (size / 2 / torch.tan(pose[7:] / 2)).tolist()
    return [f[1], f[0], size / 2, size / 2, q[3], *q[:3], *t]


def points(depth: Tensor, pose: Tensor) -> Tensor:
    """(V, S, S, 3) of whole pixels without the half, as model-spec 2.11 has it."""
    size = depth.shape[-1]
    u = torch.arange(size, device=depth.device) * 2 / size - 1
    k = torch.tan(pose[:, 7:] / 2)
    x = u * k[:, 1, None, None] * depth
    y = u[:, None] * k[:, 0, None, None] * depth
    p = torch.stack([x, y, depth], -1) - pose[:, None, None, :3]
    return torch.einsum("vji,vhwj->vhwi", data.rotation(pose[:, [6, 3, 4, 5]]), p)


def resized(raw: Tensor, factor: Tensor) -> Tensor:
    """raw (V, 88, S, S) with Gaussians `factor` (V, S, S) times as large (network_sharpen)."""
    y = (F.softplus(raw[:, 1:4]) * factor[:, None]).clamp_min(1e-12)
    return torch.cat([raw[:, :1], y + torch.log(-torch.expm1(-y)), raw[:, 4:]], 1)


def fuse(raw: Tensor, xyz: Tensor, cell: float) -> Tensor:
    """Planes (14, cells) of struct gaussians, degree 0, from raw (88, N) and points (N, 3):
    model-spec 2.11 and 2.12."""
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


def scene_loss(raster: Raster, raw: Tensor, theta: Tensor, depth: Tensor, conf: Tensor,
               b: data.Batch, cell: float) -> tuple[Tensor, dict]:
    """One scene: raw (V, 88, S, S), theta (THETA), depth (V, S, S) in scene units and the head's
    confidence for the first V views of b; all views of b are drawn, the others are new to it."""
    v, size = depth.shape[0], depth.shape[-1]
    xyz = points(depth, b.pose[0, :v]).flatten(0, 2)
    planes = fuse(raw.transpose(0, 1).flatten(1), xyz, cell).cpu()
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
            trust = conf[i] >= torch.quantile(conf[i].flatten(), 1 - TOP)
            total = total + 0.1 * ((deep.to(depth) - depth[i]).square() * trust).mean() / TOP
    db = {k: -10 * torch.log10(torch.stack(x).mean()) for k, x in figures.items() if x}
    return total / b.images.shape[1], db
