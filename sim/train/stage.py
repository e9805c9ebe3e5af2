"""What all stages of the training share: the schedule, checkpoints and the loop."""

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
from torch import Tensor, nn

import data

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


class Stage:
    """A network that learns. What differs is up to the stage: begin, loss, validate, export."""

    def __init__(self, q: argparse.Namespace, net: nn.Module, opt: torch.optim.Optimizer):
        self.q, self.net, self.opt = q, net, opt
        self.rng = np.random.default_rng(q.seed)
        self.step, self.views, self.spent = 0, 0, 0.0
        self.log: list[dict] = []
        self.average = copy.deepcopy(self.net).eval()
        if not self.resume():
            self.begin()
        self.schedule = Schedule(q, self.spent)
        self.stop = False
        signal.signal(signal.SIGTERM, lambda *_: setattr(self, "stop", True))

    def begin(self) -> None:
        """Start values that come from elsewhere."""

    def loss(self, scenes: data.Replay, share: float) -> tuple[Tensor, dict, int]:
        """That of the next batch, figures beside it, and the views of the batch."""
        raise NotImplementedError

    def validate(self, scenes: data.Replay) -> dict:
        """Figures of the averaged weights."""
        raise NotImplementedError

    def export(self, path: str) -> None:
        """The averaged weights as .safetensors."""
        raise NotImplementedError

    def open_scenes(self, capacity: int, held_out: bool = False) -> data.Replay:
        return data.Replay(self.q.scenes, capacity, held_out)

    # ---- checkpoints ----

    def path(self, stage: str | None = None) -> str:
        return f"{self.q.out}/{stage or self.q.stage}.ckpt"

    def resume(self) -> bool:
        if not os.path.exists(self.path()):
            return False
        c = torch.load(self.path(), map_location=self.q.device, weights_only=False)
        self.net.load_state_dict(c["model"])
        self.average.load_state_dict(c["average"])
        self.opt.load_state_dict(c["opt"])
        self.rng.bit_generator.state = c["rng"]
        self.step, self.views, self.spent = c["step"], c["views"], c["spent"]
        self.log = c["log"]
        print(f"continues at step {self.step}", flush=True)
        return True

    def state(self) -> dict:
        return {"model": self.net.state_dict(), "average": self.average.state_dict(),
                "opt": self.opt.state_dict(), "rng": self.rng.bit_generator.state,
                "step": self.step, "views": self.views, "spent": self.schedule.seconds(),
                "log": self.log}

    def save(self) -> None:
        part = f"{self.path()}.{os.getpid()}.part"
        with open(part, "xb") as f:  # never somebody else's
            torch.save(self.state(), f)
        os.replace(part, self.path())

    # ---- the loop ----

    def train_step(self, scenes: data.Replay, share: float) -> dict:
        for g in self.opt.param_groups:
            g["lr"] = rate(self.step, share, self.q) * g.get("scale", 1.0)
        loss, parts, views = self.loss(scenes, share)
        self.opt.zero_grad(set_to_none=True)
        loss.backward()
        learn = [p for p in self.net.parameters() if p.grad is not None]
        norm = torch.nn.utils.clip_grad_norm_(learn, CLIP)
        if torch.isfinite(norm):
            self.opt.step()
        self.step += 1
        self.views += views
        self.follow(min(self.q.decay, self.step / (self.step + 10)))
        return {"loss": loss, "norm": norm, **parts}

    @torch.no_grad()
    def follow(self, decay: float) -> None:
        """The running mean of the weights; norms of a batch are such a mean already."""
        for a, p in zip(self.average.parameters(), self.net.parameters()):
            if p.requires_grad:
                a.lerp_(p, 1 - decay)
        for a, b in zip(self.average.buffers(), self.net.buffers()):
            a.copy_(b)

    def run(self) -> None:
        q = self.q
        scenes = self.open_scenes(q.capacity)
        scenes.wait(q.least)
        held_out = self.open_scenes(64, True)
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
                self.export(f"{q.out}/snap.safetensors")
                exported = time.time()
        self.save()
        if not self.stop:
            self.report(held_out)
            self.save()
            self.export(f"{q.out}/{q.stage}.safetensors")

    def report(self, held_out: data.Replay) -> None:
        f = self.validate(held_out)
        f.update(step=self.step, minutes=self.schedule.seconds() / 60, views=self.views)
        self.log.append(f)
        print(f"  validation {show(f)}", flush=True)
        with open(f"{self.q.out}/{self.q.stage}.json", "w") as out:
            json.dump(self.log, out, indent=1)


def show(f: dict) -> str:
    return " ".join(f"{k} {v:.4g}" for k, v in f.items())
