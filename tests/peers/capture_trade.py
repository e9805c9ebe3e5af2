#!/usr/bin/env python3
"""What the number of exposures costs and brings: the metered set of `hdrig capture` against fixed
ones, on simulated worlds, from the simulated camera to the scene. One table (stdout, markdown).

    tests/peers/capture_trade.py --work DIR [--worlds room:1,room:2,dark:3] [--steps 300]

Every place of the rig takes each set by itself, in real time, 30 frames a second. `hdrig simulate`
photographs the same world from the same places and from those between, which are held out; its unit
of exposure is found by comparing pictures. Cameras are the true ones, so that only the exposures
differ. Fixed sets lie around the middle exposure of the world, 18 % grey, 2 stops apart; of the
staggered one each place has one exposure, in turn.

A pixel is clipped if it is in all pictures of its place, and dark if its weakest channel, merged,
is below 20 dB, by the noise of the simulated sensor; SNR is the median of these channels. Needs
numpy and Pillow."""

import argparse
import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from PIL import Image

VIEWS = 9
FULL_S = 0.01  # radiance 1 saturates the well then, as in `hdrig simulate`
ELECTRONS, READ_NOISE = 9597.5, 2.5  # at full scale, as sim/sensor/sensor.c has it
CODE_LO, CODE_HI = 8, 245  # usable display values
SETS = {
    "metered": None,
    "1 fixed": (0,),
    "3 fixed": (-2, 0, 2),
    "5 fixed": (-4, -2, 0, 2, 4),
    "9 fixed": (-8, -6, -4, -2, 0, 2, 4, 6, 8),
}


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))}: {done.stderr.strip().splitlines()[-1:]}")
    return done.stdout


def linear(path):
    """Display values, and relative exposure by the sRGB curve: (h, w, 3)."""
    code = np.asarray(Image.open(path).convert("RGB"))
    x = code / 255.0
    return code, np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def shoot(q, world, view, stops, middle, out):
    kind, seed = world.split(":")
    uri = (f"sim:kind={kind},seed={seed},size={q.size},samples=4,views={2 * VIEWS - 1},"
           f"view={2 * view},spread=0.3,full={FULL_S * 1e6:g}")
    order = ["--bracket", ",".join(map(str, stops)), "--middle", middle] if stops else []
    command = [q.hdrig, "capture", "--camera", f"{uri},truth={out}.truth", "--out", out, "--set",
               "store.merge=0", *order]
    for left in (2, 1, 0):  # a busy machine may be too late for a camera
        try:
            run(*command)
            break
        except SystemExit as e:
            if not left:
                raise
            print(f"once more: {e}", file=sys.stderr)
            os.rename(f"{out}.truth", f"{out}.failed{left}")
    with open(f"{out}/manifest.json") as f:
        m = json.load(f)
    ends = [int(f["start_ns"]) * 1e-9 + f["exposure_s"] for f in m["frames"]]
    return {
        "pictures": [(f"{out}/{f['picture']}", f["exposure_s"]) for f in m["frames"]],
        "frames": m["frames_used"],
        "seconds": max(ends) - int(m["trigger"]["monotonic_ns"]) * 1e-9,
        "unverified": sum(f["proof"].startswith("unverified") for f in m["frames"]),
    }


def coverage(pictures):
    """Shares of pixels clipped in all pictures, and dark in all together; their median SNR, dB."""
    clipped, snr2 = True, 0.0
    for path, _ in pictures:
        code, x = linear(path)
        clipped = clipped & (code.max(2) > CODE_HI)
        e = x * ELECTRONS
        usable = (code >= CODE_LO) & (code.max(2, keepdims=True) <= CODE_HI)
        snr2 = snr2 + np.where(usable, e * e / (e + READ_NOISE**2), 0)
    weakest = snr2.min(2)
    snr = 10 * np.log10(max(np.median(weakest[~clipped]), 1)) if not clipped.all() else np.nan
    return np.mean(clipped), np.mean(~clipped & (weakest < 10**2)), snr


def unit_of(pictures, truth):
    """Exposure of the camera, s, that is 1 in the data set; and how much places differ in it."""
    ratios = []
    for (path, t), (known, r) in ((a, b) for a in pictures for b in truth):
        (ca, a), (cb, b) = linear(path), linear(known)
        good = (ca > 60) & (ca < 220) & (cb > 60) & (cb < 220)
        if good.mean() > 0.1:
            ratios.append(np.log2(b[good] / a[good] * t / r))
    ratios = np.concatenate(ratios)
    return 2 ** np.median(ratios), np.subtract(*np.percentile(ratios, [75, 25]))


def cameras_of(data):
    """Lines of COLMAP's images.txt of the input views, by view, without the name."""
    with open(f"{data}/sparse/0/images.txt") as f:
        words = [line.split() for line in f if line.strip()]
    train = [w for w in words if w[9].startswith("train")]
    return {int(w[9].split("_")[2]): w[1:9] for w in train}


