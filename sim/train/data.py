"""Training data: worlds rendered once, many samples from each.

A worker process renders scenes into a folder, one file each, which is queue, cache and start of the
next run at once:
    python3 sim/train/data.py FOLDER [--first SEED] [--count N] [--boxes SHARE] [--size PX]
With --stereo they are what the program's own stereo makes of photographs, for completion.py.
Replay keeps the latest of them in memory and makes batches: some of the views in random order, each
at one exposure of a bracket, one random response curve for all, noise, 8 bits."""

from __future__ import annotations

import argparse
import ctypes as c
import math
import os
import time
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

import boxes
from complete import INPUTS

FAR = 999.0  # m, RENDER_FAR and beyond is sky
VALIDATION = 1_000_000  # first seed that is never trained on
ANY, ROOM, YARD, DARK, PLAIN, MIRROR, PARK = range(-1, 6)  # enum world_kind


# ---- scenes ----


class Quality(c.Structure):
    _fields_ = [("samples", c.c_int), ("shadow", c.c_int), ("lens", c.c_void_p)]


class SampleScene(c.Structure):
    _fields_ = [("seed", c.c_uint64), ("kind", c.c_int), ("n_views", c.c_int), ("size", c.c_int),
                ("spread", c.c_float), ("fov_deg", c.c_float), ("jitter", c.c_int),
                ("orbit_deg", c.c_float), ("walk", c.c_int),
                ("quality", Quality), ("n_optics", c.c_int),
                ("optics", c.c_void_p), ("rig", c.c_void_p), ("target", c.c_void_p),
                ("switched", c.c_int)]


class Request(c.Structure):
    """struct sample_request of sim/train/sample.h."""

    _fields_ = [("scene", SampleScene), ("noise", c.c_int), ("curve_family", c.c_int),
                ("curve_param", c.c_float), ("curve_seed", c.c_uint64), ("noise_seed", c.c_uint64)]


class Stereo(c.Structure):
    """struct stereo_request of sim/train/stereo.h."""

    _fields_ = [("n", c.c_int), ("w", c.c_int), ("h", c.c_int), ("px", c.c_void_p),
                ("log2t", c.c_void_p), ("cams", c.c_void_p), ("input", c.c_void_p),
                ("guess", c.c_void_p)]


class Worlds:
    """sim/train/sample.h and stereo.h through ctypes."""

    def __init__(self, path: str):
        self.lib = c.CDLL(path)
        self.lib.sample_error.restype = c.c_char_p

    def call(self, name: str, q: c.Structure, *rest) -> None:
        rest = (c.c_void_p(a.ctypes.data) if isinstance(a, np.ndarray) else a for a in rest)
        if getattr(self.lib, name)(c.byref(q), *rest):
            raise RuntimeError(self.lib.sample_error().decode())

    def photograph(self, q: Request) -> tuple:
        """Radiance, depth, cameras and the exposure time (s) of 2^0."""
        n, size = q.scene.n_views, q.scene.size
        radiance = np.empty((n, 3, size, size), np.float32)
        depth = np.empty((n, size, size), np.float32)
        cams, key = np.empty((n, 11), np.float32), c.c_double()
        self.call("sample_photograph", q, radiance, depth, cams, c.byref(key))
        return radiance, depth, cams, key

    def make(self, seed: int, n: int, size: int, spread: float, fov: float, kind: int):
        q = Request(SampleScene(seed=seed, kind=kind, n_views=n, size=size, spread=spread,
                                fov_deg=fov, jitter=1, quality=Quality(samples=1, shadow=1)))
        radiance, depth, cams, _ = self.photograph(q)
        # the key counts electrons of sensor_default; here 1 is full scale, the median 0.18
        middle = np.median([np.median(v.mean(0)) for v in radiance])
        return radiance, depth, cams, 0.18 / max(float(middle), 1e-9)

    def stereo(self, px: np.ndarray, stops: np.ndarray, cams: np.ndarray) -> tuple:
        """What the completion branch is told of photographs (n, h, w, 3), and the guess."""
        n, h, w = px.shape[:3]
        x, guess = np.empty((n, h, w, INPUTS), np.float32), np.empty((n, h, w), np.float32)
        at = (a.ctypes.data for a in (px, stops, cams, x, guess))
        self.call("stereo_run", Stereo(n, w, h, *at))
        return x, guess


