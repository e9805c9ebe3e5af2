#!/usr/bin/env bash
# Files that make install and make deb install: unit and rules that systemd accepts, a tight
# sandbox, settings that can be read.
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

# a second time: settings that were changed stay; and away again
echo '# mine' >>"$root/etc/hdrig/board.conf"
echo '# mine' >"$root/etc/hdrig/hdrig.conf"
# shellcheck disable=SC2086
make -s install $variant BOARD=x86 DESTDIR="$root" PREFIX=/usr >"$OUT/make.txt" 2>&1 ||
    fail "make install again: $(tail -n 1 "$OUT/make.txt")"
grep -q 'board.conf was changed and stays; ours is .*board.conf.new' "$OUT/make.txt" ||
    fail "nobody says that board.conf was changed"
grep -q '^# mine' "$root/etc/hdrig/board.conf" || fail "board.conf was written over"
cmp -s "$root/etc/hdrig/board.conf.new" board/x86/board.conf || fail "no board.conf.new"
make -s uninstall DESTDIR="$root" PREFIX=/usr >"$OUT/make.txt" 2>&1 || fail "make uninstall"
left=$(cd "$root" && find . -type f | sort | xargs)
[ "$left" = "./etc/hdrig/board.conf ./etc/hdrig/hdrig.conf" ] || fail "uninstall leaves: $left"
grep -q 'board.conf was changed and stays' "$OUT/make.txt" || fail "uninstall says nothing"

# the package
if [ "$build" = "$(uname -m)-werror" ] || [ "$build" = "$(uname -m)" ]; then
    # shellcheck disable=SC2086
    make -s deb $variant BOARD=rpi5 >"$OUT/make.txt" 2>&1 ||
        fail "make deb: $(tail -n 1 "$OUT/make.txt")"
    deb=$(ls build/hdrig_*_"$(dpkg --print-architecture)".deb)
    dpkg-deb -f "$deb" Depends | grep -q 'libmicrohttpd' || fail "the package's needs are missing"
    dpkg-deb -f "$deb" Depends | grep -q 'libcamera' || fail "the package needs no libcamera"
    lintian "$deb" >"$OUT/lintian.txt" 2>&1
    grep '^E:' "$OUT/lintian.txt" && fail "lintian finds errors"
    dpkg-deb -I "$deb" conffiles | grep -q '^/etc/hdrig/board.conf$' || fail "no conffiles"
    dpkg-deb -x "$deb" "$OUT/deb"
    "$OUT/deb/usr/bin/hdrig" --help >/dev/null || fail "the package's program does not run"
fi
finish
