"""Training in stages; README.md in this folder tells how.

    python3 sim/train/train.py geometry   --out DIR --scenes DIR --minutes 60
    python3 sim/train/train.py appearance --out DIR --scenes DIR --minutes 20
    python3 sim/train/train.py render     --out DIR --scenes DIR --minutes 20

A run continues from DIR/STAGE.ckpt if there is one."""

from __future__ import annotations

import argparse
import copy
import json
import math
import os
import signal
import time

import numpy as np
import torch
from torch import Tensor

import data
import export
import losses
import model
import redraw

CLIP = 1.0  # norm of the gradient


class Schedule:
    """Share of the run that is over, by the clock or by steps; DIR/STAGE_DEADLINE wins."""

    def __init__(self, q: argparse.Namespace, spent: float):
        self.q, self.spent, self.start = q, spent, time.time()
        self.end = self.start + 60 * q.minutes - spent

    def seconds(self) -> float:
        return self.spent + time.time() - self.start

    def share(self, step: int) -> float:
        if self.q.steps:
            return min(step / self.q.steps, 1.0)
        path = f"{self.q.out}/{self.q.stage.upper()}_DEADLINE"
        end = float(open(path).read() or 0) if os.path.exists(path) else self.end
        begin = self.start - self.spent
        return min(max((time.time() - begin) / max(end - begin, 1.0), 0.0), 1.0)


def rate(step: int, share: float, q: argparse.Namespace) -> float:
    warm = min(1.0, (step + 1) / q.warm)
    return q.rate * warm * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * share)))


