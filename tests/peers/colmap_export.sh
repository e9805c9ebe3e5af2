#!/usr/bin/env bash
# colmap_export.sh SET [WORK] - whether pictures and cameras of an export fit each other, by COLMAP
# (Debian: colmap): it finds features in the pictures of SET, triangulates points with the cameras
# of SET as they are, and tells how far the points are from where they were seen. A wrong lens,
# turn or convention shows as few points, or as pixels instead of tenths of them.
set -eu
set_=$(realpath "$1")
work=${2:-$(mktemp -d)}
export QT_QPA_PLATFORM=offscreen
mkdir -p "$work/model"
colmap feature_extractor --database_path "$work/db.db" --image_path "$set_/images" \
    --ImageReader.camera_model PINHOLE --SiftExtraction.use_gpu 0 \
    --SiftExtraction.max_image_size 1200 --SiftExtraction.max_num_features 3000 >"$work/log" 2>&1
colmap exhaustive_matcher --database_path "$work/db.db" --SiftMatching.use_gpu 0 \
    >>"$work/log" 2>&1
colmap point_triangulator --database_path "$work/db.db" --image_path "$set_/images" \
    --input_path "$set_/sparse/0" --output_path "$work/model" --clear_points 1 >>"$work/log" 2>&1
colmap model_analyzer --path "$work/model"
