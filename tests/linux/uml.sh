#!/usr/bin/env bash
# uml.sh - User Mode Linux for the tests here, out of Debian's source package; prints the folder
# with `linux` and `lib/modules`.
. "${0%/*}/cache.bash"
package=linux-source-6.1
name=uml-$(key uml.sh uml.config)

version=$(apt-cache policy "$package" 2>/dev/null | sed -n 's/^ *Candidate: //p' | tr ':~' '__')
if [ -z "$version" ] || [ "$version" = "(none)" ]; then
    version=$(cd "$cache" && for d in "$name"-*; do echo "${d#"$name-"}"; done | tail -n 1)
    [ -e "$cache/$name-$version/linux" ] ||
        fail "apt knows no package $package, and none is built; apt-get update needs a network"
fi
made=$cache/$name-$version
if [ -e "$made/linux" ]; then
    echo "$made"
    exit
fi

begin_work 2500
echo "building User Mode Linux $version once, five minutes of one processor" >&2
unpack "$package"
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

(build) >"$log" 2>&1 || {
    tail -n 30 "$log" >&2
    fail "does not build, $log"
}
rm -f made/lib/modules/*/{build,source}
strip -o made/linux b/linux
keep "$made"
