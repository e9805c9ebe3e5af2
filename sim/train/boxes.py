"""A simple generator: textured boxes in a textured room with lamps, without shadows. Stands in
where libsim.so is not built, and mixes easy scenes into the training set. Same conventions as
sim/train/sample.h: x right, y down, z forward; world z up; depth along z at pixel centres."""

from __future__ import annotations

import math

import numpy as np

TEX, EDGE = 96, 256


def smooth_noise(r: np.random.Generator, power: float) -> np.ndarray:
    f = np.fft.fftfreq(EDGE)
    k = np.sqrt(f[:, None] ** 2 + f[None] ** 2) * EDGE
    k[0, 0] = 1
    a = np.fft.ifft2(np.fft.fft2(r.standard_normal((EDGE, EDGE))) / k**power).real
    return (a - a.mean()) / (a.std() + 1e-9)


def cells(r: np.random.Generator, n: int) -> np.ndarray:
    """Index of the nearest of n points, on the torus."""
    p = r.random((n, 2)) * EDGE
    y, x = np.mgrid[:EDGE, :EDGE]
    best, at = np.full((EDGE, EDGE), 1e9), np.zeros((EDGE, EDGE), int)
    for i in range(n):
        dy, dx = np.abs(y - p[i, 0]), np.abs(x - p[i, 1])
        d = np.minimum(dy, EDGE - dy) ** 2 + np.minimum(dx, EDGE - dx) ** 2
        at[d < best] = i
        best = np.minimum(best, d)
    return at


