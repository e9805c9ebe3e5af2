#!/bin/sh
# Every symbol that leaves a file starts with the file's name and '_'; for op_ISA.c, with op_; for
# the two versions of a library, with the name that both share.
for lib in core drivers sim firmware; do
    nm -A -g --defined-only "$1/lib$lib.a" 2>/dev/null
done | awk '
{
    n = split($1, part, ":")
    file = part[n - 1] != "" ? part[n - 1] : part[n]
    sub(/\.o$/, "", file)
    prefix = file
    sub(/_(c|sse41|avx2|avx512|avx512vnni|amx|neon|neondot|i8mm)$/, "", prefix)
    sub(/gpiod[12]$/, "gpiod", prefix)
    seen++
    if ($NF != prefix && index($NF, prefix "_") != 1) {
        print file ".c: " $NF " does not start with " prefix "_"
        bad = 1
    }
}
END { if (!seen) print "no symbols found"; exit bad || !seen }'
