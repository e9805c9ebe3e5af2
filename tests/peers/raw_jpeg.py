#!/usr/bin/env python3
"""Raw frames of 12 bits against JPEG of the same frames, markdown on stdout:

    tests/peers/raw_jpeg.py --hdrig build/x86_64/hdrig --work /tmp/raw [--seeds 71 --size 224]

Radiance of `hdrig simulate --depth` becomes Bayer frames with photon and read noise; these lie in a
take (raw/, manifest.json), and are developed in 8 bits, as JPEG of the best
quality without subsampling, for the other side.
Both are reconstructed with known cameras and measured by `hdrig eval --scene`; in shadows: PSNR of
radiance in the lowest quarter of each true view, whose upper end is the peak. Needs ffmpeg."""

import argparse
import glob
import json
import os
import re
import shutil
import struct
import subprocess
import zlib

import numpy as np

WELL, READ, BLACK, TOP = 10000, 2.5, 256, 4095
KEPT = {1: lambda view: [(2, 0, 3)[view % 3]], 2: lambda view: [0, 3], 3: lambda view: [0, 2, 3]}


def read_exr(path):
    """R, G, B of an EXR file of scan lines with ZIP compression"""
    with open(path, "rb") as f:
        data = f.read()
    at, head = 8, {}
    while data[at]:
        end = data.index(0, at)
        name, at = data[at:end].decode(), end + 1
        at = data.index(0, at) + 1
        n = struct.unpack_from("<i", data, at)[0]
        head[name], at = data[at + 4:at + 4 + n], at + 4 + n
    at += 1
    x0, y0, x1, y1 = struct.unpack("<4i", head["dataWindow"])
    w, h, row, where, c = x1 - x0 + 1, y1 - y0 + 1, 0, {}, head["channels"]
    while c[0]:
        end = c.index(0)
        kind = "<f2" if struct.unpack_from("<i", c, end + 1)[0] == 1 else "<f4"
        where[c[:end].decode()] = row, kind
        row += w * int(kind[2])
        c = c[end + 17:]
    out = np.empty((h, w, 3), np.float32)
    for block in struct.unpack_from(f"<{(h + 15) // 16}Q", data, at):
        y, n = struct.unpack_from("<2i", data, block)
        lines = min(16, h - (y - y0))
        raw = data[block + 8:block + 8 + n]
        if n < row * lines:
            b = np.frombuffer(zlib.decompress(raw), np.uint8).astype(np.int64)
            b[1:] -= 128
            b = np.cumsum(b).astype(np.uint8)
            half = (len(b) + 1) // 2
            both = np.empty_like(b)
            both[0::2], both[1::2] = b[:half], b[half:]
            raw = both.tobytes()
        for i in range(lines):
            for k, name in enumerate("RGB"):
                first, kind = where[name]
                out[y - y0 + i, :, k] = np.frombuffer(raw, kind, w, i * row + first)
    return out


def expose(light, rng):
    """Codes of a mosaic RGGB: light 1 fills the well."""
    h, w, _ = light.shape
    y, x = np.mgrid[:h, :w]
    site = np.take_along_axis(light, ((y & 1) + (x & 1))[..., None], 2)[..., 0]
    electrons = rng.poisson(np.minimum(site, 4) * WELL) + rng.normal(0, READ, (h, w))
    return np.clip(np.rint(electrons / WELL * (TOP - BLACK)) + BLACK, 0, TOP).astype("<u2")


def develop(code):
    """Malvar, He & Cutler 2004, then sRGB: as core/photo/develop.c"""
    v = np.pad(np.minimum((code.astype(float) - BLACK) / (TOP - BLACK), 1), 2, mode="reflect")
    h, w = code.shape

    def at(dy, dx):
        return v[2 + dy:2 + dy + h, 2 + dx:2 + dx + w]

    p, h1, v1 = at(0, 0), at(0, -1) + at(0, 1), at(-1, 0) + at(1, 0)
    h2, v2 = at(0, -2) + at(0, 2), at(-2, 0) + at(2, 0)
    d = at(-1, -1) + at(-1, 1) + at(1, -1) + at(1, 1)
    green = (4 * p + 2 * (h1 + v1) - h2 - v2) / 8
    across = (5 * p + 4 * h1 - d - h2 + v2 / 2) / 8
    down = (5 * p + 4 * v1 - d - v2 + h2 / 2) / 8
    corner = (6 * p + 2 * d - 1.5 * (h2 + v2)) / 8
    y, x = np.mgrid[:h, :w]
    red, blue, even = (y % 2 == 0) & (x % 2 == 0), (y % 2 == 1) & (x % 2 == 1), y % 2 == 0
    rgb = np.stack([np.where(red, p, np.where(blue, corner, np.where(even, across, down))),
                    np.where(red | blue, green, p),
                    np.where(blue, p, np.where(red, corner, np.where(even, down, across)))], -1)
    rgb = np.clip(rgb, 0, 1)
    rgb = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    return np.rint(255 * rgb).astype(np.uint8)


