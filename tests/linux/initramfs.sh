#!/usr/bin/env bash
# initramfs.sh OUT BIN MODULES - packs the files of this machine that the tests need, under the same
# paths: no file of a guest may come from a device, whose delays would be in real time.
set -euo pipefail
out=$1 bin=$2 modules=$3 guest=$(cd "$(dirname "$0")" && pwd)/guest
root=$out.root
rm -rf "$root"
trap 'rm -rf "$root"' EXIT
mkdir -p "$root"/usr/{bin,sbin,lib/systemd,lib64} "$root"/{dev,etc,proc,run,sys,tmp}
for d in bin sbin lib lib64; do
    ln -s usr/$d "$root/$d"
done

add() { # file...
    local f
    for f in "$@"; do
        [ -e "$root$f" ] || { mkdir -p "$root${f%/*}" && cp -L "$f" "$root$f"; }
    done
}

PATH=/usr/sbin:/usr/bin
programs=()
for f in awk bash cat cmp cp cut date dd dmsetup grep head ln ls mkdir mkfifo mkfs.ext4 modprobe \
    mount mv readlink realpath rm rmdir sed sleep sort sync tail timeout touch tr truncate \
    udevadm umount wc; do
    programs+=("$(command -v $f)")
done
ours=$(cd "$bin/../.." && pwd)
for f in "$bin"/* "$ours"/hdrig "$ours"/hdrigd; do
    [ -d "$f" ] || [ ! -x "$f" ] || programs+=("$f")
done
programs+=("$ours/hdrig-libcamera.so" /usr/lib/*/libcamera/*.so)
ln -s ../../bin/udevadm "$root/usr/lib/systemd/systemd-udevd"
add "${programs[@]}" /usr/lib/*/libcamera/*.sign "$guest"/*
strip "$root$bin"/* "$root$ours"/hdrig*
libraries=$(ldd "${programs[@]}" | awk '$2 == "=>" { print $3 } /^\t\// { print $1 }' | sort -u)
add $libraries
[ ! -e /usr/share/libcamera ] || cp -r --parents /usr/share/libcamera "$root"
mkdir -p "$root$modules"
cp -r "$modules/lib" "$root$modules"
ln -s "$modules/lib/modules" "$root/usr/lib/modules" # where the kernel itself looks
ln -s "$guest/init.sh" "$root/init"
(cd "$root" && find . | cpio -o -H newc -R 0:0 --quiet) >"$out"
