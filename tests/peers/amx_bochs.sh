#!/usr/bin/env bash
# amx_bochs.sh SOURCE [FOLDER] - runs cpu_test, gemm_test and net_test on a processor with AMX that
# Bochs emulates: detection, permission by the kernel, products against plain C, the tiny network
# for 1, 2 and 7 threads. Building Bochs takes some minutes, a run three. SOURCE is a checkout of
# github.com/bochs-emu/Bochs at 783b58fd6, of which a mended copy (amx_bochs.diff) is built once in
# build/bochs; FOLDER has the programs, default build/x86_64. KERNEL=FILE is Linux 5.16 or later
# with a serial console and an initramfs; default Debian's, by apt. Packages: g++ cpio patch
# isolinux syslinux-common xorriso.
set -euo pipefail
cd "$(dirname "$0")/../.."
[ $# -ge 1 ] || { echo "usage: $0 SOURCE [FOLDER]" >&2; exit 2; }
source=$1 from=${2:-build/x86_64} work=build/bochs limit=3600
mkdir -p $work build/log
log=$PWD/build/log/amx_bochs.log

emulator() {
    rm -rf $work/source
    cp -r "$source/bochs" $work/source
    patch -s -d $work/source -p1 <tests/peers/amx_bochs.diff
    cd $work/source
    ./configure --with-nogui --enable-cpu-level=6 --enable-x86-64 --enable-avx --enable-evex \
        --enable-amx --enable-all-optimizations --enable-large-ramfile --disable-docbook \
        CFLAGS=-O2 CXXFLAGS=-O2
    nice -n 10 make -s -j2 bochs
}
[ -x $work/source/bochs ] || (emulator) >"$log" 2>&1 || { tail "$log" >&2; exit 1; }

if [ -z "${KERNEL:-}" ] && ! ls $work/linux/boot/vmlinuz-* >/dev/null 2>&1; then
    package=$(apt-cache depends linux-image-amd64 | sed -n 's/.*Depends: //p')
    (cd $work && apt-get -q -o APT::Sandbox::User=root download "$package" >"$log" &&
        dpkg -x "$package"_*.deb linux && rm -r "$package"_*.deb linux/lib)
fi
kernel=${KERNEL:-$(echo $work/linux/boot/vmlinuz-*)}

# An image with nothing but the kernel, a shell, the tests and their libraries.
iso=$work/iso root=$work/root
rm -rf $iso $root
mkdir -p $iso $root/{bin,dev}
for f in /bin/sh "$from"/tests/unit/core/{base/cpu,net/net}_test "$from"/tests/kernels/gemm_test; do
    cp -L "$f" $root/bin
    for lib in $(ldd "$f" | awk '$2 == "=>" { print $3 } /^\t\// { print $1 }'); do
        mkdir -p "$root${lib%/*}"
        cp -L "$lib" "$root$lib"
    done
done
strip $root/bin/*_test
cat >$root/init <<'END'
#!/bin/sh
for t in cpu_test "gemm_test --only amx" net_test; do
    $t
    echo "$t: exit $?"
done
echo ALL_RUN
read -r forever
END
chmod +x $root/init
(cd $root && find . | cpio -o -H newc -R 0:0 --quiet) >$iso/initrd
cp "$kernel" $iso/vmlinuz
cp /usr/lib/ISOLINUX/isolinux.bin /usr/lib/syslinux/modules/bios/ldlinux.c32 $iso
# Fast strings are off in MSR 1a0h, which Bochs lacks; Linux then needs FSRM (580) off as well.
cat >$iso/isolinux.cfg <<'END'
default linux
label linux
kernel /vmlinuz
append initrd=/initrd console=ttyS0 quiet mitigations=off tsc=reliable clearcpuid=580 panic=-1
END
xorriso -as mkisofs -quiet -o $work/amx.iso -b isolinux.bin -c boot.cat -no-emul-boot \
    -boot-load-size 4 -boot-info-table $iso 2>"$log"

cat >$work/bochsrc <<END
display_library: nogui
romimage: file=$work/source/bios/BIOS-bochs-latest
vgaromimage: file=$work/source/bios/VGABIOS-lgpl/VGABIOS-lgpl-latest.bin
cpu: model=sapphire_rapids, count=1, ips=100000000, reset_on_triple_fault=0
memory: guest=512, host=512
ata0-master: type=cdrom, path=$work/amx.iso, status=inserted
boot: cdrom
com1: enabled=1, mode=file, dev=$log
clock: sync=none, time0=1700000000
log: $work/bochs.log
END
: >"$log"
nice -n 10 $work/source/bochs -q -f $work/bochsrc </dev/null >/dev/null 2>&1 &
bochs=$!
trap 'kill $bochs 2>/dev/null' EXIT
while ! grep -q 'ALL_RUN\|Kernel panic' "$log" && kill -0 $bochs 2>/dev/null; do
    [ $SECONDS -lt $limit ] || { echo "not done after $limit s: $log" >&2; exit 1; }
    sleep 2
done
tr -d '\r' <"$log" | grep -E '^(ok|FAILED|--) |: exit '
[ "$(grep -c ': exit 0' "$log")" = 3 ] && grep -q '^ok amx s8' "$log"