def draw_photographs(q: Request, r: np.random.Generator) -> np.ndarray:
    """Exposures for a program that finds the response itself; how they are taken goes to q."""
    n = q.scene.n_views
    q.noise = int(r.random() < 0.7)
    q.curve_family, q.curve_seed = -1, int(r.integers(1 << 40))
    step = r.uniform(0.5, 4) if r.random() < 0.6 else 0.0
    return (r.integers(-1, 2, n) * step + r.uniform(-0.7, 0.7)).astype(np.float32)


def make_stereo(seed: int, worlds: Worlds) -> dict:
    """Arrays of a world that the program's stereo has seen: its kind, what the branch is told
    (n, h, w, INPUTS), the true residual (log2) to the guess, and sky."""
    r = np.random.default_rng(seed + 991)
    kind = int(r.choice([ROOM, YARD, PARK, DARK, PLAIN], p=[0.33, 0.25, 0.34, 0.05, 0.03]))
    n = int(r.choice([2, 3, 4, 5, 6, 8, 10], p=[0.06, 0.14, 0.22, 0.2, 0.18, 0.12, 0.08]))
    size = int(r.choice([160, 192, 224, 256]))
    fov = float(r.uniform(40, 85))
    spread = float(np.exp(r.uniform(math.log(0.08), math.log(0.9))))
    orbit = float(r.choice([0, 10, 20, 30, 45])) if kind == PARK else 0.0
    q = Request(SampleScene(seed=seed, kind=kind, n_views=n, size=size, spread=spread, fov_deg=fov,
                            jitter=1, orbit_deg=orbit, quality=Quality(samples=2, shadow=1)))
    radiance, depth, cams, key = worlds.photograph(q)
    stops = draw_photographs(q, r)
    px = np.empty((n, size, size, 3), np.uint8)
    for i in range(n):
        q.noise_seed = int(r.integers(1 << 40))
        worlds.call("sample_develop", q, key, radiance[i], 1, stops[i:], px[i])
    x, guess = worlds.stereo(px, stops, cams)
    residual = np.clip(-np.log2(depth) - np.log2(guess), -6, 6)
    half = {"x": x.astype(np.float16), "residual": residual.astype(np.float16)}
    if not all(np.isfinite(a).all() for a in half.values()):
        raise RuntimeError("stereo: numbers that are not finite")
    return {"kind": np.array(kind), **half, "sky": depth >= FAR}


def make_scene(seed: int, size: int, worlds: Worlds | None, easy: boxes.Boxes, share: float):
    r = np.random.default_rng(seed + 77)
    n = int(r.integers(9, 12))
    spread = float(np.exp(r.uniform(math.log(0.06), math.log(0.8))))
    fov = float(r.uniform(40, 85))
    kind = int(r.choice([ANY, DARK, PLAIN, MIRROR], p=[0.92, 0.03, 0.02, 0.03]))
    if worlds is None or r.random() < share:
        return boxes.make(easy, seed, n, size, spread, fov)
    return worlds.make(seed, n, size, spread, fov, kind)


def make_radiance(*scene) -> dict:
    """Arrays of a scene of make_scene."""
    radiance, depth, cams, key = make_scene(*scene)
    half = np.clip(radiance * key, 0, 6e4).astype(np.float16)
    return {"radiance": half, "depth": depth.astype(np.float16), "cams": cams}


def save_scene(path: str, arrays: dict) -> None:
    part = f"{path}.{os.getpid()}.part"
    with open(part, "xb") as f:  # never somebody else's
        np.savez(f, **arrays)
    os.replace(part, path)


