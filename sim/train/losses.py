"""What the two stages minimise, and the figures of their validation."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

import data
import model

AGREE = 0.03  # relative depth within which a point is seen, not hidden
QUERIES = 2048  # tokens of a scene that are asked where they are in other views


# ---- correspondences ----


@torch.no_grad()
def token_targets(batch: data.Batch) -> tuple[Tensor, Tensor]:
    """Where the centre of each token of view i is in view j: row and column in tokens
    (B, V, M, V, 2) and whether it is seen there (B, V, M, V)."""
    b, v, size = batch.depth.shape[0], batch.depth.shape[1], batch.depth.shape[-1]
    g = size // model.PATCH
    c = torch.arange(g, device=batch.depth.device) * model.PATCH + model.PATCH // 2
    depth = batch.depth[:, :, c][:, :, :, c]
    at = (c + 0.5) * 2 / size - 1
    k = torch.tan(batch.pose[..., 7:9] / 2)
    x = at * k[..., 1, None, None] * depth
    y = at[:, None] * k[..., 0, None, None] * depth
    p = torch.stack([x, y, depth], -1).flatten(2, 3)
    q = batch.pose[..., [6, 3, 4, 5]]
    r, t = data.rotation(q), batch.pose[..., :3]
    world = torch.einsum("bvji,bvmj->bvmi", r, p - t[:, :, None])
    cam = torch.einsum("bwij,bvmj->bvmwi", r, world) + t[:, None, None]
    z = cam[..., 2].clamp_min(1e-4)
    u = cam[..., 0] / z / k[:, None, None, :, 1]
    w = cam[..., 1] / z / k[:, None, None, :, 0]
    inside = (u.abs() < 1) & (w.abs() < 1) & (cam[..., 2] > 1e-4)
    col, row = (u + 1) / 2 * size, (w + 1) / 2 * size
    i = (row.clamp(0, size - 1).long() * size + col.clamp(0, size - 1).long())
    flat = batch.depth.flatten(2)[:, None, None].expand(b, v, g * g, v, size * size)
    there = flat.gather(-1, i[..., None])[..., 0]
    seen = inside & ((there - z).abs() < AGREE * z) & (depth.flatten(2)[..., None] > 0)
    other = ~torch.eye(v, dtype=torch.bool, device=seen.device)[None, :, None]
    return torch.stack([row, col], -1) / model.PATCH - 0.5, seen & other


def match_loss(qk: tuple, views: int, at: Tensor, seen: Tensor) -> tuple[Tensor, dict]:
    """Cross-entropy of the attention (mean over heads, core/net/README.md 2.7), renormalised over
    the tokens of the other view, against the four tokens around the true place. Of many tokens,
    some query."""
    q, k = qk
    b, h, n, e = q.shape
    m = n // views - model.SPECIAL
    queries = torch.arange(m) if m * views <= QUERIES else torch.randperm(m)[: QUERIES // views]
    queries = queries.to(q.device)
    cut = lambda t: t.view(b, h, views, -1, e)[:, :, :, model.SPECIAL:].float()
    a = model.head_mean(cut(q)[:, :, :, queries].flatten(2, 3), cut(k).flatten(2, 3))
    a = a.view(b, views, -1, views, m)
    at, seen = at[:, :, queries], seen[:, :, queries]
    g = int(round(a.shape[-1] ** 0.5))
    log = torch.log(a / a.sum(-1, keepdim=True).clamp_min(1e-12) + 1e-7)
    top = at.floor()
    f = at - top
    total = 0.0
    for dy in (0, 1):
        for dx in (0, 1):
            y, x = (top[..., 0] + dy).clamp(0, g - 1), (top[..., 1] + dx).clamp(0, g - 1)
            w = (f[..., 0] if dy else 1 - f[..., 0]) * (f[..., 1] if dx else 1 - f[..., 1])
            i = (y * g + x).long()
            total = total - w * log.gather(-1, i[..., None])[..., 0]
    loss = (total * seen).sum() / seen.sum().clamp_min(1)
    with torch.no_grad():
        best = a.argmax(-1)
        off = torch.stack([best // g, best % g], -1) - at
        near = (off.abs().amax(-1) <= 1.0) & seen
        exact = (off.abs().amax(-1) <= 0.5) & seen
        many = seen.sum().clamp_min(1)
        share = {"near": near.sum() / many, "exact": exact.sum() / many}
    return loss, share


# ---- depth and cameras ----


def depth_loss(log_depth: Tensor, conf: Tensor, target: Tensor) -> Tensor:
    """(N, S, S): error of the logarithm with learned confidence as in VGGT, and of its gradient."""
    valid = target > 0
    want = torch.log(target.clamp_min(1e-4))
    err = (log_depth - want).abs()
    weight = 1 + torch.exp(conf.clamp(-8, 5))
    loss = ((weight * err - 0.2 * torch.log(weight)) * valid).sum() / valid.sum().clamp_min(1)
    d = log_depth - want
    gradient = 0.0
    for step in (1, 4):
        for axis in (-1, -2):
            n = d.shape[axis] - step
            both = valid.narrow(axis, 0, n) & valid.narrow(axis, step, n)
            e = (d.narrow(axis, step, n) - d.narrow(axis, 0, n)).abs().clamp_max(1)
            gradient = gradient + (e * both).sum() / both.sum().clamp_min(1)
    return loss + gradient


def camera_loss(rounds: list[Tensor], pose: Tensor) -> Tensor:
    total, weight = 0.0, 1.0
    for p in reversed(rounds):
        e = F.huber_loss(p, pose, delta=0.1, reduction="none") / 0.1
        total = total + weight * (e[..., :3].mean() + 2 * e[..., 3:7].mean() + e[..., 7:].mean())
        weight *= 0.6
    return total


@torch.no_grad()
def geometry_figures(pose: Tensor, log_depth: Tensor, batch: data.Batch) -> dict:
    """Angle between rotations (degrees), error of translation (scene units), FoV (degrees), log
    depth as it is and after one scale for the whole scene."""
    q = F.normalize(pose[..., 3:7], dim=-1)
    dot = (q * batch.pose[..., 3:7]).sum(-1).abs().clamp(max=1)
    angle = torch.rad2deg(2 * torch.acos(dot))[:, 1:]
    shift = (pose[..., :3] - batch.pose[..., :3]).norm(dim=-1)[:, 1:]
    far = batch.pose[:, 1:, :3].norm(dim=-1)
    fov = torch.rad2deg((pose[..., 7:] - batch.pose[..., 7:]).abs())
    valid = batch.depth > 0
    d = torch.where(valid, log_depth - torch.log(batch.depth.clamp_min(1e-4)), torch.nan)
    middle = d.flatten(1).nanmedian(1).values.view(-1, 1, 1, 1)
    still = torch.rad2deg(2 * torch.acos(batch.pose[..., 6].clamp(max=1)))[:, 1:]
    return {"rot": angle.median(), "rot0": still.median(), "t": shift.median(), "t0": far.median(),
            "fov": fov.median(), "depth": d.abs().nanmean(), "depth1": (d - middle).abs().nanmean()}


# ---- appearance ----

SH0 = 0.28209479177387814
SURE, EDGE = 0.95, 0.4  # opacity inside of surfaces and at steps of depth
FOOTPRINT = 0.7  # standard deviation of a Gaussian over the distance of pixels


def reexposed(log_h: Tensor, theta: Tensor, stops: Tensor) -> Tensor:
    """Display values of log-radiances (B, V, 3, N); stops (B, V) relative to the middle."""
    x = torch.log2(torch.exp(log_h.clamp(-25, 25)) + 1e-6) + stops[..., None, None]
    return model.tone(theta, x.transpose(1, 2)).transpose(1, 2)


def appearance_loss(raw: Tensor, theta: Tensor, batch: data.Batch, other: list[Tensor],
                    share: float = 0.25) -> tuple[Tensor, dict]:
    """Of a share of the pixels. other: exposures (B, V), log2, beside the picture's own."""
    middle = mid_stops(batch.stops)
    n = raw.shape[-1] ** 2
    i = torch.randperm(n, device=raw.device)[: max(1, int(n * share))]
    pick = lambda t: t.flatten(-2)[..., i]
    log_h = pick(raw[:, :, [8, 33, 58]]) * SH0
    radiance = pick(batch.radiance)
    own = (reexposed(log_h, theta, batch.stops - middle) - pick(batch.images)).abs().mean()
    error = raw.new_zeros(())
    for s in other:  # what the camera shows there, without noise
        e = radiance * torch.exp2(s)[..., None, None]
        want = data.develop(e.flatten(1), batch.curve).view_as(e)
        error = error + (reexposed(log_h, theta, s - middle) - want).abs().mean() / len(other)
    return own + 2 * error, {"own": own.detach(), "other": error.detach()}


