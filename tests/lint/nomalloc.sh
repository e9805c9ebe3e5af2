#!/bin/sh
# In core only arenas and pools ask the system for memory.
nm -A -u "$1/libcore.a" | awk '
$NF ~ /^(([mc]|re|aligned_)alloc|reallocarray|posix_memalign|strn?dup|v?asprintf|free)$/ {
    seen++
    if ($1 !~ /:(arena|pool)\.o:/) {
        print $1 " uses " $NF
        bad = 1
    }
}
END { if (!seen) print "arena.o not found"; exit bad || !seen }'
