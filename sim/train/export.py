"""Checkpoint of train.py to a weights file: python3 sim/train/export.py CKPT OUT.safetensors [bf16]
Writes OUT.json beside it; then: hdrig convert OUT.safetensors --config OUT.json --out M.hdrig"""

from __future__ import annotations

import json
import os
import struct
import sys

import numpy as np
import torch

import model


def write_tensors(path: str, tensors: dict[str, torch.Tensor], bf16: bool = False) -> None:
    """A .safetensors file: length of the header, header in JSON, the values."""
    header, blobs, at = {}, [], 0
    for name, t in tensors.items():
        a = t.detach().float().cpu().contiguous()
        a = a.bfloat16().view(torch.int16).numpy() if bf16 else a.numpy()
        header[name] = {"dtype": "BF16" if bf16 else "F32", "shape": list(a.shape),
                        "data_offsets": [at, at + a.nbytes]}
        blobs.append(a)
        at += a.nbytes
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    part = f"{path}.{os.getpid()}.part"
    with open(part, "xb") as f:  # never somebody else's
        f.write(struct.pack("<Q", len(text)))
        f.write(text)
        for a in blobs:
            f.write(a.tobytes())
    os.replace(part, path)


def read_tensors(path: str) -> dict[str, torch.Tensor]:
    """What write_tensors wrote, in floats."""
    raw = open(path, "rb").read()
    n = struct.unpack("<Q", raw[:8])[0]
    out = {}
    for name, t in json.loads(raw[8 : 8 + n]).items():
        first, last = (8 + n + x for x in t["data_offsets"])
        kind = torch.bfloat16 if t["dtype"] == "BF16" else torch.float32
        flat = torch.frombuffer(bytearray(raw[first:last]), dtype=kind)
        out[name] = flat.reshape(t["shape"]).float()
    return out


def export(net: model.Net, path: str, state: dict | None = None, bf16: bool = False) -> None:
    write_tensors(path, state or net.state_dict(), bf16)
    net.d.write(os.path.splitext(path)[0] + ".json")


def load(path: str) -> model.Net:
    c = torch.load(path, map_location="cpu", weights_only=False)
    net = model.Net(model.Dims(**c["dims"]))
    net.load_state_dict(c.get("average") or c["model"])
    return net


if __name__ == "__main__":
    export(load(sys.argv[1]), sys.argv[2], bf16="bf16" in sys.argv[3:])
