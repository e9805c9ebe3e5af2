#!/usr/bin/env bash
# check.sh lint|test|check|long - builds and runs the tests that need no hardware.
#   lint   the lints and cppcheck
#   test   after a change: unit tests but the longest, kernels, golden data, a few commands; 2 min
#   check  before a commit: that, lints, faults, nearly all commands; drivers, store, daemon and
#          fuzz corpora under ASan and UBSan; warnings of clang; 10 minutes from a fresh clone
#   long   what check leaves out: the rest under ASan and UBSan, threads under TSan, emulated Arm,
#          slow commands; more random takes, brackets and calls; the package for arm64
# Tests run JOBS at a time (all cores), for LIMIT seconds at most. One line per test; its output is
# build/log/NAME.log and is shown at the end when it fails, before the slowest ten.
# A script in tests/e2e runs from the root with HDRIG (the tool), BIN (the folder of the programs
# built from tests/e2e/*.c) and OUT (an empty folder).
set -u
cd "$(dirname "$0")/.."
unset MAKEFLAGS MAKELEVEL
jobs=${JOBS:-$(nproc)}
limit=${LIMIT:-900}
results=build/log/results queue=build/log/queue

# Sanitizers of gcc 12 do not know the random address layout of newer kernels.
fixed=
setarch -R true 2>/dev/null && fixed='setarch -R'
# In the frames of this check gcc 14 aligns vectors of 64 bytes to 32 (its bug 110027).
export ASAN_OPTIONS=detect_stack_use_after_return=0

# ---- one step ----

step() { # name command...
    local name=$1 log=build/log/${1//[^a-zA-Z0-9_.-]/_}.log start=$SECONDS end=ok took
    shift
    "$@" >"$log" 2>&1 </dev/null &
    trap "kill $! 2>/dev/null; exit 130" INT TERM
    wait $! || end=FAILED
    took=$((SECONDS - start))
    printf '%-60s %-6s %4d s\n' "$name" $end $took
    sed -n 's/^not checked: /    &/p' "$log"
    echo "$took $end $name" >>$results
}

build() { # name make-arguments...
    local name=$1
    shift
    step "build: $name" make -s -j"$jobs" "$@"
}

# ---- tests wait in a queue ----

later() { # name command...
    local name=$1
    shift
    printf '%s\t%s\n' "$name" "$*" >>$queue
}

run_queue() {
    xargs -a $queue -d '\n' -P "$jobs" -n 1 "$0" one
    : >$queue
}

one() { # a line of the queue
    local command
    read -r -a command <<<"${1#*$'\t'}"
    step "${1%%$'\t'*}" timeout "$limit" "${command[@]}"
}

tests() { # source-folder...
    local dir source name
    dir=$(make -s print-B WERROR=1)
    for source in $(find "${@/#/tests/}" -name '*_test.c' | sort); do
        name=$(basename "$source" .c)
        case " $without " in *" $name "*) continue ;; esac
        later "plain: $name" "$dir/${source%.c}"
    done
}

scripts() { # folder-of-the-build script...
    local dir=$1 script out
    shift
    for script in "$@"; do
        out=build/e2e/$(basename "$script" .sh)
        rm -rf "$out" && mkdir -p "$out"
        later "e2e: $(basename "$script")" env HDRIG="$dir/hdrig" BIN="$dir/tests/e2e" OUT="$out" \
            "$script"
    done
}

# ---- what there is to run ----

smoke='bad_input capture formats golden quality'
# Ten seconds and more each: `test` goes without them.
without=
longest='plan_test selfcal_test session_focus_test session_random_test session_start_test'
# Half a minute and more each, and other tests look at the same code: these wait for `long`.
slow='boards bracket_scene budget lens network page_rig rig selftest shapes simulated size tags'
slow+=' masks browsers light view view_tools walk'
is_slow() { # name of a script
    case " $slow " in *" $1 "*) ;; *) false ;; esac
}

is_quick() { # the same
    ! is_slow "$1"
}

