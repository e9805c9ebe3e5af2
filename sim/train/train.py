"""Training in stages; README.md in this folder tells how.

    python3 sim/train/train.py geometry   --out DIR --scenes DIR --minutes 60
    python3 sim/train/train.py appearance --out DIR --scenes DIR --minutes 20
    python3 sim/train/train.py render     --out DIR --scenes DIR --minutes 20
    python3 sim/train/train.py complete   --out DIR --scenes DIR --minutes 9

A run continues from DIR/STAGE.ckpt if there is one."""

from __future__ import annotations

import argparse
import json
import os

import numpy as np
import torch
from torch import Tensor

import completion
import data
import export
import losses
import model
import redraw
import stage

PREVIOUS = {"appearance": "geometry", "render": "appearance"}
# The completion branch is small and sees single views: 64 of 160 px make a batch.
COMPLETE = {"rate": 2e-3, "warm": 200, "decay": 0.998, "tokens": 8360, "val_every": 2000,
            "every": 250, "capacity": 10**6}


def draw_shape(r: np.random.Generator, share: float, q: argparse.Namespace) -> tuple:
    """Scenes, views and size of a batch: small pictures more often, and, where nothing is known
    yet, first."""
    reach = 1 if q.init else min(1, 0.25 + 1.5 * share)
    size = q.sizes[int(len(q.sizes) * reach * r.random() ** 2)]
    patches = (size // model.PATCH) ** 2
    v = max(2, min(int(r.integers(2, 11)), q.most // patches))
    return max(1, int(q.tokens / (v * patches))), v + (q.stage == "render"), size


class Trainer(stage.Stage):
    """The stages of the network that goes from photographs to Gaussians."""

    def __init__(self, q: argparse.Namespace, dims: model.Dims):
        net = model.make(dims, q.seed).to(q.device)
        self.raster = redraw.Raster(q.lib, q.threads) if q.stage == "render" else None
        super().__init__(q, net, self.make_optimizer(net, q))

    @staticmethod
    def make_optimizer(net: model.Net, q: argparse.Namespace) -> torch.optim.Optimizer:
        """Which weights learn, and how fast."""
        e, learn = net.encoder, q.stage == "geometry"
        net.requires_grad_(not learn)
        for m in (e.aggregator, e.camera_head, e.depth_head):
            m.requires_grad_(learn)
        e.aggregator.patch_embed.mask_token.requires_grad_(False)
        if net.d.complete:  # learned apart, kept as it is
            e.complete.requires_grad_(False)
        if not learn:
            for m in (e.gaussian_param_head.input_merger,
                      e.gaussian_param_head.scratch.output_conv2):
                m.requires_grad_(False)
        groups = {}
        for name, p in net.named_parameters():
            if p.requires_grad:
                slow = not learn and "tonemapper" not in name  # dark pixels: steep, see model.py
                groups.setdefault((p.ndim > 1, slow), []).append(p)
        return torch.optim.AdamW(
            [{"params": p, "weight_decay": 0.02 * wide, "scale": q.slow if slow else 1.0}
             for (wide, slow), p in groups.items()],
            lr=q.rate, betas=(0.9, 0.98), fused=True)

    def begin(self) -> None:
        if self.q.init:
            self.net.load_state_dict(export.read_tensors(self.q.init))
        elif self.q.stage in PREVIOUS:
            c = torch.load(self.path(PREVIOUS[self.q.stage]), map_location=self.q.device,
                           weights_only=False)
            begun = self.q.stage == "render"
            weights = {k: v for k, v in c["average"].items()
                       if begun or k.split(".")[1] in ("aggregator", "camera_head", "depth_head",
                                                       "complete")}
            self.net.load_state_dict(weights, strict=begun)
        self.average.load_state_dict(self.net.state_dict())

    def state(self) -> dict:
        return {"dims": vars(self.net.d), **super().state()}

    def export(self, path: str) -> None:
        export.export(self.average, path)

    # ---- losses ----

    def geometry(self, net: model.Net, b: data.Batch, share: float) -> tuple[Tensor, dict]:
        v, size = b.images.shape[1], b.images.shape[-1]
        keep, qk = net.backbone(b.images)
        at, seen = losses.token_targets(b)
        match, figures = losses.match_loss(qk, v, at, seen)
        pose = net.encoder.camera_head(keep[-1])
        camera = losses.camera_loss(pose, b.pose)
        dense = [int(i) for i in self.rng.permutation(v)[: max(1, round(v * self.q.dense))]]
        depth, conf = net.encoder.depth_head([k[:, dense].flatten(0, 1) for k in keep], size)
        error = losses.depth_loss(depth, conf, b.depth[:, dense].flatten(0, 1))
        total = self.q.match * match + self.q.camera * camera + error
        return total, {"match": match, "camera": camera, "depth": error, **figures}

    def appearance(self, net: model.Net, b: data.Batch, r: np.random.Generator) -> tuple:
        size, (n, v) = b.images.shape[-1], b.stops.shape
        seen = b.first(v - 1) if self.raster else b  # the last view is new to the network
        with torch.no_grad():
            keep, qk = net.backbone(seen.images)
            fov = net.encoder.camera_head(keep[-1])[-1][..., 8].float()
            depth, conf = net.encoder.depth_head([k.flatten(0, 1) for k in keep], size)
            depth, conf = (t.float().unflatten(0, seen.stops.shape) for t in (depth, conf))
        raw, theta = net.gaussians(seen.images, keep, qk,
                                   seen.stops - losses.mid_stops(seen.stops))
        with torch.autocast(self.q.device, enabled=False):
            picture, f = losses.appearance_loss(raw, theta, seen, self.other_stops(seen, r))
            shape, g = losses.shape_loss(raw, depth, fov, seen.depth, not self.raster)
            if not self.raster:
                return picture + shape, {**f, **g}
            drawn, h = self.redrawn(net, raw, theta, depth, conf, b)
        return drawn + self.q.pixels * picture + shape, {**f, **g, **h}

    def other_stops(self, b: data.Batch, r: np.random.Generator) -> list[Tensor]:
        """Two more exposures of every picture, within the bracket and a little beyond."""
        lo, hi = b.stops.amin(1, keepdim=True), b.stops.amax(1, keepdim=True)
        return [lo + (hi - lo) * torch.from_numpy(r.random(b.stops.shape)).to(lo)
                + torch.from_numpy(r.normal(size=b.stops.shape) * 0.7).to(lo) for _ in range(2)]

    def redrawn(self, net: model.Net, raw: Tensor, theta: Tensor, depth: Tensor, conf: Tensor,
                b: data.Batch) -> tuple[Tensor, dict]:
        """The photographs from the fused Gaussians at true cameras, which the program finds by
        polishing."""
        total, figures = 0.0, {}
        for i in range(len(b.stops)):
            loss, f = redraw.scene_loss(self.raster, raw[i], theta[i], depth[i], conf[i],
                                        b.scene(i), net.d.voxel)
            total = total + loss / len(b.stops)
            for k, x in f.items():
                figures[k] = figures.get(k, 0) + x / len(b.stops)
        return total, figures

    def forward(self, net: model.Net, b: data.Batch, share: float) -> tuple[Tensor, dict]:
        with torch.autocast(self.q.device, dtype=torch.bfloat16, enabled=self.q.bf16):
            if self.q.stage == "geometry":
                return self.geometry(net, b, share)
            return self.appearance(net, b, self.rng)

    @torch.no_grad()
    def validate(self, scenes: data.Replay) -> dict:
        return self.validate_geometry(scenes) if self.q.stage == "geometry" \
            else self.validate_appearance(scenes)

    def validate_appearance(self, scenes: data.Replay) -> dict:
        r, total = np.random.default_rng(5), {}
        for name in sorted(scenes.scenes)[: self.q.val]:
            b = scenes.collect([name], r, 4 + bool(self.raster), self.q.val_size).to(self.q.device)
            with torch.autocast(self.q.device, dtype=torch.bfloat16, enabled=self.q.bf16):
                _, f = self.appearance(self.average, b, r)
            for k, x in f.items():
                total.setdefault(k, []).append(float(x))
        return {k: float(np.mean(x)) for k, x in total.items()}

    def validate_geometry(self, scenes: data.Replay) -> dict:
        """On the averaged weights; the same samples every time."""
        r, net, total = np.random.default_rng(5), self.average, {}
        names = sorted(scenes.scenes)[: self.q.val]
        for name in names:
            b = scenes.collect([name], r, 4, self.q.val_size).to(self.q.device)
            with torch.autocast(self.q.device, dtype=torch.bfloat16, enabled=self.q.bf16):
                keep, qk = net.backbone(b.images)
                pose = net.encoder.camera_head(keep[-1])[-1].float()
                depth, _ = net.encoder.depth_head([k.flatten(0, 1) for k in keep],
                                                  self.q.val_size)
            loss, f = losses.match_loss(qk, 4, *losses.token_targets(b))
            f["match"] = loss
            f.update(losses.geometry_figures(pose, depth.unflatten(0, (1, 4)), b))
            for k, x in f.items():
                total.setdefault(k, []).append(float(x))
        return {k: float(np.mean(x)) for k, x in total.items()}

    def loss(self, scenes: data.Replay, share: float) -> tuple[Tensor, dict, int]:
        n, v, size = draw_shape(self.rng, share, self.q)
        b = scenes.batch(self.rng, n, v, size).to(self.q.device)
        return *self.forward(self.net, b, share), n * v


def dims_of(q: argparse.Namespace) -> dict:
    """Those of the weights that the run goes on or starts from, and --dims."""
    before = q.stage if q.init else PREVIOUS.get(q.stage, q.stage)
    for path in (f"{q.out}/{name}.ckpt" for name in (q.stage, before)):
        if os.path.exists(path):
            old = torch.load(path, map_location="cpu", weights_only=False)["dims"]
            break
    else:
        old = export.read_dims(q.init) if q.init else {}
    return {**old, **json.loads(q.dims)}


def options() -> argparse.Namespace:
    p = argparse.ArgumentParser()
    p.add_argument("stage", choices=["geometry", "appearance", "render", "complete"])
    p.add_argument("--out", default="/tmp/train")
    p.add_argument("--scenes", default="/tmp/train/scenes")
    p.add_argument("--init", help=".safetensors to start from, without a checkpoint")
    p.add_argument("--dims", help="JSON with some of the dimensions", default="{}")
    p.add_argument("--minutes", type=float, default=60)
    p.add_argument("--steps", type=int, default=0, help="length of the run, instead of minutes")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--rate", type=float, default=8e-4)
    p.add_argument("--warm", type=int, default=150)
    p.add_argument("--decay", type=float, default=0.995, help="of the average of the weights")
    p.add_argument("--tokens", type=int, default=1152, help="patches of a batch")
    p.add_argument("--most", type=int, default=10240, help="patches of a scene")
    p.add_argument("--sizes", type=int, nargs="+", default=[112, 168, 224, 336, 448])
    p.add_argument("--dense", type=float, default=0.5, help="share of views with depth")
    p.add_argument("--match", type=float, default=1.0, help="weight of the correspondences")
    p.add_argument("--camera", type=float, default=1.0, help="weight of the cameras")
    p.add_argument("--pixels", type=float, default=0.3, help="weight of single pixels in render")
    p.add_argument("--lib", default=redraw.LIB, help="built by make libsim, for render")
    p.add_argument("--slow", type=float, default=0.1, help="rate of all but the hypernetwork")
    p.add_argument("--val", type=int, default=16)
    p.add_argument("--val-size", type=int, default=168)
    p.add_argument("--val-every", type=int, default=250)
    p.add_argument("--every", type=int, default=25)
    p.add_argument("--capacity", type=int, default=1500, help="scenes in memory")
    p.add_argument("--least", type=int, default=32, help="scenes to start with")
    p.add_argument("--save-s", type=float, default=180)
    p.add_argument("--snap-s", type=float, default=600)
    p.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    p.add_argument("--threads", type=int, default=2)
    p.add_argument("--float", dest="bf16", action="store_false", help="no bfloat16")
    q = p.parse_args()
    if q.stage == "complete":
        if q.init:
            p.error("--init: a file has no norms, without which the branch does not learn on")
        p.set_defaults(**COMPLETE)
        q = p.parse_args()
    return q


if __name__ == "__main__":
    q = options()
    torch.set_num_threads(q.threads)
    os.makedirs(q.out, exist_ok=True)
    if q.stage == "complete":
        completion.Completion(q).run()
    else:
        Trainer(q, model.Dims(**dims_of(q))).run()
