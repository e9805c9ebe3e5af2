#!/usr/bin/env python3
"""A checkpoint of hashed weights whose activations have the outliers of trained networks, to choose
and check the measures of the int8 path (QuantVGGT, QVGGT and SmoothQuant describe such outliers).
Weights are drawn from a normal distribution, as trained ones look, not from a uniform one.

usage: plant_outliers.py OUT.pt FACTOR KIND...
kinds, each at four channels of every transformer block of DINOv2, frame and global blocks:
  norm    gain and bias of the layer norms times FACTOR, the weights that read them over FACTOR
  value   rows of v times FACTOR, columns of proj over FACTOR
  hidden  rows of fc1 times FACTOR, columns of fc2 over FACTOR
  logits  rows of q times FACTOR / 10, rows of k over it (DINOv2, which has no q and k norms)
  tokens  camera and register tokens plus FACTOR at one channel (changes the function)
All but `hidden` and `tokens` leave the function of the network as it is.
"""
import os
import sys

import numpy as np
import torch

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../data/ckpt"))
import make  # noqa: E402

MINI = dict(make.FULL, embed=384, heads=6, dino_depth=4, dino_heads=6, depth=6, keep=[1, 2, 4, 5],
            qk_layer=3, cam_depth=2, cam_heads=6, depth_feat=64, depth_oc=[48, 96, 192, 192],
            gs_oc=[64, 96, 128, 128])


def main():
    out, factor, kinds = sys.argv[1], float(sys.argv[2]), sys.argv[3:]
    d, rng, state = MINI, np.random.default_rng(7), {}
    for name, shape in make.table(d):
        w = make.hashed(name, shape)
        if len(shape) > 1 and name.endswith("weight"):  # same deviation, normal
            w = rng.standard_normal(shape, dtype=np.float32) * np.float32(w.std())
        state[name] = torch.from_numpy(np.ascontiguousarray(w))
    c = d["embed"]
    a = "encoder.aggregator."
    blocks = [f"{a}patch_embed.blocks.{i}." for i in range(d["dino_depth"])]
    blocks += [f"{a}{k}_blocks.{i}." for k in ("frame", "global") for i in range(d["depth"])]
    for b in blocks:
        pick = torch.from_numpy(rng.choice(c, 4, replace=False))
        if "norm" in kinds:
            for norm, reads in (("norm1", "attn.qkv"), ("norm2", "mlp.fc1")):
                state[b + norm + ".weight"][pick] *= factor
                state[b + norm + ".bias"][pick] *= factor
                state[b + reads + ".weight"][:, pick] /= factor
        if "value" in kinds:
            state[b + "attn.qkv.weight"][2 * c + pick] *= factor
            state[b + "attn.qkv.bias"][2 * c + pick] *= factor
            state[b + "attn.proj.weight"][:, pick] /= factor
        if "hidden" in kinds:
            state[b + "mlp.fc1.weight"][4 * pick] *= factor
            state[b + "mlp.fc1.bias"][4 * pick] *= factor
            state[b + "mlp.fc2.weight"][:, 4 * pick] /= factor
        if "logits" in kinds and "patch_embed" in b:
            state[b + "attn.qkv.weight"][pick] *= factor / 10
            state[b + "attn.qkv.weight"][c + pick] /= factor / 10
            state[b + "attn.qkv.bias"][pick] *= factor / 10
            state[b + "attn.qkv.bias"][c + pick] /= factor / 10
    if "tokens" in kinds:
        for name in ("camera_token", "register_token", "patch_embed.register_tokens"):
            state[a + name][..., 17] += factor
    torch.save({"state_dict": {"model." + k: v for k, v in state.items()}}, out)


if __name__ == "__main__":
    main()
