#!/usr/bin/env bash
# run.sh FOLDER [TEST...] - runs tests/linux/guest/TEST.sh, by default all, each in a kernel of its
# own, whose time is virtual unless the script says otherwise ("# Real time"): User Mode Linux, or,
# where that cannot be built or does not run, Debian's kernel under QEMU, whose clock counts
# instructions. BENCH=uml or BENCH=qemu chooses one. FOLDER has the programs built from
# tests/linux/*.c.
# Settings of a test come from the environment: those of tests/rig.
# One line per test: seconds of the machine, and of one processor. Its log is
# build/log/kernel_TEST.log, whose end is shown when the test fails.
set -u
cd "$(dirname "$0")/../.."
root=$PWD
bin=$root/$1
shift
limit=${LIMIT:-1200} # seconds of the machine, for one that hangs
guest=$root/tests/linux/guest
[ $# -gt 0 ] || set -- $(cd "$guest" && ls ./*.sh | sed 's/^\.\/\(.*\)\.sh$/\1/' | grep -vx init)
jobs=${JOBS:-$(nproc)} TIMEFORMAT=%U
mkdir -p build/log build/kernel

# The guest's memory is a file; on a disk it would be written back all the time.
memory=$root/build/kernel
[ "$(df -Pm /dev/shm 2>/dev/null | awk 'NR == 2 { print $4 }')" -gt $((600 * jobs)) ] 2>/dev/null &&
    memory=/dev/shm

# QEMU's time is always virtual.
is_real_time() { # script
    [ "$bench" = uml ] && grep -q '^# Real time' "$1"
}

# Words of the command line, which are the environment of the first process.
settings=()
for name in MEMBERS TAKES FAULTS FPS SIZE LINK RATE SKEW SEED; do
    [ -z "${!name-}" ] || settings+=("$name=\"${!name}\"")
done

boot_uml() { # script parameters-of-the-kernel
    local time="time-travel=inf-cpu time-travel-start=1700000000000000000"
    local mb=$((512 + 24 * ${MEMBERS:-0})) # a board takes 21 MB
    ! is_real_time "$1" || time=
    shift
    TMPDIR=$memory timeout -k 5 "$limit" "$made/linux" mem=${mb}M $time \
        rootfstype=hostfs rootflags=/ ro init="$guest/init.sh" con=null con0=null,fd:1 "$@"
}

# An instruction takes 1 ns, a wait nothing.
boot_qemu() { # script parameters-of-the-kernel
    shift
    timeout -k 5 "$limit" qemu-system-x86_64 -M q35 -accel tcg,thread=single -cpu Nehalem -m 1G \
        -icount shift=0,sleep=off -rtc base=2023-11-14,clock=vm -nodefaults -no-user-config \
        -display none -serial stdio -monitor none -no-reboot \
        -kernel "$made/vmlinux" -initrd build/kernel/initramfs \
        -append "console=ttyS0 panic=-1 tsc=reliable nokaslr mitigations=off $*"
}

boot() { # bench script
    "boot_$1" "$2" quiet loglevel=3 BENCH="$1" TEST="$2" BIN="$bin" MODULES="$made" \
        "${settings[@]}" </dev/null 2>&1 | tr -d '\r'
}

# Whether that bench is here and boots.
try() { # bench
    bench=$1
    case $bench in
    uml) made=$(tests/linux/uml.sh) || return ;;
    qemu)
        make -s deps-qemu >&2 && made=$(tests/linux/qemu.sh) &&
            tests/linux/initramfs.sh build/kernel/initramfs "$bin" "$made" || return
        ;;
    *) echo "BENCH=$bench: neither uml nor qemu" >&2 && return 1 ;;
    esac
    boot "$bench" /dev/null >build/log/kernel_boot.log
    grep -qx 'TEST_EXIT 0' build/log/kernel_boot.log && return
    echo "kernel for the tests: $bench does not boot: build/log/kernel_boot.log" >&2
    return 1
}

if [ -n "${BENCH:-}" ]; then
    try "$BENCH" || exit
elif ! try uml; then
    echo "no User Mode Linux here, QEMU in its place"
    try qemu || exit
fi
echo "kernels under $bench: ${made##*/}"

# Whether the kernel fell over itself, as User Mode Linux does now and then when a signal reaches
# its own code; the end of the first process is another panic.
is_crash() { # log
    grep 'Kernel panic - not syncing: ' "$1" | grep -qv 'Attempted to kill init'
}

# In real time User Mode Linux does not always boot, and may hang then; such a test takes 20 s.
run_test() { # name; 1 when it fails
    local script=$guest/$1.sh log=build/log/kernel_$1.log start=$SECONDS limit=$limit cpu i why
    ! is_real_time "$script" || limit=150
    for i in 1 2 3; do
        cpu=$({ time boot "$bench" "$script" >"$log"; } 2>&1)
        if is_crash "$log"; then
            why="the kernel crashes"
        elif is_real_time "$script" && ! grep -qx 'TEST_BEGIN' "$log"; then
            why="it does not boot"
        else
            break
        fi
        echo "kernel: $1: $why ($i of 3)"
    done
    if grep -qx 'TEST_EXIT 0' "$log"; then
        printf '%-52sok %5d s %5.0f s\n' "kernel: $1" $((SECONDS - start)) "$cpu"
        sed -n 's/^skipped: /    &/p' "$log"
    else
        printf '%-52sFAILED\n' "kernel: $1"
        tail -n 60 "$log" | sed 's/^/    /'
        return 1
    fi
}

# As many at a time as there are processors; one of real time runs alone.
failed=0 running=0
end_down_to() { # tests that still run
    while [ $running -gt "$1" ]; do
        wait -n || failed=$((failed + 1))
        running=$((running - 1))
    done
}
for test in "$@"; do
    least=$((jobs - 1))
    ! is_real_time "$guest/$test.sh" || least=0
    end_down_to $least
    run_test "$test" &
    running=$((running + 1))
    [ $least -gt 0 ] || end_down_to 0
done
end_down_to 0
echo "$(($# - failed)) passed, $failed failed"
[ "$failed" -eq 0 ]
