#!/usr/bin/env bash
# qemu.sh - Debian's own kernel for QEMU, with the drivers that it lacks built as modules: vimc and
# gpio-sim; prints the folder with `vmlinux` and `lib/modules`.
. "${0%/*}/cache.bash"
headers=$(find /usr/src -maxdepth 1 -name 'linux-headers-*-amd64' | sort -V | tail -n 1)
[ -n "$headers" ] || fail "package linux-headers-amd64 is not installed"
release=${headers#*linux-headers-}
package=linux-source-$(echo "$release" | cut -d . -f 1,2)
made=$cache/qemu-$(key qemu.sh)-$release
if [ -e "$made/vmlinux" ]; then
    echo "$made"
    exit
fi

begin_work 1500
echo "preparing the kernel $release for QEMU, half a minute of one processor" >&2
unpack "linux-image-$release"
unpack "$package"
tar xf "usr/src/$package.tar.xz" --strip-components=1 --wildcards "$package/scripts/*" \
    "$package/drivers/gpio/gpio*.[ch]" "$package/kernel/irq/*" "*/test-drivers/vimc/*"

build() {
    local modules=lib/modules/$release path to
    mkdir -p m made/$modules $modules/extra
    cp drivers/gpio/{gpio-sim.c,gpiolib.h} kernel/irq/irq_sim.c drivers/media/*/vimc/vimc* m
    # No module can call irq_to_desc, and this is none in the kernel that we have.
    sed -i 's/irq_to_desc(\(\w*\))/irq_data_to_desc(irq_get_irq_data(\1))/' m/irq_sim.c
    echo 'MODULE_LICENSE("GPL");' >>m/irq_sim.c
    echo "obj-m := irq_sim.o gpio-sim.o vimc.o
vimc-y := $(cd m && echo vimc-*.c | sed 's/\.c/.o/g')" >m/Kbuild
    make -s -C "$headers" M="$work/m" modules || return
    strip -d m/*.ko
    cp m/*.ko $modules/extra
    depmod -b . "$release" || return
    for module in brd configfs dm-log-writes evdev ext4 gpio-sim uinput uvcvideo vhci-hcd vimc \
        vivid; do
        modprobe -d . -S "$release" --show-depends $module || exit
    done | sed -n 's/^insmod //p' | sort -u | while read -r path _; do
        to=made/$modules/${path#*"$modules"/}
        mkdir -p "${to%/*}"
        cp "$path" "$to"
    done || return
    cp $modules/modules.{builtin,builtin.modinfo,order} made/$modules
    depmod -b made "$release" || return
    # Unpacked here: the kernel would do it under emulation.
    bash scripts/extract-vmlinux "boot/vmlinuz-$release" >made/vmlinux
}

(build) >"$log" 2>&1 || {
    tail -n 30 "$log" >&2
    fail "cannot be prepared, $log"
}
keep "$made"
