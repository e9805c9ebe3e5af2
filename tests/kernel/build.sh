#!/usr/bin/env bash
# build.sh - User Mode Linux for the tests here, out of Debian's source package; prints the folder
# with `linux` and `lib/modules`. Built once per package version, uml.config and this file; kept in
# $XDG_CACHE_HOME/hdrig, so that other checkouts on the machine find it.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
package=linux-source-6.1
cache=${XDG_CACHE_HOME:-$HOME/.cache}/hdrig
key=$(cat "$here/uml.config" "$here/build.sh" | sha256sum | cut -c 1-12)

fail() {
    echo "kernel for the tests: $*" >&2
    exit 1
}

mkdir -p "$cache"
exec 9>"$cache/lock"
flock 9

version=$(apt-cache policy "$package" 2>/dev/null | sed -n 's/^ *Candidate: //p' | tr ':~' '__')
if [ -z "$version" ] || [ "$version" = "(none)" ]; then
    version=$(cd "$cache" && for d in uml-"$key"-*; do echo "${d#uml-"$key"-}"; done | tail -n 1)
    [ -e "$cache/uml-$key-$version/linux" ] ||
        fail "apt knows no package $package, and none is built; apt-get update needs a network"
fi
made=$cache/uml-$key-$version
if [ -e "$made/linux" ]; then
    echo "$made"
    exit
fi

free=$(df -Pk "$cache" | awk 'NR == 2 { print int($4 / 1024) }')
[ "$free" -ge 2500 ] || fail "$cache has $free MB left, the build needs 2500"
work=$cache/.build
rm -rf "$work" && mkdir -p "$work"
trap 'rm -rf "$work"' EXIT
cd "$work"
echo "building User Mode Linux $version once, five minutes of one processor" >&2
log=$cache/build.log
# As root apt would download as another user, who may not write here.
apt-get -q -o APT::Sandbox::User=root download "$package" >"$log" 2>&1 ||
    fail "cannot download $package: $(tail -n 1 "$log")"
dpkg -x "$package"_*.deb .
tar xf "usr/src/$package.tar.xz"
source=$work/$package

# The registers of a process take 11008 bytes on machines with AMX; 6.1 reserves 2696, and no
# process starts. What PCI would bring and vivid and GPIO need: DMA, I/O memory, more interrupts.
sed -i 's/DEFINE_LONGS(HOST_FP_SIZE, 2696)/DEFINE_LONGS(HOST_FP_SIZE, 16384)/' \
    "$source/arch/x86/um/user-offsets.c"
sed -i '/^config UML_\(DMA\|IOMEM\)_EMULATION/ { n; s/bool$/bool "emulated"/ }' \
    "$source/arch/um/Kconfig"
# Simulated GPIO lines interrupt at the next tick: 1 ms, not 10.
sed -i '/^config HZ$/,/default/ s/100$/1000/' "$source/arch/um/Kconfig"
sed -i 's/CONFIG_PCI_MSI/CONFIG_GPIOLIB/' "$source/arch/um/include/asm/irq.h"

build() {
    make -s -C "$source" O="$work/b" ARCH=um tinyconfig || return
    cd "$work/b"
    "$source/scripts/kconfig/merge_config.sh" -m -O . .config "$here/uml.config" || return
    # Without syncconfig the first make believes that this is a 32-bit machine.
    make -s ARCH=um olddefconfig && make -s ARCH=um syncconfig || return
    grep '=[ymn0-9"]' "$here/uml.config" | grep -v '^#' | while read -r line; do
        case $line in
        *=n) ! grep -q "^${line%n}[ym]" .config ;;
        *) grep -qxF "$line" .config ;;
        esac || { echo "the kernel has no $line"; exit 1; }
    done || return
    nice -n 5 make -s ARCH=um -j"${JOBS:-$(nproc)}" linux modules || return
    make -s ARCH=um modules_install INSTALL_MOD_PATH="$work/made" INSTALL_MOD_STRIP=1
}

unset MAKEFLAGS MAKELEVEL MFLAGS
(build) >"$log" 2>&1 || {
    tail -n 30 "$log" >&2
    fail "does not build, $log"
}
rm -f "$work"/made/lib/modules/*/{build,source}
strip -o "$work/made/linux" "$work/b/linux"
rm -rf "$made"
mv "$work/made" "$made"
echo "$made"
