#!/usr/bin/env python3
"""Our int8 products and oneDNN's, as PyTorch calls them, in one process and in random order, one
thread, processor time; and whether oneDNN's are exact. What runs after oneDNN finds its weights
gone from the caches, so a fixed order favours somebody by up to 6 %. What the calls
from Python cost is timed without rows and subtracted.

make PIC=1 build/x86_64-pic/core/kernels/gemm_avx512.o
cc -shared -o gemm.so build/x86_64-pic/core/kernels/gemm_avx512.o
usage: ONEDNN_MAX_CPU_ISA=AVX512_CORE onednn_turns.py ./gemm.so [SECONDS]
"""
import ctypes
import random
import statistics
import sys
import time
import warnings

import torch

SHAPES = (("qkv", 64, 1024, 3072), ("proj", 64, 1024, 1024), ("fc1", 64, 1024, 4096),
          ("fc2", 64, 4096, 1024), ("project", 64, 2048, 1024), ("4 rows", 4, 2048, 2048),
          ("small qkv", 64, 192, 576), ("small proj", 64, 192, 192), ("small fc1", 64, 192, 768),
          ("small fc2", 64, 768, 192))
PANEL = 16


class Product(ctypes.Structure):
    """struct gemm_s8"""
    _fields_ = [("m", ctypes.c_int), ("panels", ctypes.c_int), ("segs", ctypes.c_int),
                ("seg", ctypes.c_int), ("a", ctypes.c_void_p), ("lda", ctypes.c_size_t),
                ("seg_stride", ctypes.c_size_t), ("w", ctypes.c_void_p), ("ldw", ctypes.c_size_t),
                ("c", ctypes.c_void_p), ("ldc", ctypes.c_size_t)]


def load(path):
    table = (ctypes.c_void_p * 64)()  # struct gemm_kernels: s8 is third
    ctypes.CDLL(path).gemm_avx512(table)
    return ctypes.CFUNCTYPE(None, ctypes.POINTER(Product))(table[2])


def ours(s8, a, w, c, m=None):
    """Panels in groups, as core/net/layer.c takes them; c holds those of one group."""
    k, m = a.shape[1], len(a) if m is None else m
    n = w.numel() // k
    group = c.shape[1] // PANEL
    calls = [Product(m, min(group, n // PANEL - p), 1, k, a.data_ptr(), k, 0,
                     w.data_ptr() + p * k * PANEL, k * PANEL, c.data_ptr(), c.shape[1])
             for p in range(0, n // PANEL, group)]
    return lambda: [s8(ctypes.byref(x)) for x in calls]


def pack(w):
    n, k = w.shape
    return w.view(n // PANEL, PANEL, k // 4, 4).permute(0, 2, 1, 3).contiguous()


def exact(s8):
    torch.manual_seed(1)
    for name, draw in (("all 127", lambda *s: torch.full(s, 127, dtype=torch.int8)),
                       ("random", lambda *s: torch.randint(-127, 128, s, dtype=torch.int8))):
        a, w = draw(64, 1024), draw(64, 1024)
        right = a.long() @ w.long().t()
        c, packed = torch.zeros(64, 64, dtype=torch.int32), pack(w)
        ours(s8, a, packed, c)()
        for who, got in (("ours", c.long()), ("oneDNN", torch._int_mm(a, w.t()).long())):
            error = (got - right).abs()
            print(f"{name}: {who} wrong in {(error > 0).sum()} of {error.numel()} sums, by up to "
                  f"{error.max()}; first {got[0, 0]}, right {right[0, 0]}")


def turns(s8, m, k, n, seconds):
    a = torch.randint(-127, 128, (m, k), dtype=torch.int8)
    w = pack(torch.randint(-128, 128, (n, k), dtype=torch.int8))
    c = torch.zeros(m, PANEL * (4 if k <= 2048 else 2), dtype=torch.int32)
    x = torch.randn(m, k)
    q = torch.quantize_per_channel(torch.randn(n, k), torch.full((n,), 0.01, dtype=torch.double),
                                   torch.zeros(n, dtype=torch.long), 0, torch.qint8)
    theirs = torch.ops.quantized.linear_prepack(q, None)
    x8 = torch.quantize_per_tensor(x, 0.05, 128, torch.quint8)
    run = [ours(s8, a, w, c),
           lambda: torch.ops.quantized.linear_dynamic(x, theirs, reduce_range=False),
           lambda: torch.ops.quantized.linear(x8, theirs, 0.1, 128),
           ours(s8, a, w, c, 0)]  # no rows: what the calls from Python cost
    took, end = [[] for _ in run], time.monotonic() + seconds
    for f in run:
        f()
    while time.monotonic() < end:
        for i in random.sample(range(len(run)), len(run)):
            start = time.thread_time()
            run[i]()
            took[i].append(time.thread_time() - start)
    calls = statistics.median(took.pop())
    took[0] = [t - calls for t in took[0]]
    return took


def main():
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    torch.backends.quantized.engine = "onednn"
    s8 = load(sys.argv[1])
    exact(s8)
    print("m k n: GMAC/s of ours, oneDNN dynamic, static (medians); ours in ratio to these: median "
          "(quartiles)")
    for name, m, k, n in SHAPES:
        with torch.inference_mode():
            took = turns(s8, m, k, n, float(sys.argv[2]) if len(sys.argv) > 2 else 5)
        print(f"{name:10s} {m} {k} {n}", *(f"{m * k * n / statistics.median(t) * 1e-9:5.0f}"
                                           for t in took), end="")
        for other in took[1:]:
            low, mid, high = statistics.quantiles([y / x for x, y in zip(took[0], other)], n=4)
            print(f"  {mid:.2f} ({low:.2f}-{high:.2f})", end="")
        print(f"  {len(took[0])} turns", flush=True)


if __name__ == "__main__":
    main()
