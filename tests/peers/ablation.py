#!/usr/bin/env python3
"""The paper's ablation with any weights: what the forward pass loses without a part of the network.
A part is taken out by setting the tensors that bring it in to zero; nothing is trained again, so a
part that the rest has learned to lean on counts in full.

usage: ablation.py WEIGHTS.safetensors DIMS.json --data DIR... [--views N] [--size PX]
       [--set KEY=VALUE]... [--hdrig PATH]
DIMS.json is what `hdrig convert --config` takes. Cameras are those of the data sets. With `--set
cameras.polish=0` photographs do not correct what the network says.
"""
import argparse
import json
import os
import struct
import subprocess
import tempfile

PARTS = {
    "whole": [],
    "one tone curve for all scenes (no hypernetwork)": ["generate_tonemapper.out.2.weight"],
    "no exposure normalisation": ["hdr_head.regression.exp_film.2."],
    "no cross-view attention": ["hdr_head.regression.mean_out.3."],
    "no guided upsampling": ["hdr_head.hdr_upsample.proj_guide.0."],
}


def without(path: str, names: list, out: str) -> int:
    """Copy of a weights file with every tensor zero whose name holds one of names."""
    data = bytearray(open(path, "rb").read())
    head = 8 + struct.unpack("<Q", data[:8])[0]
    hit = 0
    for name, t in json.loads(data[8:head]).items():
        if any(n in name for n in names):
            a, b = (head + x for x in t["data_offsets"])
            data[a:b] = bytes(b - a)
            hit += 1
    with open(out, "wb") as f:
        f.write(data)
    return hit


def call(*command) -> None:
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}: {done.stderr.splitlines()[-1]}")


def measure(a, names: list, folder: str) -> list:
    weights, model, figures = (os.path.join(folder, n) for n in ("w.safetensors", "m", "f.json"))
    if without(a.weights, names, weights) < len(names):
        raise SystemExit(f"{a.weights}: a tensor of {names} is missing")
    call(a.hdrig, "convert", weights, "--config", a.dims, "--out", model)
    sums = []
    for data in a.data:
        call(a.hdrig, "eval", "--data", data, "--views", str(a.views), "--size", str(a.size),
             "--model", model, "--refine", "0", "--json", figures,
             *(word for setting in a.set for word in ("--set", setting)))
        j = json.load(open(figures))
        sums.append([j["ldr"]["psnr"], j["ldr"]["ssim"], j["hdr"]["psnr"]])
    return [sum(column) / len(sums) for column in zip(*sums)]


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("weights")
    p.add_argument("dims")
    p.add_argument("--data", nargs="+", action="extend", required=True)
    p.add_argument("--views", type=int, default=8)
    p.add_argument("--size", type=int, default=448)
    p.add_argument("--set", action="append", default=[])
    p.add_argument("--hdrig", default="build/hdrig")
    a = p.parse_args()
    print("| | LDR dB | LDR SSIM | HDR dB |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for part, names in PARTS.items():
            ldr, ssim, hdr = measure(a, names, folder)
            print(f"| {part} | {ldr:.2f} | {ssim:.3f} | {hdr:.2f} |", flush=True)


if __name__ == "__main__":
    main()
