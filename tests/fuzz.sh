#!/usr/bin/env bash
# fuzz.sh SECONDS - runs every libFuzzer target for that time.
# New inputs stay in build/corpus, those that crash a target in build/crash.
set -eu
cd "$(dirname "$0")/.."
dir=$(make -s print-B CC=clang SAN=fuzzer,address,undefined)
mkdir -p build/crash
for source in tests/fuzz/fuzz_*.c; do
    name=$(basename "$source" .c)
    corpus=build/corpus/${name#fuzz_}
    mkdir -p "$corpus"
    echo "$name for $1 s"
    "$dir/tests/fuzz/$name" -max_total_time="$1" -artifact_prefix=build/crash/ \
        "$corpus" "tests/fuzz/corpus/${name#fuzz_}"
done
