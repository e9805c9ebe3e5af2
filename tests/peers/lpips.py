#!/usr/bin/env python3
"""LPIPS in PyTorch, with hashed weights (core/net/hashed.h): the numbers of the tests, and files of
weights as torchvision and the package lpips publish them. Needs PyTorch and NumPy.
    lpips.py numbers         what tests/unit/core/net/lpips_test.c compares with, in float64
    lpips.py files DIR       vgg16.pth, vgg.pth, alexnet.pth and alex.pth, in the older container
    lpips.py pair NET A B    the distance of two pictures (OpenCV reads them), as it is and centred
"""

import collections
import os
import sys

import numpy as np
import torch
from torch import nn

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(HERE, "../data/ckpt"))
from make import hashed  # noqa: E402

WIDTHS = {"vgg16": [64, 128, 256, 512, 512], "alexnet": [64, 192, 384, 256, 256]}
LINEAR = {"vgg16": "vgg.pth", "alexnet": "alex.pth"}


def layers(net):
    """(layers in torchvision's order, those whose outputs are compared)"""
    if net == "alexnet":
        return [nn.Conv2d(3, 64, 11, 4, 2), nn.ReLU(), nn.MaxPool2d(3, 2),
                nn.Conv2d(64, 192, 5, 1, 2), nn.ReLU(), nn.MaxPool2d(3, 2),
                nn.Conv2d(192, 384, 3, 1, 1), nn.ReLU(), nn.Conv2d(384, 256, 3, 1, 1), nn.ReLU(),
                nn.Conv2d(256, 256, 3, 1, 1), nn.ReLU()], [1, 4, 7, 9, 11]
    out, taps, before = [], [], 3
    for stage, n in enumerate((2, 2, 3, 3, 3)):
        out += [nn.MaxPool2d(2, 2)] if stage else []
        for _ in range(n):
            out += [nn.Conv2d(before, WIDTHS[net][stage], 3, 1, 1), nn.ReLU()]
            before = WIDTHS[net][stage]
        taps.append(len(out) - 1)
    return out, taps


def state(net):
    """torchvision's state dict, without its classifier, and that of the linear layers."""
    features = nn.Sequential(*layers(net)[0])
    backbone = collections.OrderedDict(
        ("features." + k, torch.from_numpy(hashed("features." + k, tuple(v.shape))))
        for k, v in features.state_dict().items())
    names = [f"lin{i}.model.1.weight" for i in range(5)]
    return backbone, collections.OrderedDict(
        (k, torch.from_numpy(hashed(k, (1, w, 1, 1)))) for k, w in zip(names, WIDTHS[net]))


def distance(net, a, b, centred, dtype=torch.float64):
    """Of two pictures (3, h, w) with values in [0, 1]."""
    backbone, linear = state(net)
    modules, taps = layers(net)
    features = nn.Sequential(*modules).to(dtype)
    features.load_state_dict({k[9:]: v.to(dtype) for k, v in backbone.items()})
    shift = torch.tensor([-.030, -.088, -.188], dtype=dtype)[None, :, None, None]
    scale = torch.tensor([.458, .448, .450], dtype=dtype)[None, :, None, None]
    maps = []
    for x in (a, b):
        x = torch.as_tensor(x).to(dtype)[None]
        x = ((2 * x - 1 if centred else x) - shift) / scale
        maps.append([])
        for i, layer in enumerate(features):
            x = layer(x)
            if i in taps:
                maps[-1].append(x / (x.pow(2).sum(1, keepdim=True).sqrt() + 1e-10))
    with torch.no_grad():
        return sum(float((w.to(dtype) * (p - q) ** 2).sum(1).mean())
                   for p, q, w in zip(*maps, linear.values()))


def pictures(w, h):
    """The two pictures of the unit test."""
    c, y, x = np.mgrid[0:3, 0:h, 0:w]
    a = (7 * x + 13 * y + 29 * c + 5 * (x * y % 17)) % 64
    b = (5 * x + 11 * y + 31 * c + 7 * (x * y % 13)) % 64
    a = a.astype(np.float32) / np.float32(64)
    return a, (a + b.astype(np.float32) / np.float32(64)) / np.float32(2)


def main():
    if sys.argv[1:] == ["numbers"]:
        for net, w, h in (("vgg16", 16, 16), ("vgg16", 53, 38), ("vgg16", 16, 2081),
                          ("alexnet", 31, 31), ("alexnet", 90, 61)):
            values = [distance(net, *pictures(w, h), c) for c in (False, True)]
            print(f"{net} {w} x {h}: {values[0]:.10f} {values[1]:.10f}")
    elif sys.argv[1] == "files":
        for net in WIDTHS:
            backbone, linear = state(net)
            backbone["classifier.6.bias"] = torch.zeros(4)
            for name, what in ((net + ".pth", backbone), (LINEAR[net], linear)):
                torch.save(what, os.path.join(sys.argv[2], name),
                           _use_new_zipfile_serialization=False)
    else:
        import cv2
        a, b = (np.transpose(cv2.imread(p)[:, :, ::-1].astype(np.float32) / 255, (2, 0, 1))
                for p in sys.argv[3:5])
        print(*(distance(sys.argv[2], a, b, c) for c in (False, True)))


if __name__ == "__main__":
    torch.set_grad_enabled(False)
    main()
