#!/usr/bin/env python3
"""int8 and float products of oneDNN and XNNPACK, as PyTorch calls them, on this model's shapes, one
thread, GMAC/s; compare with `gemm_test --bench` run just before or after. PyTorch's dynamic
products quantise the activations too, static ones return 8 bits; XNNPACK is behind "qnnpack".

usage: [ONEDNN_MAX_CPU_ISA=AVX2] torch_gemm.py
"""
import time

import torch

SHAPES = (("qkv", 64, 1024, 3072), ("proj", 64, 1024, 1024), ("fc1", 64, 1024, 4096),
          ("fc2", 64, 4096, 1024), ("project", 64, 2048, 1024), ("4 rows", 4, 2048, 2048))


def rate(run, mac):
    best, end = 1e9, time.perf_counter() + 0.5
    run()
    while time.perf_counter() < end:
        start = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - start)
    return mac / best * 1e-9


def quantised(engine, x, w, mac):
    torch.backends.quantized.engine = engine
    n = w.shape[0]
    if engine == "qnnpack":
        q = torch.quantize_per_tensor(w, 0.01, 0, torch.qint8)
    else:
        q = torch.quantize_per_channel(w, torch.full((n,), 0.01, dtype=torch.double),
                                       torch.zeros(n, dtype=torch.long), 0, torch.qint8)
    packed = torch.ops.quantized.linear_prepack(q, None)
    x8 = torch.quantize_per_tensor(x, 0.05, 128, torch.quint8)
    return (rate(lambda: torch.ops.quantized.linear_dynamic(x, packed, reduce_range=False), mac),
            rate(lambda: torch.ops.quantized.linear(x8, packed, 0.1, 128), mac))


def main():
    torch.set_num_threads(1)
    print("m k n: _int_mm, oneDNN dynamic and static, XNNPACK dynamic and static, f32, bf16")
    with torch.inference_mode():
        for name, m, k, n in SHAPES:
            mac = m * k * n
            a = torch.randint(-127, 128, (m, k), dtype=torch.int8)
            b = torch.randint(-127, 128, (n, k), dtype=torch.int8).t()
            x, w = torch.randn(m, k), torch.randn(n, k)
            xb, wb = x.bfloat16(), w.bfloat16()
            row = [rate(lambda: torch._int_mm(a, b), mac)] if m > 16 else [float("nan")]
            row += [*quantised("onednn", x, w, mac), *quantised("qnnpack", x, w, mac)]
            row += [rate(lambda: torch.nn.functional.linear(x, w), mac),
                    rate(lambda: torch.nn.functional.linear(xb, wb), mac)]
            print(f"{name:8s} {m} {k} {n}", *(f"{v:8.1f}" for v in row), flush=True)


if __name__ == "__main__":
    main()