commands() { # is_slow|is_quick
    local script
    for script in tests/e2e/*.sh; do
        ! "$1" "$(basename "$script" .sh)" || scripts "$(make -s print-B WERROR=1)" "$script"
    done
}

plain() {
    build gcc WERROR=1 all tests
    tests unit kernels golden
}

lints() {
    local dir script
    dir=$(make -s print-B WERROR=1)
    build "libraries for the lints" WERROR=1 all
    for script in tests/lint/*.sh; do
        later "lint: $(basename "$script" .sh)" sh "$script" "$dir"
    done
    # Not asked for: value flow that cppcheck guesses at and compilers and sanitizers know, sizes of
    # vector types, which it does not know, the #error of files that need their own flags, and that
    # it looks at fewer branches.
    later "lint: cppcheck" cppcheck -q --std=c11 -D_GNU_SOURCE -I. --error-exitcode=1 \
        --enable=warning,performance,portability --suppress=shiftTooManyBits \
        --suppress=shiftNegative --suppress=integerOverflow --suppress=arrayIndexThenCheck \
        --suppress=uninitStructMember --suppress=uninitvar --suppress=ctuArrayIndex \
        --suppress=preprocessorErrorDirective --suppress=normalCheckLevelMaxBranches \
        core drivers firmware sim
}

sanitized() { # label edge|inner|tsan sanitizers
    local program
    build "$1, $2" SAN="$3" WERROR=1 "$2-tests"
    for program in $(make -s "print-${2^^}_PROGRAMS" SAN="$3" WERROR=1); do
        later "$1: $(basename "$program")" $fixed "$program"
    done
}

corpora() {
    local dir target name
    build "fuzz targets" SAN=address,undefined WERROR=1 fuzz-targets
    dir=$(make -s print-B SAN=address,undefined WERROR=1)
    for target in tests/fuzz/fuzz_*.c; do
        name=$(basename "$target" .c)
        later "asan: $name" $fixed "$dir/tests/fuzz/$name" tests/fuzz/corpus/"${name#fuzz_}"/*
    done
}

arm() {
    local program name cpu cpus
    [ "$(uname -m)" != aarch64 ] || return
    build "aarch64, core" CROSS=aarch64-linux-gnu- WERROR=1 arm-tests
    for program in $(make -s print-ARM_PROGRAMS CROSS=aarch64-linux-gnu- WERROR=1); do
        name=$(basename "$program")
        cpus=cortex-a76
        case $program in
        # Base NEON alone; with dot products; with int8 matrix products.
        */gemm_test) cpus="cortex-a53 cortex-a76 max" ;;
        # What needs no more than base NEON.
        */kernels/*) cpus=cortex-a53 ;;
        esac
        for cpu in $cpus; do
            later "$cpu: $name" qemu-aarch64 -cpu "$cpu" "$program"
        done
    done
}

arm_package() {
    build "aarch64, package" CROSS=aarch64-linux-gnu- WERROR=1 deb
    later "aarch64: package" tests/arm/package.sh \
        build/hdrig_"$(make -s print-VERSION)"_arm64.deb build/sysroot-arm64
}

finish() {
    local name passed failed
    run_queue
    passed=$(grep -c ' ok ' $results) failed=$(grep -c ' FAILED ' $results)
    grep ' FAILED ' $results | while read -r _ _ name; do
        printf '\n%s:\n' "$name"
        sed 's/^/    /' "build/log/${name//[^a-zA-Z0-9_.-]/_}.log"
    done
    printf '\nslowest: '
    sort -rn $results | head -n 10 |
        awk '{ s = $1; $1 = $2 = ""; printf "%s%s %d s", sep, substr($0, 3), s; sep = ", " }'
    printf '\n%d passed, %d failed, %d s\n' "$passed" "$failed" $SECONDS
    [ "$failed" -eq 0 ]
}

if [ "${1-}" = one ]; then
    one "$2"
    exit
fi
mkdir -p build/log
: >$results
: >$queue
case ${1-} in
lint) lints ;;
test)
    without=$longest
    plain
    scripts "$(make -s print-B WERROR=1)" $(printf 'tests/e2e/%s.sh ' $smoke)
    ;;
check)
    build "gcc, with faults" WERROR=1 all tests fault-tests
    commands is_quick
    plain
    tests fault
    sanitized asan edge address,undefined
    corpora
    build "warnings of clang" CC=clang WERROR=1 CFLAGS=-fsyntax-only objects
    lints
    ;;
long)
    build clang CC=clang WERROR=1 CFLAGS=-O0 all
    build gcc WERROR=1 all tests
    commands is_slow
    dir=$(make -s print-B WERROR=1)
    unit=$dir/tests/unit/firmware/capture
    later "200 takes: session_random_test" env TAKES=200 "$unit/session_random_test"
    later "10140 brackets: bracket_random_test" env TAKES=10140 "$unit/bracket_random_test"
    export CALLS=1000
    scripts "$dir" tests/e2e/bystanders.sh
    sanitized asan inner address,undefined
    sanitized tsan tsan thread
    arm
    arm_package
    ;;
*)
    echo "usage: $0 lint|test|check|long" >&2
    exit 2
    ;;
esac
finish
