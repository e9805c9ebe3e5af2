#!/bin/sh
# npm.sh NAME@VERSION SHA256 MEMBER OUT - writes a file of a package of npm, from the registry that
# npm is set up for, if the package has that sum. Without a network there is no OUT afterwards, and
# what needs it says so.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
if ! npm pack --loglevel=error --fetch-retries=1 --pack-destination "$work" "$1" \
    >"$work/log" 2>&1; then
    grep -Eq 'ENOTFOUND|EAI_AGAIN|ECONNREFUSED|ENETUNREACH|ETIMEDOUT' "$work/log" || {
        cat "$work/log" >&2
        exit 1
    }
    echo "not fetched, as no registry of npm can be reached: $1"
    exit 0
fi
echo "$2  $(echo "$work"/*.tgz)" | sha256sum --quiet -c || {
    echo "$1 of this registry is not the one that is known here" >&2
    exit 1
}
tar -xzOf "$work"/*.tgz "$3" >"$work/member"
mv "$work/member" "$4"
