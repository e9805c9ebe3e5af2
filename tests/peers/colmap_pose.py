#!/usr/bin/env python3
"""How well COLMAP places the cameras of a folder of images, and how well a cameras.json does.

COLMAP (Debian: apt-get install --no-install-recommends colmap; Debian 12 has version 3.8), here on
the CPU, is no dependency of the tests. It gets one shared SIMPLE_PINHOLE camera, whose principal
point stays in the middle. Its largest model, and the file that hdrig writes, are compared with a
true model (COLMAP text: cameras.txt, images.txt) after the best similarity: median error of the
rotations in degrees, of the centres as a share of their spread, and the focal length over the true
one. Images of the true model are found by name, or else by name without the number of the exposure
at its end.

usage: colmap_pose.py --truth sparse/0 [--cameras cameras.json]
                      [--images DIR [--names a.png,b.png | --protocol protocol.json --views 18]
                       [--work DIR] [--threads 2] [--focal PX, of PNG]]
"""
import argparse
import json
import os
import re
import shutil
import struct
import subprocess
import tempfile
import time

import numpy as np


def rotation(q):
    w, x, y, z = np.asarray(q, float) / np.linalg.norm(q)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def lines(path):
    with open(path) as f:
        return [line.strip() for line in f if not line.startswith("#")]


def read_model(folder):
    """{name: (R, t, focal / width)} of a text model"""
    cams = {}
    for line in lines(os.path.join(folder, "cameras.txt")):
        if line:
            word = line.split()
            cams[word[0]] = float(word[4]) / float(word[2])
    out = {}
    for line in lines(os.path.join(folder, "images.txt"))[::2]:
        if line:
            word = line.split(maxsplit=9)
            v = [float(x) for x in word[1:8]]
            out[word[9]] = (rotation(v[:4]), np.array(v[4:]), cams[word[8]])
    return out


def read_cameras(path):
    with open(path) as f:
        return {c["name"]: (rotation(c["q"]), np.array(c["t"]), c["fx"] / c["w"])
                for c in json.load(f)["cameras"]}


def place(name):
    """Name without extension and number of the exposure."""
    return re.sub(r"_\d+$", "", os.path.splitext(os.path.basename(name))[0])


def similarity(a, b):
    """s, R, t with b = s R a + t (Umeyama 1991)"""
    ma, mb = a.mean(0), b.mean(0)
    u, d, vt = np.linalg.svd((b - mb).T @ (a - ma))
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    r = u @ sign @ vt
    s = np.trace(np.diag(d) @ sign) / max(((a - ma) ** 2).sum(), 1e-30)
    return s, r, mb - s * r @ ma


def mean_rotation(found, true):
    """World rotation by the rotations of the cameras: centres in a row do not show it."""
    total = sum(rt.T @ rf for (rf, _, _), (rt, _, _) in zip(found, true))
    u, _, vt = np.linalg.svd(total)
    return u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt


def compare(label, model, truth, wanted):
    by_place = {place(n): c for n, c in truth.items()}
    pairs = [(c, truth.get(n) or by_place.get(place(n))) for n, c in model.items()]
    pairs = [(f, t) for f, t in pairs if t is not None]
    if len(pairs) < 2:
        print(f"{label}: {len(pairs)} of {wanted} cameras are known")
        return
    found, true = [p[0] for p in pairs], [p[1] for p in pairs]
    world = mean_rotation(found, true)
    angles = [np.degrees(np.arccos(np.clip((np.trace(rt @ world @ rf.T) - 1) / 2, -1, 1)))
              for (rf, _, _), (rt, _, _) in zip(found, true)]
    a = np.array([-r.T @ t for r, t, _ in found])
    b = np.array([-r.T @ t for r, t, _ in true])
    s, r, t = similarity(a, b)
    off = np.linalg.norm(s * a @ r.T + t - b, axis=1)
    spread = np.sqrt(((b - b.mean(0)) ** 2).sum(1).mean())
    focal = np.median([f[2] / t[2] for f, t in pairs])
    print(f"{label}: {len(pairs)} of {wanted} cameras, rotation median {np.median(angles):.3f} "
          f"largest {np.max(angles):.3f} degrees, centre median {np.median(off) / spread:.4f} "
          f"largest {np.max(off) / spread:.4f} of the spread ({spread:.4g}), "
          f"focal {focal:.4f} of the true one")


def colmap(args, work, names):
    images, database = os.path.join(work, "images"), os.path.join(work, "database.db")
    sparse = os.path.join(work, "sparse")
    os.makedirs(images)
    os.makedirs(sparse)
    for name in names:
        shutil.copy(os.path.join(args.images, name), images)
    env = dict(os.environ, QT_QPA_PLATFORM="offscreen")
    threads = str(args.threads)

    def call(*words):
        subprocess.run(["colmap", *words], env=env, check=True, stdout=subprocess.DEVNULL,
                       stderr=subprocess.DEVNULL)

    camera = ["--ImageReader.single_camera", "1", "--ImageReader.camera_model", "SIMPLE_PINHOLE"]
    if args.focal:
        with open(os.path.join(images, names[0]), "rb") as f:
            w, h = struct.unpack(">II", f.read(24)[16:])  # of a PNG
        camera += ["--ImageReader.camera_params", f"{args.focal},{w / 2},{h / 2}"]
    call("feature_extractor", "--database_path", database, "--image_path", images, *camera,
         "--SiftExtraction.use_gpu", "0", "--SiftExtraction.num_threads", threads)
    call("exhaustive_matcher", "--database_path", database, "--SiftMatching.use_gpu", "0",
         "--SiftMatching.num_threads", threads)
    call("mapper", "--database_path", database, "--image_path", images, "--output_path", sparse,
         "--Mapper.num_threads", threads)
    best = {}
    for model in sorted(os.listdir(sparse)):
        folder = os.path.join(sparse, model)
        call("model_converter", "--input_path", folder, "--output_path", folder, "--output_type",
             "TXT")
        now = read_model(folder)
        best = now if len(now) > len(best) else best
    return best


def main():
    p = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    p.add_argument("--truth", required=True)
    p.add_argument("--images")
    p.add_argument("--names")
    p.add_argument("--protocol")
    p.add_argument("--views", default="18")
    p.add_argument("--work")
    p.add_argument("--threads", type=int, default=2)
    p.add_argument("--focal", type=float)
    p.add_argument("--cameras")
    args = p.parse_args()
    truth = read_model(args.truth)
    if args.cameras:
        model = read_cameras(args.cameras)
        compare(args.cameras, model, truth, len(model))
    if not args.images:
        return
    if args.protocol:
        with open(args.protocol) as f:
            names = json.load(f)["inputs"][args.views]
    else:
        names = args.names.split(",") if args.names else sorted(os.listdir(args.images))
    begin = time.time()
    if args.work:
        model = colmap(args, args.work, names)
    else:
        with tempfile.TemporaryDirectory() as work:
            model = colmap(args, work, names)
    compare(f"colmap, {time.time() - begin:.1f} s", model, truth, len(names))


if __name__ == "__main__":
    main()
