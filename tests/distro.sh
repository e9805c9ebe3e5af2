#!/usr/bin/env bash
# distro.sh SUITE - proves the last commit on a release of Debian, in roots made by debootstrap. In
# `full`, which has the packages of `make deps-check`, it is built from nothing and tested, and its
# package made; also that for arm64, which an emulated processor runs. In `try`, a copy of `bare`,
# which has the smallest set of packages, the package is installed, used and purged. The roots stay
# in ROOTS/SUITE (build/distro/SUITE) for the next run.
# Needs root, debootstrap and a mirror of Debian: the one of apt's settings, which the roots
# inherit.
# One line per step; its output is build/log/distro_SUITE_STEP.log.
set -eu
cd "$(dirname "$0")/.."
unset MAKEFLAGS MAKELEVEL MFLAGS
suite=${1-}

fail() { # sentence
    echo "distro.sh: $*" >&2
    exit 1
}

case $suite in
bookworm | trixie) ;;
*) fail "SUITE is \"$suite\"; it must be bookworm or trixie" ;;
esac
[ "$(id -u)" = 0 ] || fail "only root can mount and chroot: run it with sudo"
command -v debootstrap >/dev/null || fail "debootstrap is missing: apt-get install debootstrap"

# Again, in namespaces: mounts and processes end with them, however this ends.
if [ $$ != 1 ]; then
    unshare --mount --pid --fork --kill-child tests/distro.sh "$suite" &
    trap 'kill -KILL $!; exit 130' INT TERM HUP
    wait $! && exit || exit 1
fi
mount -t proc proc /proc

mkdir -p "${ROOTS:=build/distro}/$suite" build/log
roots=$(realpath "$ROOTS/$suite")
exec 9>"$roots/lock"
flock -n 9 || fail "$roots is in use by another run"

in_root() { # bare|full|try command
    unshare --mount bash -euc '
        mount -t proc proc "$0/proc"
        mount -t sysfs -o ro sys "$0/sys"
        mount --rbind /dev "$0/dev"
        mount -t tmpfs tmp "$0/dev/shm"
        exec chroot "$0" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C.UTF-8 \
            DEBIAN_FRONTEND=noninteractive bash -euc "$1"' "$roots/$1" "$2"
}

step() { # name command...
    local name=$1 log=build/log/distro_${suite}_$1.log start=$SECONDS status
    shift
    # In a condition, set -e would be without effect.
    set +e
    (set -e && "$@") >"$log" 2>&1 </dev/null
    status=$?
    set -e
    printf '%-60s %-6s %4d s\n' "$suite: $name" \
        "$([ $status = 0 ] && echo ok || echo FAILED)" $((SECONDS - start))
    [ $status = 0 ] || {
        tail -n 30 "$log" >&2
        fail "on $suite the step \"$name\" failed; the end of $log is above"
    }
}

# ---- steps ----

make_bare() {
    local mirror part=$roots/part
    mirror=$(apt-get indextargets --format '$(LABEL) $(REPO_URI)' 'Created-By: Packages' |
        sed -n 's/^Debian //p' | head -n 1)
    # debootstrap does not read apt's settings.
    eval "$(apt-config shell http_proxy Acquire::http::Proxy)"
    [ -z "${http_proxy-}" ] || export http_proxy
    rm -rf "$part"
    debootstrap --variant=minbase "$suite" "$part" "${mirror:-http://deb.debian.org/debian}"
    apt-config dump | grep -E '^Acquire::(https?|Check|Allow|Retries)' \
        >"$part/etc/apt/apt.conf.d/90host"
    mv "$part" "$roots/bare"
}

install_packages() {
    [ -d "$roots/full" ] || {
        rm -rf "$roots/part"
        cp -a "$roots/bare" "$roots/part"
        mv "$roots/part" "$roots/full"
    }
    rm -rf "$roots/full/hdrig"
    mkdir "$roots/full/hdrig"
    git archive HEAD | tar -x -C "$roots/full/hdrig"
    in_root full 'dpkg --configure -a
        command -v make || { apt-get update && apt-get install -y make; }
        make -C /hdrig deps-check'
}

# The tool says its version and what the machine has; the daemon reads its settings,
# and its group exists.
install_package() {
    rm -rf "$roots/try"
    cp -a "$roots/bare" "$roots/try"
    cp "$roots"/full/hdrig/build/hdrig_*_"$(dpkg --print-architecture)".deb "$roots/try/tmp"
    in_root try "apt-get update
        apt-get install -y --no-install-recommends /tmp/hdrig_*.deb
        hdrig --version | grep -Fx 'hdrig $(make -s print-VERSION)'
        hdrig doctor
        hdrigd --check
        getent group hdrig"
}

purge_package() {
    rm "$roots"/try/tmp/hdrig_*.deb
    in_root try 'apt-get purge -y hdrig
        ! dpkg -s hdrig || exit
        left=$(find / -xdev -name "*hdrig*")
        [ -z "$left" ] || { echo "left:" $left; exit 1; }'
}

echo "commit $(git rev-parse --short HEAD) in $roots"
[ -d "$roots/bare" ] || step debootstrap make_bare
step "packages" install_packages
step "check" in_root full "make -C /hdrig check"
grep ' passed, ' "build/log/distro_${suite}_check.log"
step "deb" in_root full "make -C /hdrig -s WERROR=1 deb"
step "arm64" in_root full "cd /hdrig
    make -s -j$(nproc) WERROR=1 CROSS=aarch64-linux-gnu- deb
    tests/arm/package.sh build/hdrig_*_arm64.deb build/sysroot-arm64"
step "install" install_package
step "purge" purge_package
rm -rf "$roots/try"
echo "$suite: all as expected, $SECONDS s"
