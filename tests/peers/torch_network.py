#!/usr/bin/env python3
"""Seconds that PyTorch on the CPU needs for the matrix products of the released network.

Every product of the graph (core/net/README.md 3.4) is run once at its size, in the shapes that
PyTorch likes best (contiguous, channels-last convolutions, fused attention), and counted as often
as the graph has it; what lies between the products is left out, so that the sum is a lower bound
for PyTorch. Compare with `hdrig bench --what network` of the same views, size and threads.

usage: torch_network.py [--views 4] [--size 448] [--threads 2] [--dtype fp32,bf16] [--repeats 2]
"""
import argparse
import json
import time

import torch
import torch.nn.functional as F

EMBED, HEADS, HDR, FEAT = 1024, 16, 128, 256
OUT_CHANNELS = (256, 512, 1024, 1024)


def products(views, size):
    """(name, kind, shape, count, GMAC of one)"""
    grid = size // 14
    patches, tokens = grid * grid, grid * grid + 5
    rows = views * tokens
    out = []

    def linear(name, m, k, n, count):
        out.append((name, "linear", (m, k, n), count, m * k * n * 1e-9))

    def attention(name, batch, n, count):
        out.append((name, "attention", (batch, n), count, batch * 2 * n * n * EMBED * 1e-9))

    def conv(name, c, n, k, stride, side, count):
        cost = (side // stride) ** 2 * c * n * k * k * 1e-9
        out.append((name, "conv", (c, n, k, stride, side), count, cost))

    for name, n, k in (("qkv", 3 * EMBED, EMBED), ("proj", EMBED, EMBED), ("fc1", 4 * EMBED, EMBED),
                       ("fc2", EMBED, 4 * EMBED)):
        linear("blocks." + name, rows, k, n, 72)
    attention("dino and frame attention", views, tokens, 48)
    attention("global attention", 1, rows, 24)
    linear("camera trunk", views, 2 * EMBED, 24 * EMBED, 4 * 4)  # 12 (2C)^2 a block
    for i, n in enumerate(OUT_CHANNELS):
        linear(f"dpt.project{i}", patches, 2 * EMBED, n, 2 * views)
    linear("dpt.resize0", patches, 256, 256 * 16, 2 * views)
    linear("dpt.resize1", patches, 512, 512 * 4, 2 * views)
    conv("dpt.resize3", 1024, 1024, 3, 2, grid, 2 * views)
    for c, side in ((256, 4 * grid), (512, 2 * grid), (1024, grid), (1024, grid // 2)):
        conv("dpt.rn", c, FEAT, 3, 1, side, 2 * views)
    for side, units in ((grid // 2, 2), (grid, 4), (2 * grid, 4), (4 * grid, 4)):
        conv("dpt.refinenet", FEAT, FEAT, 3, 1, side, units * 2 * views)
        linear("dpt.out_conv", 4 * side * side, FEAT, FEAT, 2 * views)
    conv("dpt.output_conv1", FEAT, HDR, 3, 1, 8 * grid, 2 * views)
    conv("depth tail", HDR, 32, 3, 1, size, views)
    conv("guide", 3, HDR, 7, 1, size, views)
    conv("7x7 guided upsampling", HDR, HDR, 7, 1, size, 2 * views)
    conv("hdr_conv 3x3", HDR, HDR, 3, 1, size, views)
    linear("hdr_conv 1x1", size * size, HDR, 84, views)
    linear("hypernetwork", patches, 344 * 196, HDR, views)
    # fusion attention of the reference: logits of 16 heads, values twice
    linear("fusion logits", views * patches, 64, rows, 16)
    linear("fusion values", views * patches, views * patches, 2 * HDR, 1)
    return out


def runner(kind, shape, dtype):
    if kind == "linear":
        m, k, n = shape
        x, w, b = torch.randn(m, k, dtype=dtype), torch.randn(n, k, dtype=dtype), torch.randn(
            n, dtype=dtype)
        return lambda: F.linear(x, w, b)
    if kind == "attention":
        batch, n = shape
        q, k, v = (torch.randn(batch, HEADS, n, 64, dtype=dtype) for _ in range(3))
        return lambda: F.scaled_dot_product_attention(q, k, v)
    c, n, size, stride, side = shape
    x = torch.randn(1, c, side, side, dtype=dtype).to(memory_format=torch.channels_last)
    w = torch.randn(n, c, size, size, dtype=dtype).to(memory_format=torch.channels_last)
    return lambda: F.conv2d(x, w, stride=stride, padding=size // 2)


def measure(run, repeats):
    run()
    best = 1e9
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - start)
    return best


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    p.add_argument("--views", type=int, default=4)
    p.add_argument("--size", type=int, default=448)
    p.add_argument("--threads", type=int, default=2)
    p.add_argument("--dtype", default="fp32,bf16")
    p.add_argument("--repeats", type=int, default=2)
    a = p.parse_args()
    torch.set_num_threads(a.threads)
    result = {"torch": torch.__version__, "views": a.views, "size": a.size, "threads": a.threads}
    with torch.inference_mode():
        for name in a.dtype.split(","):
            dtype = {"fp32": torch.float32, "bf16": torch.bfloat16}[name]
            total = gmac = 0.0
            for what, kind, shape, count, cost in products(a.views, a.size):
                seconds = measure(runner(kind, shape, dtype), a.repeats)
                total += seconds * count
                gmac += cost * count
                print(f"{name} {what:28s} {count:4d} x {seconds * 1e3:9.2f} ms "
                      f"{cost / seconds:8.1f} GMAC/s", flush=True)
            print(f"{name} total {total:.1f} s, {gmac:.0f} GMAC, {gmac / total:.1f} GMAC/s")
            result[name] = {"seconds": total, "gmac": gmac}
    print(json.dumps(result))


if __name__ == "__main__":
    main()
