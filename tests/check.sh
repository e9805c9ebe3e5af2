#!/usr/bin/env bash
# check.sh lint|test|all - builds and runs the tests that need no hardware.
# One line per step; its output goes to build/log/<step>.log and is shown when the step fails.
# A script in tests/e2e runs from the root with HDRIG (the tool), BIN (the folder of the programs
# built from tests/e2e/*.c) and OUT (an empty folder).
set -u
cd "$(dirname "$0")/.."
unset MAKEFLAGS MAKELEVEL
jobs=${JOBS:-$(nproc)}
limit=${LIMIT:-900} # seconds a test may take
passed=0 failed=0

mkdir -p build/log

step() { # name command...
    local name=$1 log=build/log/${1//[^a-zA-Z0-9_.-]/_}.log start=$SECONDS
    shift
    printf '%-52s' "$name"
    if "$@" >"$log" 2>&1 </dev/null; then
        passed=$((passed + 1))
        printf 'ok %5d s\n' $((SECONDS - start))
    else
        failed=$((failed + 1))
        printf 'FAILED\n'
        sed 's/^/    /' "$log"
    fi
}

build() { # name make-arguments...
    local name=$1
    shift
    step "build: $name" make -s -j"$jobs" "$@"
}

# Sanitizers of gcc 12 do not know the random address layout of newer kernels.
fixed=
setarch -R true 2>/dev/null && fixed='setarch -R'

run() { # variant program [arguments]...
    local name
    name="$1: $(basename "$2")"
    shift
    step "$name" $fixed timeout "$limit" "$@"
}

run_tests() { # variant folder-of-the-build source-folder...
    local variant=$1 dir=$2 source
    shift 2
    for source in $(for d in "$@"; do find "tests/$d" -name "*_test.c" | sort 2>/dev/null; done); do
        run "$variant" "$dir/${source%.c}"
    done
}

run_scripts() { # folder-of-the-build
    local script out
    for script in tests/e2e/*.sh; do
        [ -e "$script" ] || continue
        out=build/e2e/$(basename "$script" .sh)
        rm -rf "$out" && mkdir -p "$out"
        step "e2e: $(basename "$script")" env HDRIG="$1/hdrig" BIN="$1/tests/e2e" OUT="$out" \
            timeout "$limit" "$script"
    done
}

plain() {
    local dir
    dir=$(make -s print-B WERROR=1)
    build gcc WERROR=1 all tests fault-tests
    run_tests plain "$dir" unit kernels golden fault
    run_scripts "$dir"
}

lints() {
    local dir script
    dir=$(make -s print-B WERROR=1)
    build "libraries for the lints" WERROR=1 all
    for script in tests/lint/*.sh; do
        step "lint: $(basename "$script" .sh)" sh "$script" "$dir"
    done
    # Not asked for: value flow that cppcheck guesses at and the sanitizers know, sizes of vector
    # types, which it does not know, and the #error of files that need their own flags.
    step "lint: cppcheck" cppcheck -q -j"$jobs" --std=c11 -D_GNU_SOURCE -I. --error-exitcode=1 \
        --enable=warning,performance,portability --suppress=shiftTooManyBits \
        --suppress=shiftNegative --suppress=integerOverflow --suppress=arrayIndexThenCheck \
        --suppress=uninitStructMember --suppress=ctuArrayIndex \
        --suppress=preprocessorErrorDirective core drivers firmware sim
}

sanitizers() {
    local dir target program
    dir=$(make -s print-B SAN=address,undefined WERROR=1)
    build "ASan and UBSan" SAN=address,undefined WERROR=1 tests fuzz-targets
    run_tests asan "$dir" unit kernels golden
    for target in tests/fuzz/fuzz_*.c; do
        program=$(basename "$target" .c)
        run asan "$dir/tests/fuzz/$program" "tests/fuzz/corpus/${program#fuzz_}"/*
    done
    build TSan SAN=thread WERROR=1 tsan-tests
    for program in $(make -s print-TSAN_PROGRAMS SAN=thread WERROR=1); do
        run tsan "$program"
    done
}

arm() {
    local program cpu cpus
    build "aarch64, core" CROSS=aarch64-linux-gnu- WERROR=1 arm-tests
    for program in $(make -s print-ARM_PROGRAMS CROSS=aarch64-linux-gnu- WERROR=1); do
        cpus=cortex-a76
        case $program in
        # Base NEON alone; with dot products; with int8 matrix products.
        */gemm_test) cpus="cortex-a53 cortex-a76 max" ;;
        # What needs no more than base NEON.
        */kernels/*) cpus=cortex-a53 ;;
        esac
        for cpu in $cpus; do
            step "$cpu: $(basename "$program")" timeout "$limit" qemu-aarch64 -cpu "$cpu" "$program"
        done
    done
}

case ${1:-all} in
lint) lints ;;
test) plain ;;
all)
    plain
    lints
    sanitizers
    build clang CC=clang WERROR=1 all tests
    [ "$(uname -m)" = aarch64 ] || arm
    ;;
*)
    echo "usage: $0 lint|test|all" >&2
    exit 2
    ;;
esac

echo "$passed passed, $failed failed"
[ "$failed" -eq 0 ]
