#!/usr/bin/env python3
"""Quality against seconds: one table (stdout, markdown) and one plot (--plot FILE.svg).

    tests/peers/trade.py --data DIR... --views 4,8,18 --size 224,448 --refine 0,100,300,1000 \
        [--model own,none,FILE,...] [--rig none] [--plot trade.svg]

own: what hdrig does by itself, the model that comes with it finding cameras; none: without it.
Runs `hdrig eval` once for every combination and data set; a figure is the mean over the sets."""

import argparse
import itertools
import json
import math
import subprocess
import sys

COLOURS = ["#1b6ca8", "#d1495b", "#2a9d5c", "#8e5aa8", "#c77f1a", "#4d4d4d"]


def evaluate(q, data, views, size, refine, model):
    """Figures of one reconstruction; None and a line on stderr if it was refused."""
    command = [q.hdrig, "eval", "--data", data, "--views", views, "--size", size]
    command += ["--refine", refine, "--json", "-"]
    if model != "own":
        command += ["--model", model]
    if q.rig:
        command += ["--rig", q.rig]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        print(f"{' '.join(command)}: {done.stderr.strip().splitlines()[-1:]}", file=sys.stderr)
        return None
    j = json.loads(done.stdout)
    return {
        "ldr": j["ldr"]["psnr"],
        "ssim": j["ldr"]["ssim"],
        "hdr": j["hdr"]["psnr"] if j["hdr"] else math.nan,
        "nearest": j["baseline_nearest"]["psnr"],
        "rotation": j["pose"]["rot_deg_median"] if j.get("pose") else math.nan,
        "seconds": j["seconds"]["total"] - j["seconds"].get("measure", 0)
        - j["seconds"].get("render", 0),
        "mb": j["peak_rss_mb"],
        "splats": j["gaussians"],
        "start": model if model in ("own", "none") else j["precision"],
    }


def mean(rows, key):
    return sum(r[key] for r in rows) / len(rows)


def plot(rows, path):
    """PSNR over log seconds, a line for each (views, size, model) through its numbers of steps."""
    w, h, left, bottom = 720, 440, 60, 50
    xs = [math.log10(r["seconds"]) for r in rows]
    ys = [r["ldr"] for r in rows]
    x0, x1 = math.floor(min(xs)), math.ceil(max(xs) + 1e-9)
    y0, y1 = math.floor(min(ys)) - 1, math.ceil(max(ys)) + 1

    def at(r):
        x = left + (math.log10(r["seconds"]) - x0) / (x1 - x0) * (w - left - 170)
        return x, h - bottom - (r["ldr"] - y0) / (y1 - y0) * (h - bottom - 20)

    out = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{w}" height="{h}"',
           'font-family="sans-serif" font-size="12">',
           f'<rect width="{w}" height="{h}" fill="white"/>']
    for y in range(y0, y1 + 1, 2):
        py = at({"seconds": 10**x0, "ldr": y})[1]
        out.append(f'<path d="M{left} {py:.1f}H{w - 170}" stroke="#ddd"/>'
                   f'<text x="{left - 8}" y="{py + 4:.1f}" text-anchor="end">{y}</text>')
    for x in range(x0, x1 + 1):
        px = at({"seconds": 10**x, "ldr": y0})[0]
        out.append(f'<path d="M{px:.1f} 20V{h - bottom}" stroke="#ddd"/>'
                   f'<text x="{px:.1f}" y="{h - bottom + 16}" text-anchor="middle">{10**x:g}'
                   "</text>")
    out.append(f'<text x="{left}" y="{h - 12}">seconds of reconstruction</text>'
               f'<text x="{left}" y="14">LDR PSNR, dB</text>')
    lines = {}
    for r in rows:
        lines.setdefault((r["views"], r["size"], r["start"]), []).append(r)
    for i, (key, line) in enumerate(lines.items()):
        colour = COLOURS[i % len(COLOURS)]
        points = [at(r) for r in sorted(line, key=lambda r: r["seconds"])]
        out.append(f'<path d="M{" L".join(f"{x:.1f} {y:.1f}" for x, y in points)}" fill="none" '
                   f'stroke="{colour}" stroke-width="2"/>')
        out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{colour}"/>' for x, y in points]
        name = f"{key[0]} views, {key[1]} px" + (f", {key[2]}" if key[2] != "own" else "")
        out.append(f'<text x="{w - 160}" y="{30 + 18 * i}" fill="{colour}">{name}</text>')
    with open(path, "w", encoding="ascii") as f:
        f.write("\n".join(out) + "\n</svg>\n")


def main():
    p = argparse.ArgumentParser(description=__doc__,
                                formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--data", nargs="+", required=True)
    p.add_argument("--views", default="4,8,18")
    p.add_argument("--size", default="448")
    p.add_argument("--refine", default="0,100,300,1000")
    p.add_argument("--model", default="own")
    p.add_argument("--rig")
    p.add_argument("--plot")
    p.add_argument("--hdrig", default="build/hdrig")
    q = p.parse_args()
    rows = []
    print("| start | px | views | steps | seconds | MB | splats | LDR dB | SSIM | HDR dB | "
          "over nearest | rotation deg |\n|---|---|---|---|---|---|---|---|---|---|---|---|")
    for model, size, views, refine in itertools.product(
            q.model.split(","), q.size.split(","), q.views.split(","), q.refine.split(",")):
        found = [evaluate(q, d, views, size, refine, model) for d in q.data]
        found = [f for f in found if f]
        if not found:
            continue
        r = {k: mean(found, k) for k in found[0] if k != "start"}
        r |= {"start": found[0]["start"], "size": size, "views": views}
        rows.append(r)
        print(f"| {r['start']} | {size} | {views} | {refine} | {r['seconds']:.1f} | "
              f"{r['mb']:.0f} | "
              f"{r['splats']:.0f} | {r['ldr']:.2f} | {r['ssim']:.3f} | {r['hdr']:.2f} | "
              f"{r['ldr'] - r['nearest']:+.1f} | {r['rotation']:.3f} |", flush=True)
    if q.plot and rows:
        plot(rows, q.plot)


if __name__ == "__main__":
    main()