def pattern(r: np.random.Generator) -> np.ndarray:
    """Values -1..1."""
    y, x = np.mgrid[:EDGE, :EDGE]
    kind = r.integers(7)
    if kind == 0:
        return np.tanh(smooth_noise(r, r.uniform(0.7, 1.8)))
    if kind == 1:
        n = 2 ** r.integers(2, 6)
        return ((x * n // EDGE + y * n // EDGE) % 2) * 2.0 - 1
    if kind == 2:  # bricks or tiles
        h = 2 ** r.integers(3, 6)
        shift = (y // h % 2) * (h if r.random() < 0.6 else 0)
        shade = r.uniform(-0.6, 1, (EDGE, EDGE))[y // h, (x + shift) % EDGE // (2 * h)]
        joint = (y % h < max(1, h // 8)) | ((x + shift) % (2 * h) < max(1, h // 8))
        return np.where(joint, -1, shade)
    if kind == 3:
        return r.uniform(-1, 1, 400)[cells(r, int(r.integers(20, 150)))]
    if kind == 4:  # planks
        w = 2 ** r.integers(3, 6)
        s = smooth_noise(r, 1.2)
        return np.tanh(r.uniform(-1, 1, EDGE)[x // w] + 0.5 * np.roll(s, 37)[y // 8, x])
    if kind == 5:  # print
        out = np.ones((EDGE, EDGE))
        for _ in range(int(r.integers(60, 300))):
            a, b = r.integers(0, EDGE, 2)
            h, w = r.integers(2, 26), r.integers(2, 50)
            out[a : a + h, b : b + w] = r.uniform(-1, 1)
        return out
    w = r.uniform(0.02, 0.3)
    return np.sin(w * (x * math.cos(w * 40) + y * math.sin(w * 40))) * np.sign(smooth_noise(r, 1.5))


def texture(r: np.random.Generator) -> np.ndarray:
    v = 0.5 + 0.5 * np.clip(0.8 * pattern(r) + 0.25 * np.tanh(smooth_noise(r, 1.0)), -1, 1)
    hue, b = r.uniform(-0.3, 0.3, (2, 3)), np.array([r.uniform(0.03, 0.4), r.uniform(0.4, 0.95)])
    a = np.clip(b[:, None] + hue * r.uniform(0, 1.2), 0.01, 0.97)
    return np.clip(a[0] + v[..., None] * (a[1] - a[0]), 0.01, 0.97).astype(np.float32)


def atlas(seed: int) -> tuple[np.ndarray, list[int]]:
    """All textures in all halved sizes, flat, and where each size starts."""
    r = np.random.default_rng(seed)
    level = np.stack([texture(r) for _ in range(TEX)])
    flat, start, at = [], [], 0
    while level.shape[1] >= 4:
        flat.append(level.reshape(-1, 3))
        start.append(at)
        at += len(flat[-1])
        n = level.shape[1] // 2
        level = level.reshape(TEX, n, 2, n, 2, 3).mean((2, 4))
    return np.concatenate(flat), start


def look_at(eye: np.ndarray, target: np.ndarray, roll: float) -> np.ndarray:
    z = target - eye
    z = z / np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1.0])
    x = x / np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = math.cos(roll), math.sin(roll)
    return np.stack([c * x + s * y, c * y - s * x, z])


class Boxes:
    def __init__(self, atlas_seed: int = 5):
        self.atlas, self.start = atlas(atlas_seed)

    def world(self, r: np.random.Generator) -> dict:
        """Boxes: centre, half size, turn around z, texture, scale (texels / m), tint."""
        half = np.array([r.uniform(1.8, 4), r.uniform(1.8, 4), r.uniform(1.2, 1.7)])
        n = int(r.integers(8, 24))
        size = np.exp(r.uniform(np.log(0.08), np.log(0.9), (n, 3)))
        size[: n // 3, int(r.integers(3))] *= 0.1
        spot = r.uniform(-0.75, 0.75, (n, 3)) * half
        spot[:, 2] = np.where(r.random(n) < 0.7, size[:, 2] - half[2], spot[:, 2])
        c = np.concatenate([np.zeros((1, 3)), spot])
        h = np.concatenate([half[None], size])
        lamps = r.uniform(-0.9, 0.9, (int(r.integers(1, 4)), 3)) * half
        lamps[:, 2] = np.abs(lamps[:, 2])
        return {"c": c, "h": h, "turn": np.concatenate([[0], r.uniform(0, 6.3, n)]),
                "tex": r.integers(0, TEX, (n + 1, 6)), "half": half, "lamps": lamps,
                "scale": EDGE / np.exp(r.uniform(np.log(0.7), np.log(4), (n + 1, 6))),
                "power": np.exp(r.uniform(-2, 2, (len(lamps), 1))) * r.uniform(0.6, 1, (1, 3)),
                "glow": np.where(r.random(n + 1) < 0.08, np.exp(r.uniform(0, 4, n + 1)), 0),
                "shift": r.random((n + 1, 6, 2))}

    def cameras(self, w: dict, r: np.random.Generator, n: int, size: int, spread: float,
                fov: float) -> np.ndarray:
        """(n, 11) fx fy cx cy, q wxyz, t."""
        f = size / 2 / math.tan(math.radians(fov) / 2)
        focus = w["c"][1:][int(r.integers(len(w["c"]) - 1))] * 0.7
        away, turn = r.uniform(0.9, 2.8), r.uniform(0, 6.3)
        out = []
        for _ in range(n):
            a = turn + r.uniform(-1, 1) * spread * 1.6
            d = away * math.exp(r.uniform(-1, 1) * 0.35 * min(1, spread * 3))
            eye = focus + d * np.array([math.cos(a), math.sin(a), 0])
            eye[2] = r.uniform(-0.5, 0.5) * min(1, spread * 3) + 0.15
            eye = np.clip(eye, -0.93 * w["half"], 0.93 * w["half"])
            eye = self.step_out(w, eye)
            target = focus + r.normal(size=3) * 0.25
            rot = look_at(eye, target, r.normal() * 0.06)
            out.append(np.concatenate([[f, f, size / 2, size / 2], quaternion(rot), -rot @ eye]))
        return np.array(out, np.float32)

    def step_out(self, w: dict, eye: np.ndarray) -> np.ndarray:
        """A camera inside of a box goes above it."""
        for c, h, a in zip(w["c"][1:], w["h"][1:], w["turn"][1:]):
            d = eye - c
            x, y = d[0] * np.cos(a) + d[1] * np.sin(a), d[1] * np.cos(a) - d[0] * np.sin(a)
            if abs(x) < h[0] + 0.05 and abs(y) < h[1] + 0.05 and abs(d[2]) < h[2] + 0.05:
                eye = np.array([eye[0], eye[1], min(c[2] + h[2] + 0.15, 0.93 * w["half"][2])])
        return eye

    def shoot(self, w: dict, cam: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
        """Radiance (3, size, size) and depth (size, size)."""
        f, rot = cam[0], matrix(cam[4:8])
        i = (np.arange(size, dtype=np.float32) + 0.5 - size / 2) / f
        local = np.stack([np.broadcast_to(i, (size, size)),
                          np.broadcast_to(i[:, None], (size, size)),
                          np.ones((size, size), np.float32)], -1).reshape(-1, 3)
        d, eye = local @ rot, -rot.T @ cam[8:11]
        t, which, face = self.cast(w, eye, d)
        p = eye + t[:, None] * d
        return self.shade(w, p, d, which, face, t / f).T.reshape(3, size, size), \
            t.reshape(size, size)

    def cast(self, w: dict, eye: np.ndarray, d: np.ndarray):
        best = np.full(len(d), 1e3, np.float32)
        which, face = np.zeros(len(d), int), np.zeros(len(d), int)
        for k in range(len(w["c"])):
            o, v = turn(eye - w["c"][k], w["turn"][k]), turn(d, w["turn"][k])
            v = np.where(np.abs(v) < 1e-7, 1e-7, v)
            lo, hi = (-w["h"][k] - o) / v, (w["h"][k] - o) / v
            near, far = np.minimum(lo, hi), np.maximum(lo, hi)
            a, b = near.max(1), far.min(1)
            t = b if k == 0 else a  # the room is seen from inside
            ok = (t > 1e-3) & (t < best) & (a < b)
            axis = far.argmin(1) if k == 0 else near.argmax(1)
            best[ok], which[ok] = t[ok], k
            sign = np.take_along_axis(v, axis[:, None], 1)[:, 0] > 0
            face[ok] = (2 * axis + sign)[ok]
        return best, which, face

    def shade(self, w: dict, p, d, which, face, footprint) -> np.ndarray:
        n, axis = len(p), face // 2
        a = w["turn"][which]
        q = p - w["c"][which]
        x, y = q[:, 0] * np.cos(a) + q[:, 1] * np.sin(a), q[:, 1] * np.cos(a) - q[:, 0] * np.sin(a)
        q = np.stack([x, y, q[:, 2]], 1)
        normal = np.zeros((n, 3))
        normal[np.arange(n), axis] = 1
        normal = np.stack([normal[:, 0] * np.cos(a) - normal[:, 1] * np.sin(a),
                           normal[:, 0] * np.sin(a) + normal[:, 1] * np.cos(a), normal[:, 2]], 1)
        cosine = np.abs((normal * d).sum(1)) / np.linalg.norm(d, axis=1)
        uv = np.stack([q[np.arange(n), (axis + 1) % 3], q[np.arange(n), (axis + 2) % 3]], 1)
        scale = w["scale"][which, face]
        uv = uv * scale[:, None] + w["shift"][which, face] * EDGE
        albedo = self.sample(w["tex"][which, face], uv, footprint * scale / np.sqrt(cosine + 0.05))
        light = np.full((n, 3), 0.25)
        for at, power in zip(w["lamps"], w["power"]):
            v = at - p
            r2 = (v * v).sum(1) + 0.05
            light += (np.abs((normal * v).sum(1)) / r2**1.5)[:, None] * power
        return (albedo * light + albedo * w["glow"][which][:, None]).astype(np.float32)

    def sample(self, tex: np.ndarray, uv: np.ndarray, texels: np.ndarray) -> np.ndarray:
        level = np.clip(np.rint(np.log2(np.maximum(texels, 1))), 0, len(self.start) - 1).astype(int)
        edge = EDGE >> level
        uv = uv / (1 << level)[:, None] - 0.5
        at = np.floor(uv)
        f, at = uv - at, at.astype(int)
        base = np.array(self.start)[level] + tex * edge * edge
        out = 0
        for dy in (0, 1):
            for dx in (0, 1):
                y, x = (at[:, 0] + dy) % edge, (at[:, 1] + dx) % edge
                g = (f[:, 0] if dy else 1 - f[:, 0]) * (f[:, 1] if dx else 1 - f[:, 1])
                out = out + g[:, None] * self.atlas[base + y * edge + x]
        return out


def turn(v: np.ndarray, a: float) -> np.ndarray:
    """World to the frame of a box turned by a around z."""
    c, s = math.cos(a), math.sin(a)
    return np.stack([v[..., 0] * c + v[..., 1] * s, v[..., 1] * c - v[..., 0] * s, v[..., 2]],
                    -1).astype(np.float32)


def quaternion(m: np.ndarray) -> np.ndarray:
    """wxyz of a rotation."""
    k = np.array([[m[0, 0] - m[1, 1] - m[2, 2], 0, 0, 0],
                  [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0, 0],
                  [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0],
                  [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], np.trace(m)]]) / 3
    v = np.linalg.eigh(k)[1][[3, 0, 1, 2], 3]
    return v if v[0] >= 0 else -v


def matrix(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q / np.linalg.norm(q)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def make(gen: Boxes, seed: int, n: int, size: int, spread: float, fov: float):
    """Radiance (n, 3, size, size), depth, cameras (n, 11), key: the scale of exposure 2^0."""
    r = np.random.default_rng(seed)
    w = gen.world(r)
    cams = gen.cameras(w, r, n, size, spread, fov)
    views = [gen.shoot(w, c, size) for c in cams]
    radiance, depth = (np.stack(x) for x in zip(*views))
    key = 0.18 / max(float(np.median([np.median(x[1]) for x in radiance])), 1e-9)
    return radiance, depth.astype(np.float32), cams, key
