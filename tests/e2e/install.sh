#!/usr/bin/env bash
# What make install and make deb put where: unit and rules that systemd accepts, a sandbox that is
# tight, settings that can be read.
. tests/e2e/common.bash
root=$PWD/$OUT/root
build=$(basename "${HDRIG%/*}")
variant=$(case $build in *-werror) echo WERROR=1 ;; esac)

# shellcheck disable=SC2086
make -s install $variant BOARD=rpi5 DESTDIR="$root" PREFIX=/usr >"$OUT/make.txt" 2>&1 ||
    fail "make install: $(tail -n 1 "$OUT/make.txt")"
make -s install $variant BOARD=toaster DESTDIR="$root" >"$OUT/make.txt" 2>&1 &&
    fail "a board that does not exist"
grep -q 'no board/toaster/board.conf: .*rpi5' "$OUT/make.txt" || fail "boards are not listed"
for file in bin/hdrig bin/hdrigd share/hdrig/small.hdrig lib/udev/rules.d/60-hdrig.rules \
    lib/sysusers.d/hdrig.conf lib/systemd/system/hdrigd.service; do
    [ -f "$root/usr/$file" ] || fail "no $file"
done

# settings: those of every board, in their order
for board in board/*/board.conf; do
    "$root/usr/bin/hdrigd" --config "$board" --check >/dev/null 2>"$ERR" ||
        fail "$board: $(cat "$ERR")"
done
cmp -s "$root/etc/hdrig/board.conf" board/rpi5/board.conf || fail "no board.conf"

# the unit
unit=$root/usr/lib/systemd/system/hdrigd.service
systemd-analyze --root="$root" --recursive-errors=no verify hdrigd.service >"$ERR" 2>&1
grep -i 'hdrigd.service:.*\(unknown\|invalid\|failed\|ignoring\)' "$ERR" && fail "systemd complains"
level=$(systemd-analyze security --offline=true "$unit" 2>/dev/null |
    sed -n 's/.*Overall exposure level for [^:]*: \([0-9.]*\).*/\1/p')
at_least "2.0 less the exposure level" "$(awk -v l="${level:-10}" 'BEGIN { print 2.0 - l }')" 0
echo "systemd-analyze security: $level"
grep -q '^DeviceAllow=char-dma_heap rw$' "$unit" || fail "libcamera may not open the DMA heaps"

# the package
if [ "$build" = "$(uname -m)-werror" ] || [ "$build" = "$(uname -m)" ]; then
    # shellcheck disable=SC2086
    make -s deb $variant BOARD=rpi5 >"$OUT/make.txt" 2>&1 ||
        fail "make deb: $(tail -n 1 "$OUT/make.txt")"
    deb=$(ls build/hdrig_*.deb)
    dpkg-deb -f "$deb" Depends | grep -q 'libmicrohttpd' || fail "the package's needs are missing"
    dpkg-deb -I "$deb" conffiles | grep -q '^/etc/hdrig/board.conf$' || fail "no conffiles"
    dpkg-deb -x "$deb" "$OUT/deb"
    "$OUT/deb/usr/bin/hdrig" --help >/dev/null || fail "the package's program does not run"
fi
finish
