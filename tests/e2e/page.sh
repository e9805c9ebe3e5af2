#!/usr/bin/env bash
# The status page in a browser: what it shows, its button, on the screen of a telephone. The browser
# is driven through its debugging pipe: messages of JSON that end with a zero byte.
. tests/e2e/common.bash
BROWSER=$(command -v chromium || command -v chromium-browser) || { echo "no chromium"; exit 1; }
SOCKET=$(mktemp -d)/control
PORT=$((20000 + $$ % 20000))
printf '%s\n' "store.path = $OUT/store" "results.path = $OUT/results" "job.run = 0" \
    "control.socket = $SOCKET" "http.port = $PORT" "store.reserve_mb = 1" \
    "camera.1 = sim:kind=room,seed=5,size=56,samples=1,fps=50" >"$OUT/hdrig.conf"
"${HDRIG%/*}/hdrigd" --config "$OUT/hdrig.conf" 2>"$OUT/hdrigd.txt" &
daemon=$!
mkfifo "$OUT/to" "$OUT/from"
"$BROWSER" --headless=new --no-sandbox --disable-gpu --disable-dev-shm-usage \
    --user-data-dir="$OUT/browser" --remote-debugging-pipe \
    3<"$OUT/to" 4>"$OUT/from" >/dev/null 2>"$OUT/browser.txt" &
browser=$!
exec 5>"$OUT/to" 6<"$OUT/from"
id=0 session=

# call METHOD PARAMS: the answer is in $answer
call() {
    id=$((id + 1))
    printf '{"id":%d,"method":"%s","params":%s%s}\0' $id "$1" "$2" \
        "${session:+,\"sessionId\":\"$session\"}" >&5
    while IFS= read -r -d '' -t 60 answer <&6; do
        case $answer in '{"id":'$id,*) return ;; esac
    done
    fail "the browser does not answer $1"
    exit 1
}

field() { # name, of the answer
    sed "s/.*\"$1\":\"\\([^\"]*\\)\".*/\\1/" <<<"$answer"
}

# The value of an expression in the page.
value() {
    call Runtime.evaluate "{\"expression\":\"String($1)\",\"awaitPromise\":true}"
    field value
}

wait_for() { # expression value
    for _ in $(seq 100); do
        [ "$(value "$1")" = "$2" ] && return
        sleep 0.1
    done
    fail "$1 is \"$(value "$1")\", not \"$2\""
}

call Target.createTarget '{"url":"about:blank"}'
call Target.attachToTarget "{\"targetId\":\"$(field targetId)\",\"flatten\":true}"
session=$(field sessionId)
call Emulation.setDeviceMetricsOverride \
    '{"width":360,"height":740,"deviceScaleFactor":2,"mobile":true}'
for _ in $(seq 50); do
    [ -S "$SOCKET" ] && break
    sleep 0.1
done
call Page.navigate "{\"url\":\"http://localhost:$PORT/\"}"
wait_for "document.getElementById('state').textContent" armed
[ "$(value 'document.title')" = hdrig ] || fail "the title is $(value 'document.title')"
wait_for "document.querySelectorAll('#cameras canvas').length" 1
[ "$(value 'document.documentElement.scrollWidth <= innerWidth')" = true ] ||
    fail "the page is wider than a telephone: $(value 'document.documentElement.scrollWidth')"
[ "$(value "document.getElementById('capture').getBoundingClientRect().height >= 44")" = true ] ||
    fail "the button is too small for a thumb"

# the button
value "document.getElementById('capture').click()" >/dev/null
wait_for "document.querySelectorAll('#captures .card').length" 1
wait_for "document.getElementById('state').textContent" armed
wait_for "document.querySelector('#captures img').complete" true
[ "$(value "document.querySelector('#captures img').naturalWidth")" = 56 ] || fail "no picture"
[ "$(value "document.querySelector('#captures a').textContent")" = manifest ] || fail "no link"
[ "$(value "document.getElementById('message').textContent")" = "" ] ||
    fail "the page complains: $(value "document.getElementById('message').textContent")"
call Page.captureScreenshot '{"format":"png","captureBeyondViewport":true}'
field data | base64 -d >"$OUT/page.png"
[ -s "$OUT/page.png" ] || fail "no screenshot"

# nobody there any more
kill -TERM $daemon
wait $daemon || fail "the daemon ends with $?"
wait_for "document.getElementById('state').textContent" "no answer"
[ "$(value "document.getElementById('capture').disabled")" = true ] || fail "the button still works"
exec 5>&- 6<&-
kill $browser 2>/dev/null
wait $browser 2>/dev/null
rm -rf "${SOCKET%/*}" "$OUT/browser"
finish
