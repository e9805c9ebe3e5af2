#!/usr/bin/env bash
# Pictures of takes on the status page: it loads small ones, and shows takes that have none.
. tests/e2e/common.bash
. tests/e2e/browser.bash
. tests/e2e/axe.bash
page_settings

is() { # expression value
    [ "$(value "$1")" = "$2" ] || fail "$1 is \"$(value "$1")\", not \"$2\""
}

take() { # cameras exposures: its folder is in $take
    take=$OUT/store/$("$BIN/make_take" "$OUT/store" "$1" "$2" 640 480 | sed 's/ .*//')
    [ -f "$take/manifest.json" ] || fail "no take of $1 cameras"
}

start() { # a daemon and its page
    "${HDRIG%/*}/hdrigd" --config "$OUT/hdrig.conf" 2>"$OUT/hdrigd.txt" &
    daemon=$!
    for _ in $(seq 300); do
        [ -S "$SOCKET" ] && break
        sleep 0.1
    done
    open_address "http://localhost:$PORT/"
}

stop() {
    kill -TERM $daemon
    wait $daemon || fail "the daemon ends with $?"
}
scale=2 mobile=true browser_open 360 740 --disable-gpu

# the sheet of a take of 8 cameras, and a take of one
take 1 3
take 8 3
start
sizes="[...document.querySelectorAll('#captures img')].map((i) => i.naturalWidth + ' x ' +
    i.naturalHeight).join()"
loaded="performance.getEntriesByType('resource').filter((r) => /captures/.test(r.name))"
small=256\ x\ 192
wait_for "$sizes" "$(printf ",$small%.0s" {1..11} | cut -c 2-)"
is "$loaded.length" 11
is "$loaded.filter((r) => !/thumbs.train_0._0.\\\\.jpg$/.test(r.name)).length" 0
bytes=$(value "$loaded.reduce((n, r) => n + r.encodedBodySize, 0)")
at_least "bytes of 11 pictures" "$bytes" 11000
at_least "minus the bytes of 11 pictures" "-$bytes" -110000
echo "11 pictures: $bytes bytes"
is "document.documentElement.scrollWidth <= innerWidth" true
screenshot "$OUT/sheet.png"
accessible "a sheet"

# each leads to the whole picture
whole="document.querySelector('#captures .sheet a').href"
is "fetch($whole).then((r) => r.blob()).then((b) => b.type + (b.size > 100000))" image/pngtrue
is "$whole.endsWith(document.querySelector('#captures .sheet img').alt)" true

# what is no thumbnail is not served
ln -s ../manifest.json "$take/thumbs/link.jpg"
mkdir "$take/thumbs/folder.jpg"
for name in '' link.jpg folder.jpg train_00_09.jpg train_00_00.png train_00_00.jpg/ .hidden %00 \
    ../manifest.json %2e%2e/manifest.json train_00_00.jpg/../../manifest.json; do
    code=$(curl -s -o "$OUT/answer" -w '%{http_code}' --path-as-is \
        "http://localhost:$PORT/captures/${take##*/}/thumbs/$name")
    [ "$code" = 404 ] || fail "thumbs/$name: $code"
done
rm -r "$take/thumbs/link.jpg" "$take/thumbs/folder.jpg"
stop

# a take that lost some, and one of before there were any: the pictures themselves are shown
rm "$take"/thumbs/train_0[0-3]_*
for thumb in "$take"/thumbs/train_0[45]_*; do
    echo damaged >"$thumb"
done
"$BIN/verify_take" "$take" || fail "the take depends on its thumbnails"
old=$(echo "$OUT"/store/*-000001)
rm -r "$old/thumbs"
sed -i '/"thumbs\//d' "$old/manifest.json"
"$BIN/verify_take" "$old" || fail "a take of before is not accepted"
start
whole=640\ x\ 480
wait_for "$sizes" \
    "$(printf ",$whole%.0s" {1..6} | cut -c 2-),$small,$small,$whole,$whole,$whole"
stop
browser_close
rm -rf "${SOCKET%/*}"
finish