def reconstruct(q, data, takes, unit, out):
    """takes: pictures of each place. Figures of hdrig eval, and seconds of the reconstruction."""
    shutil.rmtree(out, ignore_errors=True)
    os.makedirs(f"{out}/images")
    os.makedirs(f"{out}/sparse/0")
    exposure, cameras = {}, cameras_of(data)
    with open(f"{out}/sparse/0/images.txt", "w") as f:
        for view, pictures in enumerate(takes):
            for k, (path, t) in enumerate(pictures):
                name = f"train_{view:02d}_{k:02d}.png"
                shutil.copy(path, f"{out}/images/{name}")
                exposure[name] = t / unit
                if k == 0:
                    f.write(f"{view + 1} {' '.join(cameras[view])} {name}\n\n")
    for name in ("cameras.txt", "points3D.txt"):
        shutil.copy(f"{data}/sparse/0/{name}", f"{out}/sparse/0")
    with open(f"{out}/exposure.json", "w") as f:
        json.dump(exposure, f)
    run(q.hdrig, "reconstruct", "--images", out, "--size", q.size, "--refine", q.steps,
        "--model", "none", "--out", f"{out}/scene")
    return json.loads(run(q.hdrig, "eval", "--data", data, "--scene", f"{out}/scene", "--json",
                          "-"))


def trial(q, world):
    """Rows of the table for one world."""
    kind, seed = world.split(":")
    base = f"{q.work}/{kind}{seed}"
    data, rows = f"{base}/data", {}
    try:
        os.makedirs(base)
    except FileExistsError:
        sys.exit(f"{base}: already exists: give another --work, or remove it")
    run(q.hdrig, "simulate", "--out", data, "--kind", kind, "--seed", seed, "--views", VIEWS,
        "--size", q.size, "--curve", "srgb", "--noise-free", "--exposures",
        "0.00390625,0.015625,0.0625,0.25,1,4,16")
    with open(f"{data}/exposure.json") as f:
        known = [(n, e) for n, e in json.load(f).items() if n.startswith("train_ldr_000_")]
    unit = None
    for name, stops in SETS.items():
        with ThreadPoolExecutor(2) as two:
            takes = list(two.map(
                lambda v: shoot(q, world, v, stops, unit, f"{base}/{name[0]}-{v}"), range(VIEWS)))
        pictures = [t["pictures"] for t in takes]
        if unit is None:
            truth = [(f"{data}/images/{n}", e) for n, e in known]
            unit, spread = unit_of(pictures[0], truth)
            if spread > 0.3:
                raise SystemExit(f"{world}: the camera stands elsewhere: {spread:.2f} stops")
        rows[name] = row(q, data, takes, pictures, unit, f"{base}/set")
        if name == "3 fixed":
            one = [[p[v % len(p)]] for v, p in enumerate(pictures)]
            rows["3 staggered"] = row(q, data, None, one, unit, f"{base}/set")
    return rows


def row(q, data, takes, pictures, unit, work):
    j = reconstruct(q, data, pictures, unit, work)
    cover = np.mean([coverage(p) for p in pictures], axis=0)
    figures = {"exposures": np.mean([len(p) for p in pictures])}
    for key in ("frames", "seconds", "unverified"):
        figures[key] = np.mean([t[key] for t in takes]) if takes else np.nan
    return figures | {"clipped": 100 * cover[0], "dark": 100 * cover[1],
                      "snr": cover[2], "ldr": j["ldr"]["psnr"], "ssim": j["ldr"]["ssim"],
                      "hdr": j["hdr"]["psnr"], "hdr_ssim": j["hdr"]["ssim"]}


def table(title, rows):
    print(f"\n{title}\n\n| set | exposures a place | frames | seconds | not proven | clipped % | "
          "dark % | SNR dB | LDR dB | SSIM | HDR dB | SSIM |\n"
          "|---|---|---|---|---|---|---|---|---|---|---|---|")
    for name, r in rows.items():
        print(f"| {name} | {r['exposures']:.1f} | {r['frames']:.0f} | {r['seconds']:.2f} | "
              f"{r['unverified']:.1f} | {r['clipped']:.2f} | {r['dark']:.2f} | {r['snr']:.1f} | "
              f"{r['ldr']:.2f} | "
              f"{r['ssim']:.3f} | {r['hdr']:.2f} | {r['hdr_ssim']:.3f} |", flush=True)


def main():
    p = argparse.ArgumentParser(description=__doc__,
                                formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--worlds", default="room:1,room:2,dark:3")
    p.add_argument("--work", required=True)
    p.add_argument("--size", default="224")
    p.add_argument("--steps", default="300")
    p.add_argument("--hdrig", default="build/x86_64/hdrig")
    q = p.parse_args()
    worlds = {}
    for world in q.worlds.split(","):
        worlds[world] = trial(q, world)
        table(world, worlds[world])
    mean = {n: {k: np.mean([w[n][k] for w in worlds.values()]) for k in r}
            for n, r in next(iter(worlds.values())).items()}
    table("mean", mean)


if __name__ == "__main__":
    main()