def work(a: argparse.Namespace) -> None:
    os.makedirs(a.folder, exist_ok=True)
    easy, lib = boxes.Boxes(), Worlds(a.lib) if a.stereo else None
    for seed in range(a.first, a.first + a.count * a.stride, a.stride):
        path = f"{a.folder}/{seed:08d}.npz"
        if lib is None and os.path.exists(a.lib):  # appears while others still build it
            lib = Worlds(a.lib)
        if os.path.exists(path):
            continue
        try:
            save_scene(path, make_stereo(seed, lib) if a.stereo else
                       make_radiance(seed, a.size, lib, easy, a.boxes))
        except RuntimeError as e:
            print(f"scene {seed}: {e}", flush=True)


# ---- batches ----


@dataclass
class Batch:
    images: Tensor  # (B, V, 3, S, S) 0..1, multiples of 1/255
    stops: Tensor  # (B, V) log2 of the exposure
    depth: Tensor  # (B, V, S, S) z, in units of the scene; 0 where there is nothing
    pose: Tensor  # (B, V, 9) T, quaternion xyzw (w >= 0), vertical and horizontal FoV
    radiance: Tensor  # (B, V, 3, S, S) 1 is full scale at exposure 2^0
    curve: Tensor  # (B, KNOTS) display values over log2 exposure

    def to(self, device: str) -> "Batch":
        return Batch(*(t.to(device) for t in vars(self).values()))

    def first(self, v: int) -> "Batch":
        """The first v views of every scene."""
        return Batch(*(t[:, :v] for k, t in vars(self).items() if k != "curve"), self.curve)

    def scene(self, i: int) -> "Batch":
        return Batch(*(t[i : i + 1] for t in vars(self).values()))


KNOTS, LOW, HIGH = 256, -13.0, 4.0  # a curve over log2 of exposure / full scale


def film(x: np.ndarray, white: float) -> np.ndarray:
    def aces(e):
        return (e * (2.51 * e + 0.03)) / (e * (2.43 * e + 0.59) + 0.14)
    return (aces(white * np.exp2(np.minimum(x, 0))) / aces(white)) ** (1 / 2.2)


def agx(x: np.ndarray, pivot: float, stops: float) -> np.ndarray:
    """A sigmoid over stops, as core/photo/response_family.c has it."""
    def bend(v, end):
        return v / np.sqrt(1 + (1 - end**-2) * v * v)
    grey = 0.42
    slope, toe = 1.25 * (1 - grey) / -pivot, stops + pivot
    steep = max(slope * toe / grey, 1.01)
    up = grey + (1 - grey) * bend((np.clip(x, pivot, 0) - pivot) * slope / (1 - grey), 1.25)
    down = grey * (1 - bend(np.clip((pivot - x) / toe, 0, 1) * steep, steep))
    return np.where(x >= pivot, up, down)


def random_curve(r: np.random.Generator) -> Tensor:
    """A rising display curve, 1 where the sensor is full: sRGB, power, film, sigmoid in stops or
    camera log (core/photo/response_family.h), bent by a smooth random change. Film and sigmoid hold
    more light than fits into the others at the same exposure."""
    x = np.linspace(LOW, HIGH, KNOTS)
    e = np.minimum(np.exp2(x), 1)
    kind = r.integers(5)
    if kind == 0:
        y = np.where(e <= 0.0031308, 12.92 * e, 1.055 * e ** (1 / 2.4) - 0.055)
    elif kind == 1:
        y = e ** (1 / r.uniform(1.6, 3))
    elif kind == 2:
        stops = r.uniform(0, 4)  # of white over that of sRGB
        y = film(x - stops, 2**stops * r.uniform(0.8, 2.5))
    elif kind == 3:
        pivot, under = r.uniform(-6.5, -2.5), r.uniform(6, 10)
        y = agx(x - (-2.5 - pivot), pivot, under - pivot)
    else:
        a = r.uniform(3, 8)
        y = np.log2(1 + 2**a * e) / np.log2(1 + 2**a)
    steep = np.diff(y, prepend=0).clip(0)
    bend = np.interp(x, np.linspace(LOW, HIGH, 7), r.normal(size=7) * 0.35 * r.random())
    y = np.cumsum(steep * np.exp(bend))
    y = y / y[-1] if y[-1] > 1 or r.random() < 0.8 else y
    return torch.from_numpy(np.clip(y, 0, 1).astype(np.float32))


