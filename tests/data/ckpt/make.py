#!/usr/bin/env python3
"""Writes checkpoints as PyTorch and Lightning do, with the true names and hashed values
(core/net/hashed.h). Without arguments: the fixtures of this folder, from a network of the smallest
size (tiny.json). With FILE and a configuration ("tiny", "full") one checkpoint, to measure with.
"""

import collections
import json
import math
import os
import struct
import sys
import zipfile

import numpy as np
import torch

HERE = os.path.dirname(os.path.abspath(__file__))

FULL = dict(embed=1024, heads=16, dino_depth=24, dino_heads=16, depth=24, keep=[4, 11, 17, 23],
            qk_layer=14, cam_depth=4, cam_heads=16, depth_feat=256, gs_feat=256,
            depth_oc=[256, 512, 1024, 1024], gs_oc=[256, 512, 1024, 1024], hdr=128)
TINY = dict(embed=32, heads=1, dino_depth=1, dino_heads=1, depth=4, keep=[0, 1, 2, 3], qk_layer=2,
            cam_depth=1, cam_heads=1, depth_feat=8, gs_feat=8, depth_oc=[4, 8, 12, 12],
            gs_oc=[4, 4, 8, 8], hdr=4)


def table(d, gauss=True, hdr=True):
    """(name, shape) of every tensor, in the order of the release."""
    out = []

    def pair(name, *shape):
        out.append((name + ".weight", shape))
        out.append((name + ".bias", shape[:1]))

    def transposed(name, n, edge):
        out.append((name + ".weight", (n, n, edge, edge)))
        out.append((name + ".bias", (n,)))

    def block(name, c, qk):
        pair(name + ".norm1", c)
        pair(name + ".attn.qkv", 3 * c, c)
        if qk:
            pair(name + ".attn.q_norm", qk)
            pair(name + ".attn.k_norm", qk)
        pair(name + ".attn.proj", c, c)
        out.append((name + ".ls1.gamma", (c,)))
        pair(name + ".norm2", c)
        pair(name + ".mlp.fc1", 4 * c, c)
        pair(name + ".mlp.fc2", c, 4 * c)
        out.append((name + ".ls2.gamma", (c,)))

    def dpt(h, feat, oc):
        pair(h + ".norm", 2 * c)
        for k in range(4):
            pair(f"{h}.projects.{k}", oc[k], 2 * c, 1, 1)
        transposed(h + ".resize_layers.0", oc[0], 4)
        transposed(h + ".resize_layers.1", oc[1], 2)
        pair(h + ".resize_layers.3", oc[3], oc[3], 3, 3)
        for k in range(4):
            out.append((f"{h}.scratch.layer{k + 1}_rn.weight", (feat, oc[k], 3, 3)))
        for k in range(1, 5):
            pair(f"{h}.scratch.refinenet{k}.out_conv", feat, feat, 1, 1)
            for unit in (1, 2) if k < 4 else (2,):
                for conv in (1, 2):
                    pair(f"{h}.scratch.refinenet{k}.resConfUnit{unit}.conv{conv}", feat, feat, 3, 3)
        pair(h + ".scratch.output_conv1", feat // 2, feat, 3, 3)

    c, a = d["embed"], "encoder.aggregator"
    out += [(a + ".camera_token", (1, 2, 1, c)), (a + ".register_token", (1, 2, 4, c)),
            (a + ".patch_embed.cls_token", (1, 1, c)),
            (a + ".patch_embed.pos_embed", (1, 1370, c)),
            (a + ".patch_embed.register_tokens", (1, 4, c)),
            (a + ".patch_embed.mask_token", (1, c))]
    pair(a + ".patch_embed.patch_embed.proj", c, 3, 14, 14)
    for i in range(d["dino_depth"]):
        block(f"{a}.patch_embed.blocks.{i}", c, 0)
    pair(a + ".patch_embed.norm", c)
    for kind in ("frame", "global"):
        for i in range(d["depth"]):
            block(f"{a}.{kind}_blocks.{i}", c, c // d["heads"])
    h = "encoder.camera_head"
    out.append((h + ".empty_pose_tokens", (1, 1, 9)))
    for i in range(d["cam_depth"]):
        block(f"{h}.trunk.{i}", 2 * c, 0)
    pair(h + ".token_norm", 2 * c)
    pair(h + ".trunk_norm", 2 * c)
    pair(h + ".embed_pose", 2 * c, 9)
    pair(h + ".poseLN_modulation.1", 6 * c, 2 * c)
    pair(h + ".pose_branch.fc1", c, 2 * c)
    pair(h + ".pose_branch.fc2", 9, c)
    h = "encoder.depth_head"
    dpt(h, d["depth_feat"], d["depth_oc"])
    pair(h + ".scratch.output_conv2.0", 32, d["depth_feat"] // 2, 3, 3)
    pair(h + ".scratch.output_conv2.2", 2, 32, 1, 1)
    w = d["hdr"]
    if gauss:
        h = "encoder.gaussian_param_head"
        dpt(h, d["gs_feat"], d["gs_oc"])
        pair(h + ".scratch.output_conv2.0", w, w, 3, 3)
        pair(h + ".scratch.output_conv2.2", 84, w, 1, 1)
        pair(h + ".input_merger.0", w, 3, 7, 7)
    if not hdr:
        return out
    h, r = "encoder.hdr_head", "encoder.hdr_head.regression"
    pair(h + ".patch_embed", w, 3, 14, 14)
    out.append((h + ".pos_embed.div_term", (w // 2,)))
    pair(r + ".ln", w)
    pair(r + ".v_mean_proj", w, w)
    pair(r + ".v_var_proj", w, w)
    for k in ("mean_out", "var_out"):
        pair(f"{r}.{k}.0", w)
        pair(f"{r}.{k}.1", w, w)
        pair(f"{r}.{k}.3", w, w)
    pair(r + ".exp_film.0", w, 3 * w)
    pair(r + ".exp_film.2", 2 * w, w)
    pair(h + ".guide_encoder.0", w, 3, 7, 7)
    pair(h + ".scene_conv.0", w, w, 3, 3)
    pair(h + ".sensitivity_conv.0", 32, w, 3, 3)
    pair(h + ".sensitivity_conv.2", 4, 32, 1, 1)
    pair(h + ".hdr_upsample.proj_guide.0", w, w, 7, 7)
    pair(h + ".hdr_upsample.proj_out.0", w, w, 7, 7)
    pair("encoder.hdr_conv.0", w, w, 3, 3)
    pair("encoder.hdr_conv.2", 84, w, 1, 1)
    g = "encoder.generate_tonemapper"
    pair(g + ".exp_proj", w, w)
    pair(g + ".enc.0", w, 2 * w + 88, 14, 14)
    pair(g + ".enc.2", w, w, 3, 3)
    pair(g + ".out.0", w, 4 * w)
    pair(g + ".out.2", 1926, w)
    return out


def rules(name, shape, n):
    """Scale and offset: numbers, or arrays of n."""
    he = math.sqrt(3.0 / math.prod(shape[1:]))
    i = np.arange(n)

    def some(pairs):
        offset = np.zeros(n, np.float32)
        for k, v in pairs.items():
            offset[k] = v
        return 0.02, offset

    if name.endswith("camera_head.pose_branch.fc2.bias"):
        return some({6: 0.25, 7: 0.25, 8: 0.25})
    if name.endswith("depth_head.scratch.output_conv2.2.bias"):
        return some({0: 0.8})
    if name.endswith("hdr_conv.2.bias"):
        return some({0: 0.5, 1: 4.0, 2: 4.0, 3: 4.0, 7: 1.0})
    if name.endswith("hdr_conv.2.weight"):
        row = i // math.prod(shape[1:])
        m = np.where(row < 1, 0.7, np.where(row < 4, 1.0, np.where(row < 83, 4.0, 1.0)))
        return (m * he).astype(np.float32), 0.0
    if name.endswith("generate_tonemapper.out.2.bias"):
        j, scale, offset = i % 193, np.full(n, 0.1), np.zeros(n)
        for first, last, s, o in ((0, 64, .5, .5), (64, 128, 1, 1), (128, 192, .02, .02),
                                  (192, 193, .25, -1.5)):
            part = (i < 579) & (j >= first) & (j < last)
            scale[part], offset[part] = s, o
        return scale.astype(np.float32), offset.astype(np.float32)
    for suffix, scale, offset in (
            ("camera_head.pose_branch.fc2.weight", 0.05 * he, 0),
            ("depth_head.scratch.output_conv2.2.weight", 0.5 * he, 0),
            ("generate_tonemapper.out.2.weight", 0.1 * he, 0),
            ("hdr_head.regression.exp_film.2.weight", 0.5 * he, 0),
            ("q_norm.weight", 0.1, 1.8), ("k_norm.weight", 0.1, 1.8),
            ("attn.qkv.weight", 1.25 * he, 0), (".gamma", 0.1, 0.25),
            ("patch_embed.pos_embed", 1.5, 0), ("_token", 0.5, 0), ("_tokens", 0.5, 0),
            (".bias", 0.02, 0), (".model.1.weight", 0.5, 0.5)):
        if name.endswith(suffix):
            return scale, offset
    if name.startswith("features.") and len(shape) == 4:
        return math.sqrt(2) * he, 0.0
    if len(shape) == 1:
        return 0.1, 1.0
    if len(shape) == 4 and name.endswith(("resize_layers.0.weight", "resize_layers.1.weight")):
        return math.sqrt(3.0 / shape[0]), 0.0
    return he, 0.0


def hashed(name, shape, seed=1):
    n, g, mask = math.prod(shape), 0x9E3779B97F4A7C15, (1 << 64) - 1
    if name.endswith("div_term"):
        return np.exp(np.float32(math.log(2)) * np.arange(n, dtype=np.float32) / np.float32(n))
    h = 0xCBF29CE484222325
    for b in name.encode():
        h = (h ^ b) * 0x100000001B3 & mask
    z = np.arange(1, n + 1, dtype=np.uint64) * np.uint64(g) + np.uint64((h + seed * g) & mask)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    v = ((z >> np.uint64(40)).astype(np.int32) - 8388608).astype(np.float32) / np.float32(8388608)
    scale, offset = rules(name, shape, n)
    return (np.float32(offset) + np.float32(scale) * v).reshape(shape)


def tensors(d, prefix, **modules):
    """The state dict: bf16 aggregator, f32 heads, as in the release."""
    out = collections.OrderedDict()
    for name, shape in table(d, **modules):
        t = torch.from_numpy(hashed(name, shape))
        out[prefix + name] = t.bfloat16() if ".aggregator." in name else t
    return out


def lightning(state):
    """What Lightning adds: none of it is read."""
    moments = {k: {"step": torch.tensor(3.0), "exp_avg": torch.zeros(4, 4)} for k in range(3)}
    return {"epoch": 2, "global_step": 2 ** 40, "pytorch-lightning_version": "2.6.0",
            "state_dict": state, "loops": {"fit_loop": {"state_dict": {}, "done": None}},
            "callbacks": {"ModelCheckpoint": {"best": float("inf"), "path": "a/b.ckpt",
                                              "score": torch.tensor(1.5, dtype=torch.float64)}},
            "optimizer_states": [{"state": moments, "param_groups": [{"lr": 1e-4, "betas": (.9, .95),
                                                                      "params": [0, 1, 2]}]}],
            "lr_schedulers": [{"x": complex(1, 2), "seen": {1, 2}, "big": 10 ** 30}],
            "hyper_parameters": collections.Counter("abc")}


def awkward(state):
    """Parameters, halves, transposed, shared, sliced and expanded tensors; the same values."""
    key = "model.encoder.camera_head."
    state[key + "token_norm.weight"] = torch.nn.Parameter(state[key + "token_norm.weight"])
    state[key + "embed_pose.weight"] = state[key + "embed_pose.weight"].t().contiguous().t()
    fc1 = state[key + "pose_branch.fc1.weight"]
    both = torch.stack([fc1, state[key + "pose_branch.fc1.weight"].flip(0)])
    state[key + "pose_branch.fc1.weight"] = both[0]
    state["model.other.spare"] = both[1]  # shares a storage
    mean = "model.encoder.hdr_head.regression.mean_out."
    state[mean + "1.bias"] = state[mean + "3.bias"] = torch.full((1,), 0.25).expand(TINY["hdr"])
    state[mean + "0.weight"] = state[mean + "0.weight"].half()
    state["model.losses.count"] = torch.tensor(7)  # int64, not of the network
    return state


class Own(torch.Tensor):
    """A class of its own."""


def kinds():
    """A tensor of each kind that torch.save knows, behind the names of wrappers; the plain ones
    hold 1, 2, -3."""
    values = torch.tensor([1.0, 2.0, -3.0])
    state = collections.OrderedDict()
    state["module._orig_mod.aggregator.plain"] = values.clone()
    parameter = torch.nn.Parameter(values.clone())
    parameter.tag = "attribute"
    state["module._orig_mod.aggregator.parameter"] = parameter
    state["module.aggregator._orig_mod.buffer"] = torch.nn.Buffer(values.clone())
    tagged = values.clone()
    tagged.tag = 1
    state["aggregator._fsdp_wrapped_module._checkpoint_wrapped_module.tagged"] = tagged
    state["negative"] = torch.complex(values, -values).conj().imag
    state["half_negative"] = torch.complex(values, -values).to(torch.complex32).conj().imag
    state["conjugate"] = torch.complex(values, values).conj()
    state["quantised"] = torch.quantize_per_tensor(values, 0.5, 0, torch.qint8)
    state["sparse"] = values.to_sparse()
    state["byte"] = values.to(torch.float8_e4m3fn)
    state["subclass"] = values.as_subclass(Own)
    state["nowhere"] = torch.ones(3, device="meta")
    state["long"] = torch.tensor([1, 2])
    return {"epoch": 3, "optimizer": {"state": {}}, "model": {"module": state}}


def old():
    """What PyTorch before 1.6 wrote: shared, transposed and half tensors, of other types between."""
    both = torch.arange(12.0)
    state = collections.OrderedDict()
    state["features.0.weight"] = both[:6].view(2, 3)
    state["count"] = torch.tensor([1, 2, 3])
    state["features.0.bias"] = both[6:].view(3, 2).t()
    state["mask"] = torch.tensor([True, False, True])
    state["half"] = torch.tensor([1.0, -2.5]).half()
    state["brain"] = torch.nn.Parameter(torch.tensor([0.5, 3.0]).bfloat16())
    state["wave"] = torch.tensor([1 + 2j])
    state["lin0.model.1.weight"] = torch.tensor([0.25, 0.125]).view(1, 2, 1, 1)
    return {"epoch": 3, "state_dict": state}


def write_safetensors(path, state):
    """All F32, the container written by hand."""
    header, at, data = {}, 0, []
    for name, t in state.items():
        raw = t.detach().float().contiguous().numpy().astype("<f4").tobytes()
        header[name] = {"dtype": "F32", "shape": list(t.shape),
                        "data_offsets": [at, at + len(raw)]}
        at += len(raw)
        data.append(raw)
    text = json.dumps(header).encode()
    with open(path, "wb") as f:
        f.write(struct.pack("<Q", len(text)) + text + b"".join(data))


def main():
    if len(sys.argv) == 3:
        d = {"full": FULL, "tiny": TINY}[sys.argv[2]]
        torch.save(lightning(tensors(d, "model.")), sys.argv[1])
        return
    torch.save(lightning(awkward(tensors(TINY, "model."))), os.path.join(HERE, "tiny.ckpt"))
    torch.save(kinds(), os.path.join(HERE, "kinds.pt"))
    torch.save(old(), os.path.join(HERE, "old.pt"), _use_new_zipfile_serialization=False)
    torch.save({"epoch": 1, "model": torch.nn.Linear(1, 1)}, os.path.join(HERE, "object.pt"))
    with open(os.path.join(HERE, "tiny.json"), "w") as f:
        json.dump({"model": TINY, "voxel_size": 0.25, "image_size": 56}, f, indent=1)
        f.write("\n")


if __name__ == "__main__":
    main()
