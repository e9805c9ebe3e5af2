# Sourced by uml.sh and qemu.sh. Kernels are made once per version of Debian's packages and of the
# files here, and kept in $XDG_CACHE_HOME/hdrig, so that other checkouts on the machine find them.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cache=${XDG_CACHE_HOME:-$HOME/.cache}/hdrig
log=$cache/build.log

fail() {
    echo "kernel for the tests: $*" >&2
    exit 1
}

mkdir -p "$cache"
exec 9>"$cache/lock"
flock 9

key() { # file...
    (cd "$here" && cat cache.bash "$@") | sha256sum | cut -c 1-12
}

# An empty folder to build in, and the current one from now on; gone at the end.
begin_work() { # MB
    local free
    free=$(df -Pk "$cache" | awk 'NR == 2 { print int($4 / 1024) }')
    [ "$free" -ge "$1" ] || fail "$cache has $free MB left, the build needs $1"
    work=$cache/.build
    rm -rf "$work" && mkdir -p "$work"
    trap 'rm -rf "$work"' EXIT
    cd "$work"
    unset MAKEFLAGS MAKELEVEL MFLAGS
}

unpack() { # package
    # As root apt would download as another user, who may not write here.
    apt-get -q -o APT::Sandbox::User=root download "$1" >"$log" 2>&1 ||
        fail "cannot download $1: $(tail -n 1 "$log")"
    dpkg -x "$1"_*.deb .
    rm "$1"_*.deb
}

# What is in the folder `made` from now on is kept under this name, which is printed.
keep() { # path
    rm -rf "$1"
    mv "$work/made" "$1"
    echo "$1"
}