def develop(exposure: Tensor, curve: Tensor) -> Tensor:
    """Display value; exposure (N, ...) relative to full scale, curve (N, KNOTS)."""
    x = (torch.log2(exposure.clamp_min(1e-9)) - LOW) / (HIGH - LOW) * (KNOTS - 1)
    x = x.clamp(0, KNOTS - 1.001).flatten(1)
    i = x.long()
    f = x - i
    a, b = curve.gather(1, i), curve.gather(1, i + 1)
    y = a + (b - a) * f
    y = y * (exposure.flatten(1) > 2.0**LOW)
    return y.view_as(exposure)


def sensor_noise(e: Tensor, g: torch.Generator, well: float = 10000.0, read: float = 2.5) -> Tensor:
    """Shot and read noise of a sensor that holds `well` electrons at exposure 1; it is full where
    the curve says."""
    n = e.clamp(0, 2**HIGH) * well
    n = n + torch.randn(n.shape, generator=g) * torch.sqrt(n + read * read)
    return (n / well).clamp(0, 2**HIGH)


def draw_stops(r: np.random.Generator, v: int) -> np.ndarray:
    """One exposure for each of v views from a bracket of three around the middle."""
    step = r.uniform(0.5, 4.5) if r.random() < 0.9 else 0.0
    choice = r.integers(-1, 2, v)
    return (choice * step + r.uniform(-1.2, 1.2)).astype(np.float32)


def rotation(q: Tensor) -> Tensor:
    """(..., 3, 3) of wxyz."""
    w, x, y, z = F.normalize(q, dim=-1).unbind(-1)
    m = torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
                     2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
                     2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], -1)
    return m.unflatten(-1, (3, 3))


