#!/usr/bin/env bash
# run.sh FOLDER [TEST...] - runs tests/kernel/guest/TEST.sh, by default all, each in its own User
# Mode Linux with virtual time; FOLDER has the programs built from tests/kernel/*.c.
# One line per test; its log is build/log/kernel_TEST.log, whose end is shown when the test fails.
set -u
cd "$(dirname "$0")/../.."
root=$PWD
bin=$root/$1
shift
limit=${LIMIT:-600} # seconds of the machine, for one that hangs
made=$(tests/kernel/build.sh) || exit 1
[ $# -gt 0 ] || set -- $(cd tests/kernel/guest && ls ./*.sh | sed 's/^\.\/\(.*\)\.sh$/\1/' |
    grep -vx init)
passed=0 failed=0
mkdir -p build/log build/kernel

# The guest's memory is a file; on a disk it would be written back all the time.
memory=$root/build/kernel
[ "$(df -Pm /dev/shm 2>/dev/null | awk 'NR == 2 { print $4 }')" -gt 600 ] 2>/dev/null &&
    memory=/dev/shm

for test in "$@"; do
    log=build/log/kernel_$test.log start=$SECONDS
    printf '%-52s' "kernel: $test"
    TMPDIR=$memory timeout -k 5 "$limit" "$made/linux" mem=512M time-travel=inf-cpu \
        time-travel-start=1700000000000000000 rootfstype=hostfs rootflags=/ ro \
        init="$root/tests/kernel/guest/init.sh" con=null con0=null,fd:1 quiet loglevel=3 \
        TEST="$root/tests/kernel/guest/$test.sh" BIN="$bin" MODULES="$made" \
        </dev/null 2>&1 | tr -d '\r' >"$log"
    if grep -qx 'TEST_EXIT 0' "$log"; then
        passed=$((passed + 1))
        printf 'ok %5d s\n' $((SECONDS - start))
    else
        failed=$((failed + 1))
        printf 'FAILED\n'
        tail -n 60 "$log" | sed 's/^/    /'
    fi
done
echo "$passed passed, $failed failed"
[ "$failed" -eq 0 ]
