#!/bin/sh
# Every header compiles alone and has the guard DIR_FILE_H.
# Headers of a library's stand-in are C++ and have the names of that library.
# NAME_body.h is no interface: it has functions that are compiled once per instruction set.
bad=0
headers=$(find core drivers firmware sim tests -name '*.h' ! -name '*_body.h' \
    ! -path 'tests/unit/drivers/device/fakecamera/libcamera/*' 2>/dev/null | sort)
for h in $headers; do
    guard=$(basename "$(dirname "$h")")_$(basename "$h" .h)_H
    guard=$(echo "$guard" | tr 'a-z-' 'A-Z_')
    if ! grep -qx "#ifndef $guard" "$h" || ! grep -qx "#define $guard" "$h"; then
        echo "$h: guard is not $guard"
        bad=1
    fi
    echo "#include \"$h\"" |
        gcc -std=c11 -D_GNU_SOURCE -Wall -Wextra -Werror -Wno-unused-function -I. -fsyntax-only \
            -x c - || bad=1
done
exit $bad