def to_first(q: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
    """Cameras (V, 4) wxyz and (V, 3), world to camera, into the frame of the first."""
    w0, v0 = q[0, 0], -q[0, 1:]
    w, v = q[:, 0], q[:, 1:]
    rel = torch.cat([(w * w0 - (v * v0).sum(-1))[:, None],
                     w[:, None] * v0 + w0 * v + torch.linalg.cross(v, v0.expand_as(v))], -1)
    rel = rel * torch.where(rel[:, :1] < 0, -1.0, 1.0)
    return F.normalize(rel, dim=-1), t - (rotation(rel) @ t[0])


def resize_depth(d: Tensor, n: int) -> Tensor:
    """Nearest sample; (V, S, S)."""
    s = d.shape[-1]
    i = ((torch.arange(n) + 0.5) * s / n).long()
    return d[:, i][:, :, i]


class Scene:
    def __init__(self, path: str):
        with np.load(path) as z:
            self.radiance = torch.from_numpy(z["radiance"])
            self.depth = torch.from_numpy(z["depth"])
            self.cams = torch.from_numpy(z["cams"])
        self.views, self.size = len(self.cams), self.depth.shape[-1]

    def sample(self, r: np.random.Generator, v: int, size: int) -> tuple:
        """Parts of one sample: images, stops, depth, pose, radiance, curve."""
        pick = torch.from_numpy(r.permutation(len(self.cams))[:v])
        full = self.size
        radiance = self.radiance[pick].float()
        depth = self.depth[pick].float()
        if size != full:
            radiance = F.interpolate(radiance, (size, size), mode="bilinear", antialias=True,
                                     align_corners=False)
            depth = resize_depth(depth, size)
        cams = self.cams[pick].double()
        q, t = to_first(cams[:, 4:8], cams[:, 8:11])
        fov = 2 * torch.atan(full / 2 / cams[:, [1, 0]])  # fy, fx: vertical comes first
        valid = (depth > 0) & (depth < FAR)
        scale = 1 / self.mean_distance(depth, valid, q, t, fov).clamp(1e-3, 1e3)
        depth = torch.where(valid, depth * scale, 0)
        pose = torch.cat([t * scale, q[:, [1, 2, 3, 0]], fov], -1).float()
        stops = torch.from_numpy(draw_stops(r, v))
        curve = random_curve(r)
        g = torch.Generator().manual_seed(int(r.integers(1 << 62)))
        noisy = sensor_noise(radiance * torch.exp2(stops)[:, None, None, None], g)
        images = develop(noisy, curve.expand(v, -1))
        images = torch.round(images * 255) / 255
        return images, stops, depth.float(), pose, radiance, curve

    @staticmethod
    def mean_distance(depth, valid, q, t, fov) -> Tensor:
        """Of the points to the first camera."""
        x, ok = unproject(depth[:, ::4, ::4], q, t, fov), valid[:, ::4, ::4]
        return x.norm(dim=-1)[ok].mean() if ok.any() else torch.tensor(1.0)


def unproject(depth: Tensor, q: Tensor, t: Tensor, fov: Tensor) -> Tensor:
    """World points (V, h, w, 3) of pixels spread evenly over the picture."""
    n = depth.shape[-1]
    u = (torch.arange(n, device=depth.device) + 0.5) * 2 / n - 1
    k = torch.tan(fov / 2).to(depth.dtype)
    x = u * k[:, 1, None, None]
    y = u[:, None] * k[:, 0, None, None]
    p = torch.stack([x.expand_as(depth), y.expand_as(depth), torch.ones_like(depth)], -1)
    p = p * depth[..., None]
    r = rotation(q).to(depth.dtype)
    return torch.einsum("vji,vhwj->vhwi", r, p - t.to(depth.dtype)[:, None, None])


class Replay:
    """Scenes in memory; new files replace the oldest."""

    first_held_out = VALIDATION

    def __init__(self, folder: str, capacity: int, validation: bool = False):
        self.folder, self.capacity, self.validation = folder, capacity, validation
        self.scenes: dict[str, Scene] = {}
        self.seen: set[str] = set()
        self.refresh()

    def load(self, path: str) -> Scene:
        return Scene(path)

    def refresh(self, limit: int = 10**9) -> None:
        names = sorted(n for n in os.listdir(self.folder) if n.endswith(".npz"))
        names = [n for n in names if (int(n[:8]) >= self.first_held_out) == self.validation]
        for n in [n for n in names if n not in self.seen][-limit:]:
            self.seen.add(n)
            self.scenes[n] = self.load(f"{self.folder}/{n}")
        while len(self.scenes) > self.capacity:
            del self.scenes[next(iter(self.scenes))]

    def wait(self, count: int) -> None:
        if len(self.scenes) < count:
            kind = "validation" if self.validation else "training"
            print(f"{self.folder}: {len(self.scenes)} scenes for {kind}, waiting for {count}",
                  flush=True)
        while len(self.scenes) < count:
            time.sleep(2)
            self.refresh()

    def batch(self, r: np.random.Generator, b: int, v: int, size: int) -> Batch:
        """Of scenes with so many views, rendered at least as large, if there are any; else of the
        rest, with as many views as the least of them has."""
        fit = [n for n, s in self.scenes.items() if s.views >= v and s.size >= size]
        names = fit or list(self.scenes)
        names = [names[i] for i in r.integers(len(names), size=b)]
        return self.collect(names, r, min(v, *(self.scenes[n].views for n in names)), size)

    def collect(self, names: list[str], r: np.random.Generator, v: int, size: int) -> Batch:
        parts = [self.scenes[n].sample(r, v, size) for n in names]
        return Batch(*(torch.stack(x) for x in zip(*parts)))


if __name__ == "__main__":
    p = argparse.ArgumentParser()
    p.add_argument("folder")
    p.add_argument("--first", type=int, default=0)
    p.add_argument("--count", type=int, default=10**9)
    p.add_argument("--stride", type=int, default=1, help="from seed to seed: how many share them")
    p.add_argument("--stereo", action="store_true", help="for the stage complete")
    p.add_argument("--boxes", type=float, default=0.15)
    p.add_argument("--size", type=int, default=224)
    p.add_argument("--lib", default="build/x86_64-pic/libsim.so")
    torch.set_num_threads(1)
    work(p.parse_args())
