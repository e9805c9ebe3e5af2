"""A weights file from a checkpoint of train.py, or from such a file and a completion branch:
    python3 sim/train/export.py MODEL OUT.safetensors [--bf16] [--complete complete.safetensors]
Writes OUT.json beside it; then: hdrig convert OUT.safetensors --config OUT.json --out M.hdrig"""

from __future__ import annotations

import argparse
import json
import os
import struct

import numpy as np
import torch

import complete
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


def read_dims(path: str) -> dict:
    """Those of a model that export wrote."""
    with open(os.path.splitext(path)[0] + ".json") as f:
        return json.load(f)["model"]


def load(path: str) -> model.Net:
    """Of a checkpoint, or of a model that export wrote."""
    if path.endswith(".safetensors"):
        dims, state = read_dims(path), read_tensors(path)
    else:
        c = torch.load(path, map_location="cpu", weights_only=False)
        dims, state = c["dims"], c.get("average") or c["model"]
    net = model.Net(model.Dims(**dims))
    net.load_state_dict(state)
    return net


def join(net: model.Net, branch: dict[str, torch.Tensor]) -> None:
    """The completion branch that the stage `complete` wrote, instead of what is there."""
    net.d.complete = True
    net.encoder.complete = complete.Complete()
    net.encoder.complete.load_state_dict(branch)


if __name__ == "__main__":
    p = argparse.ArgumentParser()
    p.add_argument("model", help="checkpoint, or .safetensors with .json")
    p.add_argument("out", help=".safetensors")
    p.add_argument("--bf16", action="store_true")
    p.add_argument("--complete", help="complete.safetensors to put in")
    a = p.parse_args()
    net = load(a.model)
    if a.complete:
        join(net, read_tensors(a.complete))
    export(net, a.out, bf16=a.bf16)