def draw_shape(r: np.random.Generator, share: float, q: argparse.Namespace) -> tuple:
    """Scenes, views and size of a batch: small pictures more often, and, where nothing is known
    yet, first."""
    reach = 1 if q.init else min(1, 0.25 + 1.5 * share)
    size = q.sizes[int(len(q.sizes) * reach * r.random() ** 2)]
    patches = (size // model.PATCH) ** 2
    v = max(2, min(int(r.integers(2, 11)), q.most // patches))
    return max(1, int(q.tokens / (v * patches))), v + (q.stage == "render"), size


class Trainer:
    def __init__(self, q: argparse.Namespace, dims: model.Dims):
        self.q = q
        self.net = model.make(dims, q.seed).to(q.device)
        self.rng = np.random.default_rng(q.seed)
        self.step, self.views, self.spent = 0, 0, 0.0
        self.raster = redraw.Raster(q.lib, q.threads) if q.stage == "render" else None
        self.log: list[dict] = []
        self.stage_params()
        self.average = copy.deepcopy(self.net).eval()
        self.resume()
        self.schedule = Schedule(q, self.spent)
        self.stop = False
        signal.signal(signal.SIGTERM, lambda *_: setattr(self, "stop", True))

    def stage_params(self) -> None:
        e = self.net.encoder
        geometry = [e.aggregator, e.camera_head, e.depth_head]
        learn = self.q.stage == "geometry"
        for p in self.net.parameters():
            p.requires_grad_(not learn)
        for m in geometry:
            m.requires_grad_(learn)
        self.net.encoder.aggregator.patch_embed.mask_token.requires_grad_(False)
        if not learn:
            for m in (e.gaussian_param_head.input_merger,
                      e.gaussian_param_head.scratch.output_conv2):
                m.requires_grad_(False)
        groups = {}
        for name, p in self.net.named_parameters():
            if p.requires_grad:
                slow = not learn and "tonemapper" not in name  # dark pixels: steep, see model.py
                groups.setdefault((p.ndim > 1, slow), []).append(p)
        self.opt = torch.optim.AdamW(
            [{"params": p, "weight_decay": 0.02 * wide, "scale": self.q.slow if slow else 1.0}
             for (wide, slow), p in groups.items()],
            lr=self.q.rate, betas=(0.9, 0.98), fused=True)

    # ---- checkpoints ----

    def path(self, stage: str | None = None) -> str:
        return f"{self.q.out}/{stage or self.q.stage}.ckpt"

    def resume(self) -> None:
        if os.path.exists(self.path()):
            c = torch.load(self.path(), map_location=self.q.device, weights_only=False)
            self.net.load_state_dict(c["model"])
            self.average.load_state_dict(c["average"])
            self.opt.load_state_dict(c["opt"])
            self.rng.bit_generator.state = c["rng"]
            self.step, self.views, self.spent = c["step"], c["views"], c["spent"]
            self.log = c["log"]
            print(f"continues at step {self.step}", flush=True)
        elif self.q.init:
            self.net.load_state_dict(export.read_tensors(self.q.init))
            self.average.load_state_dict(self.net.state_dict())
        elif self.q.stage == "render":
            c = torch.load(self.path("appearance"), map_location=self.q.device, weights_only=False)
            self.net.load_state_dict(c["average"])
            self.average.load_state_dict(c["average"])
        elif self.q.stage == "appearance":
            c = torch.load(self.path("geometry"), map_location=self.q.device, weights_only=False)
            geometry = {k: v for k, v in c["average"].items() if ".".join(k.split(".")[:2]) in
                        ("encoder.aggregator", "encoder.camera_head", "encoder.depth_head")}
            self.net.load_state_dict(geometry, strict=False)
            self.average.load_state_dict(self.net.state_dict())

    def save(self) -> None:
        c = {"dims": vars(self.net.d), "model": self.net.state_dict(),
             "average": self.average.state_dict(), "opt": self.opt.state_dict(),
             "rng": self.rng.bit_generator.state, "step": self.step, "views": self.views,
             "spent": self.schedule.seconds(), "log": self.log}
        part = f"{self.path()}.{os.getpid()}.part"
        with open(part, "xb") as f:  # never somebody else's
            torch.save(c, f)
        os.replace(part, self.path())

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

    # ---- the loop ----

    def train_step(self, scenes: data.Replay, share: float) -> dict:
        n, v, size = draw_shape(self.rng, share, self.q)
        b = scenes.batch(self.rng, n, v, size).to(self.q.device)
        for g in self.opt.param_groups:
            g["lr"] = rate(self.step, share, self.q) * g["scale"]
        loss, parts = self.forward(self.net, b, share)
        self.opt.zero_grad(set_to_none=True)
        loss.backward()
        learn = [p for p in self.net.parameters() if p.grad is not None]
        norm = torch.nn.utils.clip_grad_norm_(learn, CLIP)
        if torch.isfinite(norm):
            self.opt.step()
        self.step += 1
        self.views += n * v
        decay = min(self.q.decay, self.step / (self.step + 10))
        with torch.no_grad():
            for a, p in zip(self.average.parameters(), self.net.parameters()):
                if p.requires_grad:
                    a.lerp_(p, 1 - decay)
        return {"loss": loss, "norm": norm, **parts}

    def run(self) -> None:
        q = self.q
        scenes = data.Replay(q.scenes, q.capacity)
        scenes.wait(q.least)
        held_out = data.Replay(q.scenes, 64, True)
        held_out.wait(min(4, q.val))
        sums, since, saved, exported, views = {}, time.time(), time.time(), 0.0, self.views
        while (share := self.schedule.share(self.step)) < 1 and not self.stop:
            for k, x in self.train_step(scenes, share).items():
                sums.setdefault(k, []).append(float(x.detach()))
            if self.step % q.every == 0:
                used = time.time() - since
                line = {k: float(np.nanmean(x)) for k, x in sums.items()}
                print(f"{self.schedule.seconds() / 60:6.1f} min step {self.step} "
                      f"{q.every / used:.2f} steps/s {(self.views - views) / used:.1f} views/s "
                      f"{len(scenes.scenes)} scenes  {show(line)}", flush=True)
                sums, since, views = {}, time.time(), self.views
                scenes.refresh(40)
            if self.step % q.val_every == 0:
                self.report(held_out)
                since = time.time()
            if time.time() - saved > q.save_s:
                self.save()
                saved = time.time()
            if time.time() - exported > q.snap_s:
                export.export(self.average, f"{q.out}/snap.safetensors")
                exported = time.time()
        self.save()
        if not self.stop:
            self.report(held_out)
            self.save()
            export.export(self.average, f"{q.out}/{q.stage}.safetensors")

    def report(self, held_out: data.Replay) -> None:
        f = self.validate(held_out)
        f.update(step=self.step, minutes=self.schedule.seconds() / 60, views=self.views)
        self.log.append(f)
        print(f"  validation {show(f)}", flush=True)
        with open(f"{self.q.out}/{self.q.stage}.json", "w") as out:
            json.dump(self.log, out, indent=1)


def show(f: dict) -> str:
    return " ".join(f"{k} {v:.4g}" for k, v in f.items())


def options() -> argparse.Namespace:
    p = argparse.ArgumentParser()
    p.add_argument("stage", choices=["geometry", "appearance", "render"])
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
    return p.parse_args()


if __name__ == "__main__":
    q = options()
    torch.set_num_threads(q.threads)
    os.makedirs(q.out, exist_ok=True)
    Trainer(q, model.Dims(**json.loads(q.dims))).run()
