#!/usr/bin/env bash
# make.sh - made the files beside it, by the writers of their formats: 48 random splats (truth.ply),
#   two.sog        as splat-transform writes them, and two.ply as it reads that back
#   one, one.sog   its pictures with a meta.json of version 1, and one.ply likewise
#   level?.ksplat  as GaussianSplats3D writes them, in small buckets
# Needs npm with its registry and zip. Codebooks are the same each time, harmonics are clustered by
# chance.
set -euo pipefail
here=$(dirname "$(realpath "$0")")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm init -y >/dev/null
npm install --no-fund --no-audit --ignore-scripts --loglevel=error \
    @playcanvas/splat-transform@3.7.0 @mkkellogg/gaussian-splats-3d@0.4.7 >/dev/null
cp "$here/make.mjs" .
transform() { npx splat-transform -q -w -g cpu "$@"; }

node make.mjs truth
transform truth.ply two.sog
transform two.sog two.ply
mkdir one
transform two.sog one/meta.json
node make.mjs old one/meta.json
(cd one && zip -q -X ../one.sog ./*) # compressed, as a person would pack it
transform one.sog one.ply
for level in 0 1 2; do
    node --no-deprecation make.mjs ksplat truth.ply level$level.ksplat $level
done
rm -rf "$here/one"
cp -r one truth.ply ./*.sog one.ply two.ply ./*.ksplat "$here"