def mid_stops(stops: Tensor) -> Tensor:
    return (stops.amax(1, keepdim=True) + stops.amin(1, keepdim=True)) / 2


def shape_loss(raw: Tensor, log_depth: Tensor, fov: Tensor, truth: Tensor,
               opacity: bool = True) -> tuple:
    """Gaussians as large as pixels of the predicted depth, opaque but at edges, without colours
    that depend on direction. Without `opacity`, opacity and the weight in a cell are free."""
    size = raw.shape[-1]
    pixel = 2 * torch.tan(fov.clamp(0.2, 2.5) / 2) / size
    want = torch.log(FOOTPRINT * pixel[..., None, None]) + log_depth
    have = torch.log(1e-3 * F.softplus(raw[:, :, 1:4]) + 1e-7)
    scale = (have - want[:, :, None]).abs().mean()
    unit = raw.new_tensor([0.0, 0, 0, 1]).view(4, 1, 1)
    turn = (raw[:, :, 4:8] - unit).square().mean()
    bands = [c for k in (8, 33, 58) for c in range(k + 1, k + 25)]
    rest = raw[:, :, bands].square().mean()
    if not opacity:
        return 0.1 * scale + 0.02 * turn + 0.02 * rest, {"scale": scale.detach()}
    step = torch.zeros_like(truth)
    d = torch.log(truth.clamp_min(1e-4))
    step[..., 1:] = (d[..., 1:] - d[..., :-1]).abs()
    step[..., 1:, :] = torch.maximum(step[..., 1:, :], (d[..., 1:, :] - d[..., :-1, :]).abs())
    target = torch.where((step > 0.08) & (truth > 0), EDGE, SURE)
    opaque = F.binary_cross_entropy_with_logits(raw[:, :, 0], target)
    rest = rest + raw[:, :, 83].square().mean()
    return 0.1 * scale + 0.05 * opaque + 0.02 * turn + 0.02 * rest, {"scale": scale.detach()}
