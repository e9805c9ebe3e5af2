"""Errors of a calibrated rig against the true one, or a rig file to simulate.

rig_pose.py TRUE.json FOUND.json: over all pairs of cameras the angle between both relative
rotations, and the length of the relative centre: its ratio (1 in metres), and the distance of both
centres as seen by the other camera, once the ratio is taken out.
rig_pose.py --make N STEP RADIUS: N cameras of 560 x 420 px, STEP degrees apart, on a circle of
RADIUS metres that they look out of (in to: below 0), with radial distortion.
"""
import json
import math
import sys

import numpy as np

W, H, FOCAL, TERMS = 560, 420, 490, (-0.1, 0.01)


def make(n: int, step: float, radius: float) -> None:
    cams = []
    for i in range(n):
        half = math.radians((i - (n - 1) / 2) * step) / 2
        cams.append({"name": f"cam_{i:02d}.png", "w": W, "h": H, "fx": FOCAL, "fy": FOCAL,
                     "cx": W / 2, "cy": H / 2, "q": [math.cos(half), 0, -math.sin(half), 0],
                     "t": [0, 0.02 * (i % 3), -radius],
                     "model": "RADIAL", "params": [FOCAL, W / 2, H / 2, *TERMS]})
    print(json.dumps({"generator": "hdrig", "unit": "m", "cameras": cams}))


def rotation(q) -> np.ndarray:
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def load(path: str):
    with open(path, encoding="utf-8") as f:
        cams = json.load(f)["cameras"]
    return [(rotation(c["q"]), np.array(c["t"]), c["fx"]) for c in cams]


def compare(true: str, found: str) -> None:
    a, b = load(true), load(found)
    angles, ratios, apart = [], [], []
    for i in range(len(a)):
        for j in range(i):
            turn = (a[i][0] @ a[j][0].T) @ (b[i][0] @ b[j][0].T).T
            angles.append(math.degrees(math.acos(min(1, (np.trace(turn) - 1) / 2))))
            at = [c[j][0] @ (c[j][0].T @ c[j][1] - c[i][0].T @ c[i][1]) for c in (a, b)]
            ratios.append(np.linalg.norm(at[1]) / np.linalg.norm(at[0]))
            apart.append(at)
    scale = float(np.median(ratios))
    off = [1000 * np.linalg.norm(x - y / scale) for x, y in apart]
    focal = [y[2] / x[2] for x, y in zip(a, b)]
    print(f"rotation {np.median(angles):.4f} median, {max(angles):.4f} largest; scale {scale:.5f}; "
          f"centres {np.median(off):.2f} mm median, {max(off):.2f} largest; "
          f"focal length {np.median(focal):.4f}")


if sys.argv[1] == "--make":
    make(int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]))
else:
    compare(sys.argv[1], sys.argv[2])
