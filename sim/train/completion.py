"""The stage `complete`: the completion branch learns, from worlds that the program's own stereo has
seen (data.py --stereo), the depth where stereo is unsure or wrong, how sure that is, and sky."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

import complete
import data
import export
import model
import stage

LIGHT, USABLE, FAR, RAY_X = slice(0, 3), 4, 7, 9  # channels of core/stereo/fill.h
KINDS = {data.ROOM: "room", data.YARD: "yard", data.DARK: "dark", data.PLAIN: "plain",
         data.PARK: "park"}
BANDS = (0, 0.03, 0.06, 0.12, 0.25, 9)  # of b, for the figures


# ---- views ----


@dataclass
class Views:
    x: Tensor  # (N, INPUTS, h, w) half
    residual: Tensor  # (N, h, w) half: log2 of the true inverse depth over the guess
    sky: Tensor  # (N, h, w) bool; then there is no residual
    kind: int

    def __len__(self) -> int:
        return len(self.x)


class Replay(data.Replay):
    """Views of worlds, on the device."""

    first_held_out = 20_000_000

    def __init__(self, folder: str, capacity: int, validation: bool, device: str):
        self.device = device
        self.pool: dict[int, list] = {}  # (world, view) that are at least so large
        super().__init__(folder, capacity, validation)

    def load(self, path: str) -> Views:
        with np.load(path) as z:
            x, residual, sky = (torch.from_numpy(z[k]).to(self.device)
                                for k in ("x", "residual", "sky"))
            return Views(x.permute(0, 3, 1, 2).contiguous(), residual, sky, int(z["kind"]))

    def refresh(self, limit: int = 10**9) -> None:
        super().refresh(limit)
        sizes = {s.x.shape[-1] for s in self.scenes.values()}
        self.pool = {size: [(s, i) for s in self.scenes.values() if s.x.shape[-1] >= size
                            for i in range(len(s))] for size in sorted(sizes)}

    def crops(self, r: np.random.Generator, pixels: int) -> Views:
        """A batch of about so many pixels: windows of one shape, some of them mirrored."""
        count = np.array([len(p) for p in self.pool.values()])
        w = list(self.pool)[r.choice(len(count), p=count / count.sum())]
        h = w - int(r.integers(0, 3)) * 16 if r.random() < 0.5 else w
        picks = r.integers(len(self.pool[w]), size=max(4, pixels // (w * h)))
        parts = [crop(*self.pool[w][i], (h, w), r) for i in picks]
        return Views(*(torch.stack(t) for t in zip(*parts)), data.ANY)


def crop(s: Views, i: int, shape: tuple[int, int], r: np.random.Generator) -> list[Tensor]:
    (h, w), full = shape, s.x.shape[-1]
    y, x = int(r.integers(0, full - h + 1)), int(r.integers(0, full - w + 1))
    out = [t[i][..., y : y + h, x : x + w] for t in (s.x, s.residual, s.sky)]
    if r.random() < 0.5:
        out = [t.flip(-1) for t in out]
        out[0][RAY_X] = -out[0][RAY_X]
    return out


def augment(x: Tensor, g: torch.Generator) -> Tensor:
    """Other light: order of colours, brightness, contrast, grey, blur, noise, or none at all."""
    b, dev = len(x), x.device

    def uniform(lo: float, hi: float, channels: int = 1) -> Tensor:
        return lo + (hi - lo) * torch.rand(b, channels, 1, 1, device=dev, generator=g)

    def some(share: float) -> Tensor:
        return torch.rand(b, 1, 1, 1, device=dev, generator=g) < share

    light = x[:, LIGHT].float()
    order = torch.rand(b, 3, device=dev, generator=g).argsort(1)[:, :, None, None]
    light = torch.where(some(0.5), light.gather(1, order.expand_as(light)), light)
    light = light * uniform(0.6, 1.3) + uniform(-0.15, 0.15) + uniform(-0.1, 0.1, 3)
    light = torch.where(some(0.15), light.mean(1, keepdim=True), light)
    blurred = F.avg_pool2d(light, 3, 1, 1, count_include_pad=False)
    light = torch.where(some(0.3), blurred, light)
    noise = torch.randn(light.shape, device=dev, generator=g)
    light = (light + noise * uniform(0, 0.06)) * ~some(0.08)
    return torch.cat([light, x[:, LIGHT.stop:].float()], 1)


# ---- loss and figures ----


def gradient_loss(error: Tensor, valid: Tensor) -> Tensor:
    """(N, h, w): differences of the error between neighbours at three scales."""
    total = 0.0
    for step in (1, 2, 4):
        e, m = error[:, ::step, ::step], valid[:, ::step, ::step]
        for axis in (1, 2):
            n = e.shape[axis] - 1
            jump = (e.narrow(axis, 1, n) - e.narrow(axis, 0, n)).abs().clamp_max(2)
            both = m.narrow(axis, 1, n) * m.narrow(axis, 0, n)
            total = total + (jump * both).sum() / both.sum().clamp_min(1)
    return total


def loss(out: Tensor, v: Views) -> tuple[Tensor, dict]:
    """The negative logarithm of the Laplace distribution, the error and its gradient, but in the
    sky; cross-entropy of sky. Where stereo has an answer, an error costs less."""
    mean, log_b, far = out.float().unbind(1)
    log_b, ground = log_b.clamp(-6, 3), ~v.sky
    usable, flagged = v.x[:, USABLE] > 0.5, v.x[:, FAR] > 0.5
    error = mean - v.residual.float()
    weight = torch.where(usable & ~flagged, 0.4, 1.0) * ground
    laplace = error.abs().clamp_max(8) / log_b.exp() + log_b
    depth = (weight * (laplace + 0.5 * error.abs().clamp_max(3))).sum() / weight.sum().clamp_min(1)
    weight = torch.where(flagged, 0.7, 1.0)
    sky = F.binary_cross_entropy_with_logits(far, v.sky.float(), reduction="none")
    sky = (weight * sky).sum() / weight.sum()
    total = depth + 0.3 * gradient_loss(error * ground, ground.float()) + sky
    return total, {"depth": depth, "sky": sky}


def near(error: Tensor, share: float) -> Tensor:
    return error < math.log2(1 + share)


def figures(out: Tensor, v: Views) -> dict:
    """Sums (of a value, of its pixels) in the views of a world; names end in _before for the guess
    itself. `unsure`: stereo has nothing; `b..`: by what the branch says of its error there;
    `doubted`: stereo has a depth that the branch does not believe; `unflagged`: sky after all not.
    """
    mean, log_b, far = out.unbind(1)
    before, after, b = v.residual.float().abs(), (mean - v.residual.float()).abs(), log_b.exp()
    usable, flagged, ground = v.x[:, USABLE] > 0.5, v.x[:, FAR] > 0.5, ~v.sky
    unsure = ~usable & ~flagged & ground
    sure = usable & ground
    doubted = sure & (mean.abs() > 3 * b) & (mean.abs() > 0.1)
    pairs = {"doubted": (doubted, sure)}
    for name, mask, share in (("unsure", unsure, 0.03), ("unsure", unsure, 0.1),
                              ("usable", sure, 0.02), ("usable", sure, 0.1),
                              ("doubted", doubted, 0.1)):
        pairs[f"{name}_{share:g}_before"] = near(before, share), mask
        pairs[f"{name}_{share:g}"] = near(after, share), mask
    for lo, hi in zip(BANDS, BANDS[1:]):
        band, name = unsure & (b >= lo) & (b < hi), f"b{lo:g}-{hi:g}"
        pairs[name] = band, unsure
        pairs[f"{name}_0.03"] = near(after, 0.03), band
        pairs[f"{name}_error"] = after.clamp_max(3), band
    for name, logit in (("sky", 0), ("sure_sky", 2)):
        pairs[name] = far > logit, v.sky & ~flagged
        pairs[f"wrong_{name}"] = far > logit, ground & ~flagged
    pairs["unflagged"] = far < -1, ground & flagged
    pairs["wrong_unflagged"] = far < -1, v.sky & flagged
    return {k: np.array([float(a[m].sum()), float(m.sum())]) for k, (a, m) in pairs.items()}


# ---- the stage ----


class Completion(stage.Stage):
    def __init__(self, q: argparse.Namespace):
        torch.manual_seed(q.seed)
        net = complete.Complete(norm=True).to(q.device, memory_format=torch.channels_last)
        super().__init__(q, net, torch.optim.AdamW(net.parameters(), q.rate, weight_decay=0.01))
        self.light = torch.Generator(q.device).manual_seed(q.seed + self.step)

    def open_scenes(self, capacity: int, held_out: bool = False) -> Replay:
        return Replay(self.q.scenes, capacity, held_out, self.q.device)

    def answer(self, net: complete.Complete, x: Tensor) -> Tensor:
        with torch.autocast(self.q.device, dtype=torch.bfloat16, enabled=self.q.bf16):
            return net(x.to(memory_format=torch.channels_last))

    def loss(self, scenes: Replay, share: float) -> tuple[Tensor, dict, int]:
        v = scenes.crops(self.rng, self.q.tokens * model.PATCH**2)
        return *loss(self.answer(self.net, augment(v.x, self.light)), v), len(v)

    @torch.no_grad()
    def validate(self, scenes: Replay) -> dict:
        """In floats."""
        total: dict[str, np.ndarray] = {}
        for name in sorted(scenes.scenes)[: self.q.val]:
            v = scenes.scenes[name]
            for k, pair in figures(self.average(v.x.float()), v).items():
                k = f"{KINDS[v.kind]}.{k}"
                total[k] = total.get(k, 0) + pair
        return {k: part / max(whole, 1) for k, (part, whole) in sorted(total.items())}

    def export(self, path: str) -> None:
        """The branch alone, for export.py --complete."""
        export.write_tensors(path, self.average.folded())
