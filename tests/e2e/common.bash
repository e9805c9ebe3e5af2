# For the scripts of this folder, which run from the repository root with HDRIG (the tool), BIN (the
# folder of make_set) and OUT (an empty folder).
set -u
ERR=$OUT/stderr.txt
failures=0

fail() { # sentence
    echo "FAILED: $*"
    failures=$((failures + 1))
}

finish() {
    [ "$failures" -eq 0 ] || exit 1
    echo "all as expected"
}

# A data set in $OUT/NAME: see make_set.c.
make_set() { # name size train test
    "$BIN/make_set" "$OUT/$1" "$2" "$3" "$4" || exit 1
}

# The tool ends with this code, and says something that matches this extended regular expression.
expect() { # code regex arguments...
    local code=$1 regex=$2 got
    shift 2
    "$HDRIG" "$@" >"$OUT/stdout.txt" 2>"$ERR"
    got=$?
    [ "$got" -eq "$code" ] || fail "hdrig $*: exit $got, expected $code: $(tail -n 1 "$ERR")"
    grep -Eq -e "$regex" "$ERR" || fail "hdrig $*: \"$(tail -n 1 "$ERR")\" does not match $regex"
}

succeed() { # arguments...
    "$HDRIG" "$@" >"$OUT/stdout.txt" 2>"$ERR" || fail "hdrig $*: $(tail -n 1 "$ERR")"
}

# The tool, and Ctrl-C once a line of $ERR begins like that; the exit code is the tool's.
interrupt_at() { # start arguments...
    local start=$1 pid k
    shift
    : >"$ERR" # the former progress must not be taken for the new one
    "$HDRIG" "$@" >"$OUT/stdout.txt" 2>"$ERR" &
    pid=$!
    for ((k = 0; k < 600; k++)); do
        grep -q "^$start" "$ERR" && break
        sleep 0.05
    done
    kill -INT $pid
    wait $pid
}

nothing_at() { # folder: neither a result nor leftovers of one
    [ ! -e "$1" ] || fail "$1 exists"
    local rest
    rest=$(find "$(dirname "$1")" -maxdepth 1 -name ".tmp-$(basename "$1")-*")
    [ -z "$rest" ] || fail "left behind: $rest"
}

# A number from a flat look at JSON: the first member of this name behind the first of that name.
number() { # file object member
    sed -n "/\"$2\": {/,\$p" "$1" | sed -n "s/.*\"$3\": \\([-0-9.e+]*\\).*/\\1/p" | head -n 1
}

at_least() { # what value bound
    awk -v v="$2" -v b="$3" 'BEGIN { exit !(v != "" && v + 0 >= b + 0) }' ||
        fail "$1 is ${2:-missing}, at least $3"
}
