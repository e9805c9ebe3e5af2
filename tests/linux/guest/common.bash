# Sourced by the tests of this folder. A test is a script that exits with 0 on success; its
# output may depend on nothing but virtual time. BIN has the programs of tests/linux.
set -euo pipefail

fail() {
    echo "FAILED: $*" >&2
    exit 1
}

# sleep without a process, of which User Mode Linux starts some hundred a second.
[ -p /run/nap ] || mkfifo /run/nap
exec 9<>/run/nap
nap() { # seconds
    read -r -t "$1" -u 9 || true
}

load() { # module [parameter=value]...
    modprobe -d "$MODULES" "$@" || fail "module $1 does not load"
}

unload() {
    modprobe -d "$MODULES" -r "$@" || fail "module $1 stays"
}

# Wait for a condition, 10 s of virtual time at most.
await() { # what command...
    local what=$1 i
    shift
    for ((i = 0; i < 1000; i++)); do
        if "$@" 2>/dev/null; then
            return
        fi
        nap 0.01
    done
    fail "no $what within 10 s"
}

expect() { # what got wanted
    [ "$2" = "$3" ] || fail "$1: got '$2', wanted '$3'"
    echo "$1: $2"
}

between() { # what got least most
    { [ "$2" -ge "$3" ] && [ "$2" -le "$4" ]; } || fail "$1: $2, not $3..$4"
}

# probe_camera STATUS URI OPERATION...: what camera_probe tells is printed and in the file `seen`.
probe_camera() {
    local rc=0 wanted=$1 uri=$2
    shift 2
    "$BIN/camera_probe" "$uri" "$@" >seen || rc=$?
    cat seen
    [ $rc = "$wanted" ] || fail "the probe ended with $rc, not $wanted"
}

# The fewest that a process has open within a second: some come and go.
descriptors() { # process
    local i files fewest=1000
    for ((i = 0; i < 50; i++)); do
        files=("/proc/$1/fd"/*)
        [ ${#files[@]} -ge $fewest ] || fewest=${#files[@]}
        nap 0.02
    done
    echo $fewest
}

# Settings of a daemon that takes brackets of three here and makes no scenes, and more on stdin: in
# the file hdrig.conf.
write_settings() {
    cat - >hdrig.conf <(printf '%s\n' "bracket.mode = list" "bracket.ev = -2 0 2" \
        "bracket.middle_us = 3000" "store.path = $PWD/store" "store.reserve_mb = 1" \
        "calibration.path = $PWD/calibration" "results.path = $PWD/results" "job.run = 0" \
        "control.socket = $PWD/control" "http.port = 0")
}

# Lines of `seen` with a pattern.
count() {
    grep -c -- "$1" seen || true
}
