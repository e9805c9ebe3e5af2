#!/bin/sh
# package.sh DEB SYSROOT - the package for arm64 (make deb CROSS=aarch64-linux-gnu-) names its
# architecture and its libraries, and its programs work on an emulated processor: the tool makes a
# scene with its page, the daemon reads its settings.
set -eu
deb=$1 sysroot=$2
dir=build/arm64-package
rm -rf $dir
mkdir -p $dir

fail() { # sentence
    echo "package.sh: $*" >&2
    exit 1
}

[ "$(dpkg-deb -f "$deb" Architecture)" = arm64 ] ||
    fail "$deb has the architecture $(dpkg-deb -f "$deb" Architecture), not arm64"
depends=$(dpkg-deb -f "$deb" Depends)
for library in libc6 libcamera libgpiod libopenexr libsystemd0; do
    case $depends in
    *"$library"*) ;;
    *) fail "$deb does not depend on $library: $depends" ;;
    esac
done
dpkg-deb -x "$deb" $dir
for file in $dir/usr/bin/* $dir/usr/lib/hdrig/*.so; do
    [ "$(od -An -t u2 -j 18 -N 2 "$file" | tr -d ' ')" = 183 ] || fail "$file is not of AArch64"
done

emulated() { # program arguments...
    program=$1
    shift
    qemu-aarch64 -L "$sysroot" -cpu cortex-a76 $dir/usr/bin/"$program" "$@"
}

emulated hdrig --version
emulated hdrig doctor
emulated hdrigd --check --set store.path="$PWD/$dir/store"
emulated hdrig simulate --kind room --seed 3 --views 4 --size 112 --samples 2 --out $dir/world
emulated hdrig reconstruct --images $dir/world --rig none --size 112 --refine 10 \
    --out $dir/scene
for file in scene.ply report.html view.html; do
    [ -s $dir/scene/$file ] || fail "the scene has no $file"
done
rm -r $dir
echo "$deb: all as expected"
