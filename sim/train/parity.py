"""model.py against the C network, with weights that model.py makes.

    python3 sim/train/parity.py [CKPT] [--images DIR] [--size N] [--hdrig build/hdrig]

Exports the weights (CKPT, or random ones with every bias disturbed), converts them, reconstructs
the pictures with --refine 0 --dump and compares poses, depth, raw Gaussians, curves and the fused
Gaussians that redraw.py makes of them. The completion branch, which the C network does not show, is
compared with itself as it learns, with norms. The bar is 1e-4 of the largest value."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile

import numpy as np
import torch

import complete
import export
import model
import redraw

BAR = 1e-4


def disturb(net: torch.nn.Module) -> None:
    g = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for p in net.parameters():
            p.add_(0.02 * torch.randn(p.shape, generator=g))


def main() -> int:
    a = argparse.ArgumentParser()
    a.add_argument("ckpt", nargs="?")
    a.add_argument("--images", default="tests/data/room")
    a.add_argument("--size", type=int, default=168)
    a.add_argument("--hdrig", default="build/hdrig")
    q = a.parse_args()
    torch.manual_seed(1)
    net = export.load(q.ckpt) if q.ckpt else model.make(model.Dims())
    net.d.rope_bf16 = True  # as hdrig convert sets it for every file
    if not q.ckpt:
        disturb(net)
    with tempfile.TemporaryDirectory() as d:
        dump = reconstruct(net, q, d)
        return compare(net, dump) or compare_folded()


def reconstruct(net: model.Net, q: argparse.Namespace, d: str) -> dict:
    export.export(net, f"{d}/w.safetensors")
    run = lambda *x: subprocess.run([q.hdrig, *x], check=True, stdout=subprocess.DEVNULL,
                                    stderr=subprocess.DEVNULL)
    run("convert", f"{d}/w.safetensors", "--config", f"{d}/w.json", "--precision", "fp32",
        "--out", f"{d}/m.hdrig")
    images = f"{d}/in/images"
    os.makedirs(images)
    times = json.load(open(f"{q.images}/exposure.json"))
    names = sorted(n for n in times if n.startswith("train"))[:3]
    for n in names:
        os.symlink(os.path.abspath(f"{q.images}/images/{n}"), f"{images}/{n}")
    json.dump({n: times[n] for n in names}, open(f"{d}/in/exposure.json", "w"))
    run("reconstruct", "--images", f"{d}/in", "--model", f"{d}/m.hdrig", "--refine", "0",
        "--size", str(q.size), "--dump", f"{d}/dump", "--out", f"{d}/scene", "--precision", "fp32")
    files = {n[:-4]: f"{d}/dump/{n}" for n in os.listdir(f"{d}/dump") if n.endswith(".npy")}
    return {n: np.load(p) for n, p in files.items()}


def fused(dump: dict, cell: float) -> dict:
    """From the raw Gaussians and points of the dump, so that all cells are the same."""
    raw, xyz = torch.from_numpy(dump["gs.raw88"]), torch.from_numpy(dump["points.world"][0])
    planes = redraw.fuse(raw.transpose(0, 1).flatten(1), xyz.flatten(0, 2), cell)
    q = torch.nn.functional.normalize(planes[6:10], dim=0)
    dump["vox.harmonics"] = dump["vox.harmonics"][..., 0]
    pose, depth = dump["camera.pose_enc_iter3"][0].copy(), dump["depth.depth"][0, ..., 0]
    # core/net/README.md 2.4
    pose[:, 7:] = 2 * np.arctan(np.tan(np.maximum(pose[:, 7:], 0) / 2) + 1e-3)
    return {"points.world": redraw.points(torch.from_numpy(depth), torch.from_numpy(pose), 0),
            "vox.means": planes[:3].T, "vox.scales": planes[3:6].exp().T,
            "vox.rotations": q[[1, 2, 3, 0]].T, "vox.opacities": planes[10].sigmoid(),
            "vox.harmonics": planes[11:].T}


def compare(net: model.Net, dump: dict) -> bool:
    images = torch.from_numpy(dump["input.image"])
    stops = torch.from_numpy(dump["hdr.rel_logt"])
    with torch.no_grad():
        o = net.eval()(images, stops)
    got = {f"camera.pose_enc_iter{i}": p for i, p in enumerate(o["pose"][:-1])}
    got["fusion.q"], got["fusion.k"] = (t[0] for t in o["qk"])
    got["depth.depth"] = o["log_depth"].exp()
    got["gs.raw88"] = o["raw"]
    got["tone.params"] = o["theta"]
    for k, i in enumerate(net.d.keep):
        got[f"agg.keep{i}"] = o["keep"][k]
    got["camera.pose_enc_iter3"] = o["pose"][-1]
    got.update(fused(dump, net.d.voxel))
    bad = False
    for name, t in got.items():
        want, have = dump[name].ravel(), t.numpy().ravel()
        if name.startswith("camera.pose"):  # the dump is before ReLU
            want, have = (x.reshape(-1, 9).copy() for x in (want, have))
            want[:, 7:], have[:, 7:] = np.maximum(want[:, 7:], 0), np.maximum(have[:, 7:], 0)
            want, have = want.ravel(), have.ravel()
        bad |= differs(name, want, have)
    return bad


def differs(name: str, want: np.ndarray, have: np.ndarray) -> bool:
    err = np.abs(want - have).max() / np.abs(want).max() if want.size == have.size else np.inf
    print(f"{name:24s} {want.size:9d} {err:.2e}{'' if err <= BAR else '  <-- differs'}")
    return not err <= BAR


@torch.no_grad()
def compare_folded() -> bool:
    with_norms, without = complete.Complete(norm=True), complete.Complete()
    for _ in range(100):  # norms learn the mean and the variance
        with_norms(3 * torch.rand(2, complete.INPUTS, 40, 24))
    disturb(with_norms.eval())
    without.load_state_dict(with_norms.folded())
    x = torch.rand(1, complete.INPUTS, 37, 50)
    return differs("complete", with_norms(x).numpy().ravel(), without(x).numpy().ravel())


if __name__ == "__main__":
    sys.exit(main())
