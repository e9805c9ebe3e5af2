#!/usr/bin/env python3
"""How well lenses and poses of cameras were found, against the truth of a simulated rig.

For each true camera (COLMAP text: cameras.txt, images.txt): error of the focal length in percent;
how far the pixels of the whole frame are moved, in px at a longer edge of 1600, largest and rms,
by the lens as found and by its distortion alone (after the best scale about the centre, which a
focal length can do). Then the poses after the best similarity, as colmap_pose.py compares them.
The cameras are a cameras.json of hdrig, whose "photograph" is the lens, or a COLMAP text model.

usage: lens_truth.py --truth SET/sparse/0 --cameras SCENE/cameras.json|MODEL
"""
import argparse
import json
import os

import numpy as np

import colmap_pose

EDGE, GRID, FINE = 1600, 41, 20000
TERMS = {"SIMPLE_PINHOLE": (1, 0), "PINHOLE": (2, 0), "SIMPLE_RADIAL": (1, 1), "RADIAL": (1, 2),
         "OPENCV": (2, 4), "OPENCV_FISHEYE": (2, 4)}


class Lens:
    """core/base/lens.h"""

    def __init__(self, model, w, h, params):
        self.model, self.w, self.h = model, int(w), int(h)
        focal, n = TERMS[model]
        p = [float(x) for x in params]
        self.f = np.array([p[0], p[focal - 1]])
        self.c = np.array(p[focal:focal + 2])
        self.k = np.array(p[focal + 2:focal + 2 + n])
        self.fisheye = model == "OPENCV_FISHEYE"
        end = np.pi if self.fisheye else 8
        r = np.linspace(0, end, FINE)
        s = self.radial(r)
        rising = np.concatenate([[True], np.diff(s) > 0])
        n = FINE if rising.all() else int(np.argmin(rising))
        self.r, self.s = r[:n], s[:n]

    def radial(self, r):
        k = self.k if self.fisheye else self.k[:2]
        return r * (1 + sum(c * r ** (2 * i + 2) for i, c in enumerate(k)))

    def tangential(self, x):
        if self.model != "OPENCV":
            return 0 * x
        p1, p2 = self.k[2:]
        r2, xy = (x ** 2).sum(-1), 2 * x[..., 0] * x[..., 1]
        return np.stack([p1 * xy + p2 * (r2 + 2 * x[..., 0] ** 2),
                         p1 * (r2 + 2 * x[..., 1] ** 2) + p2 * xy], -1)

    def to_ray(self, px):
        """x / z, y / z; of a fisheye the angle in the direction of the ray"""
        to = (px - self.c) / self.f
        x = to
        for _ in range(30 if self.model == "OPENCV" else 1):
            flat = to - self.tangential(x)
            s = np.linalg.norm(flat, axis=-1)
            r = np.interp(s, self.s, self.r)
            for _ in range(3):  # Newton, after the table
                step = 1e-6
                slope = (self.radial(r + step) - self.radial(r - step)) / (2 * step)
                r = np.where(slope > 1e-3, r - (self.radial(r) - s) / np.maximum(slope, 1e-3), r)
            r = np.where(s <= self.s[-1], r, np.nan)
            x = flat * (r / np.maximum(s, 1e-12))[..., None]
        return x

    def to_pixel(self, x, fisheye):
        """fisheye: what kind of ray x is"""
        r = np.linalg.norm(x, axis=-1)
        with np.errstate(invalid="ignore"):
            if fisheye and not self.fisheye:
                to = np.where(r < np.pi / 2, np.tan(np.minimum(r, 1.57)), np.nan)
            elif self.fisheye and not fisheye:
                to = np.arctan(r)
            else:
                to = r
            x = x * (to / np.maximum(r, 1e-12))[..., None]
            seen = to <= self.r[-1]
        factor = np.where(seen, self.radial(to) / np.maximum(to, 1e-12), np.nan)
        return (x * factor[..., None] + self.tangential(x)) * self.f + self.c


def moved(true, found):
    """px at EDGE that the found lens moves the frame; by distortion alone; share without pixel"""
    u, v = np.meshgrid(np.linspace(0, true.w, GRID), np.linspace(0, true.h, GRID))
    px = np.stack([u, v], -1)
    ray = true.to_ray(px)
    there = np.isfinite(ray).all(-1)
    px, ray = px[there], ray[there]
    got = found.to_pixel(ray, true.fisheye) * np.array([true.w / found.w, true.h / found.h])
    ok = np.isfinite(got).all(-1)
    a, b = got[ok] - true.c, px[ok] - true.c
    scale = EDGE / max(true.w, true.h)
    off = np.linalg.norm(a - b, axis=-1) * scale
    bent = np.linalg.norm(a * ((a * b).sum() / max((a * a).sum(), 1e-12)) - b, axis=-1) * scale
    return off, bent, 1 - ok.mean()


def read_model(folder):
    """{name: (camera, lens)}, {name: pose}"""
    lenses, out = {}, {}
    for line in colmap_pose.lines(os.path.join(folder, "cameras.txt")):
        if line:
            word = line.split()
            lenses[word[0]] = Lens(word[1], word[2], word[3], word[4:])
    for line in colmap_pose.lines(os.path.join(folder, "images.txt"))[::2]:
        if line:
            word = line.split(maxsplit=9)
            out[word[9]] = word[8], lenses[word[8]]
    return out, colmap_pose.read_model(folder)


def read_cameras(path):
    lenses, poses = {}, {}
    with open(path) as f:
        for c in json.load(f)["cameras"]:
            p = c.get("photograph", c)
            lens = Lens(p.get("model", "PINHOLE"), p["w"], p["h"],
                        p.get("params") or [c[k] for k in ("fx", "fy", "cx", "cy")])
            lenses[c["name"]] = None, lens
            poses[c["name"]] = (colmap_pose.rotation(c["q"]), np.array(c["t"]), lens.f[0] / lens.w)
    return lenses, poses


def worst(px):
    return f"largest {px.max(initial=0):.2f} rms {np.sqrt((px ** 2).sum() / max(px.size, 1)):.2f}"


def main():
    p = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    p.add_argument("--truth", required=True)
    p.add_argument("--cameras", required=True)
    args = p.parse_args()
    true, true_poses = read_model(args.truth)
    read = read_model if os.path.isdir(args.cameras) else read_cameras
    found, poses = read(args.cameras)
    by_place = {colmap_pose.place(n): v for n, v in true.items()}
    rows = {}
    for name, (_, lens) in found.items():
        camera, of = true.get(name) or by_place.get(colmap_pose.place(name)) or (None, None)
        if of:
            rows.setdefault(camera, []).append((of, lens, *moved(of, lens)))
    for camera in sorted(rows, key=int):
        of, lens, off, bent, lost = max(rows[camera], key=lambda r: r[2].max(initial=0))
        focal = 100 * (lens.f[0] / lens.w / (of.f[0] / of.w) - 1)
        print(f"camera {camera}, {of.model} {of.w} x {of.h}, {len(rows[camera])} photographs: "
              f"found {lens.model}, focal length {focal:+.3f} %, distortion {worst(bent)}, lens "
              f"{worst(off)} px at {EDGE}, {100 * lost:.1f} % without pixel")
    colmap_pose.compare(args.cameras, poses, true_poses, len(poses))


if __name__ == "__main__":
    main()