def write_jpeg(rgb, path):
    """8 bits through JPEG; the name stays PNG, by which the data set knows its cameras."""
    head = f"P6 {rgb.shape[1]} {rgb.shape[0]} 255\n".encode()
    to_jpeg = ["-f", "ppm_pipe", "-i", "-", "-pix_fmt", "yuvj444p", "-q:v", "2", "-f", "mjpeg", "-"]
    command = ["ffmpeg", "-loglevel", "error", "-y"]
    jpeg = subprocess.run(command + to_jpeg, check=True, input=head + rgb.tobytes(),
                          stdout=subprocess.PIPE).stdout
    subprocess.run(command + ["-f", "mjpeg", "-i", "-", "-pix_fmt", "rgb24", path], check=True,
                   input=jpeg)


def write_manifest(folder, frames, w, h):
    camera = {"pixels": "rggb16", "w": w, "h": h, "stride": 2 * w, "bits": 12, "black": BLACK}
    listed = [{"camera": 0, "raw": f"raw/{n[:-4]}.bin", "picture": f"images/{n}"} for n in frames]
    with open(f"{folder}/manifest.json", "w", encoding="ascii") as f:
        json.dump({"white_red": 1, "white_blue": 1, "cameras": [camera], "frames": listed}, f)


def make_take(base, folder, exposures, seed):
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(base, folder)
    os.mkdir(f"{folder}/raw")
    with open(f"{base}/exposure.json", encoding="ascii") as f:
        times = json.load(f)
    frames, rng = [], np.random.default_rng(seed)
    for name in sorted(n for n in times if n.startswith("train")):
        view, k = map(int, re.match(r"train_ldr_(\d+)_(\d+)", name).groups())
        os.remove(f"{folder}/images/{name}")
        if k not in KEPT[exposures](view):
            continue
        truth = read_exr(f"{base}/images_hdr/train_hdr_{view:03}.exr")
        code = expose(truth * times[name], rng)
        code.tofile(f"{folder}/raw/{name[:-4]}.bin")
        write_jpeg(develop(code), f"{folder}/images/{name}")
        frames.append(name)
    write_manifest(folder, frames, code.shape[1], code.shape[0])


def shadows(out, base):
    """PSNR of the lowest quarter; the scale of radiance is free."""
    got = [read_exr(p) for p in sorted(glob.glob(f"{out}/hdr/*.exr"))]
    true = [read_exr(p) for p in sorted(glob.glob(f"{base}/images_hdr/test_hdr_*.exr"))]
    assert got and len(got) == len(true)
    scale = np.median(np.concatenate([(t / np.maximum(g, 1e-9)).ravel()
                                      for g, t in zip(got, true)]))
    db = []
    for g, t in zip(got, true):
        end = np.quantile(t, 0.25)
        error = (np.minimum(scale * g, 4 * end) - t)[t <= end]
        db.append(10 * np.log10(end ** 2 / np.mean(error ** 2)))
    return np.mean(db)


def measure(q, folder, base, scene):
    def run(*words):
        return subprocess.run([q.hdrig, *words], check=True, stdout=subprocess.PIPE,
                              stderr=subprocess.DEVNULL, text=True).stdout
    size = ["--size", str(q.size), "--threads", "2"]
    run("reconstruct", "--images", folder, "--out", scene, "--refine", str(q.refine),
        "--rig", f"{base}/sparse/0", "--force", *size)
    out = scene + "-eval"
    j = json.loads(run("eval", "--scene", scene, "--data", folder, "--protocol", "native",
                       "--out", out, "--force", "--json", "-", *size))
    return j["hdr"]["psnr"], shadows(out, base)


def main():
    p = argparse.ArgumentParser()
    p.add_argument("--hdrig", default="build/x86_64/hdrig")
    p.add_argument("--work", required=True)
    p.add_argument("--seeds", default="71,72")
    p.add_argument("--exposures", default="1,2,3")
    p.add_argument("--size", type=int, default=224)
    p.add_argument("--views", type=int, default=6)
    p.add_argument("--refine", type=int, default=300)
    q = p.parse_args()
    os.makedirs(q.work, exist_ok=True)
    print("| exposures | JPEG: HDR PSNR | raw | JPEG: shadows | raw |\n|---|---|---|---|---|")
    for n in map(int, q.exposures.split(",")):
        rows = []
        for seed in q.seeds.split(","):
            base, folder = f"{q.work}/world{seed}", f"{q.work}/take{seed}-{n}"
            if not os.path.exists(base):
                subprocess.run([q.hdrig, "simulate", "--out", base, "--seed", seed, "--kind",
                                "room", "--views", str(q.views), "--size", str(q.size), "--depth",
                                "--curve", "srgb", "--exposures", "0.0625,0.25,1,4", "--samples",
                                "3"], check=True, stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL)
            make_take(base, folder, n, int(seed))
            raw = measure(q, folder, base, folder + "-raw-scene")
            os.remove(f"{folder}/manifest.json")
            rows.append([*measure(q, folder, base, folder + "-jpeg-scene"), *raw])
        jpeg, jpeg_dark, raw, raw_dark = np.mean(rows, 0)
        print(f"| {n} | {jpeg:.2f} | {raw:.2f} | {jpeg_dark:.2f} | {raw_dark:.2f} |", flush=True)


if __name__ == "__main__":
    main()
