#!/usr/bin/env python3
"""True cameras of a set of Strecha et al. ("On benchmarking camera calibration and multi-view
stereo for high resolution imagery", CVPR 2008) as a COLMAP text model, for colmap_pose.py.

The sets are at https://github.com/openMVG/SfM_quality_evaluation: folders with images and
gt_dense_cameras. A file of these has K, a row of zeros, the rotation of the camera to the world
and its centre in metres, and the size of the picture.

usage: strecha.py SET OUT
"""
import glob
import os
import sys

import numpy as np


def quaternion(r):
    """w, x, y, z of a rotation, by the largest eigenvalue (Bar-Itzhack 2000)"""
    k = np.array([
        [r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
        [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
        [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
        [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)]])
    return np.linalg.eigh(k)[1][[3, 0, 1, 2], -1]


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__.split("\n\n")[-1].strip())
    folder, out = sys.argv[1:]
    files = sorted(glob.glob(os.path.join(folder, "gt_dense_cameras", "*.camera")))
    if not files:
        sys.exit(f"{folder}: no gt_dense_cameras/*.camera in it")
    os.makedirs(out, exist_ok=True)
    open(os.path.join(out, "points3D.txt"), "w").close()
    with open(os.path.join(out, "cameras.txt"), "w") as cameras, \
            open(os.path.join(out, "images.txt"), "w") as images:
        for i, path in enumerate(files, 1):
            with open(path) as f:
                v = np.array([float(x) for x in f.read().split()])
            k, r, w, h = v[:9].reshape(3, 3), v[12:21].reshape(3, 3).T, v[24], v[25]
            pose = " ".join(f"{x:.12g}" for x in [*quaternion(r), *(-r @ v[21:24])])
            cameras.write(f"{i} PINHOLE {w:.0f} {h:.0f} {k[0, 0]} {k[1, 1]} {k[0, 2]} {k[1, 2]}\n")
            images.write(f"{i} {pose} {i} {os.path.basename(path)[:-7]}\n\n")


if __name__ == "__main__":
    main()
