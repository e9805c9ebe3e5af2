#!/usr/bin/env bash
# The status page in a browser: its contents, its buttons, and its layout on a telephone.
. tests/e2e/common.bash
. tests/e2e/browser.bash
. tests/e2e/axe.bash
page_settings
"${HDRIG%/*}/hdrigd" --config "$OUT/hdrig.conf" 2>"$OUT/hdrigd.txt" &
daemon=$!
scale=2 mobile=true browser_open 360 740 --disable-gpu
for _ in $(seq 300); do
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

# what it sees, and what a press does
live="document.querySelector('#cameras img.live')"
value "document.getElementById('live').checked || document.getElementById('live').click()" \
    >/dev/null
wait_for "$live && $live.naturalWidth" 28
wait_for "!$live.hidden" true
grep -q '^A press measures the light .*, and adds them to the session as a place\.$' \
    <<<"$(value "document.getElementById('press').textContent")" ||
    fail "a press: $(value "document.getElementById('press').textContent")"
screenshot "$OUT/live.png"
value "document.getElementById('live').click()" >/dev/null
wait_for "$live" null

# the button
value "document.getElementById('capture').click()" >/dev/null
wait_for "document.querySelectorAll('#captures .card').length" 1
wait_for "document.getElementById('state').textContent" armed
wait_for "document.querySelector('#captures img').complete" true
[ "$(value "document.querySelector('#captures img').naturalWidth")" = 56 ] || fail "no picture"
[ "$(value "document.querySelector('#captures a').textContent")" = manifest ] || fail "no link"
grep -Eq '^[0-9a-f]{8}-000001 is kept: [0-9]+ frames\.$' \
    <<<"$(value "document.querySelector('#message.kept').textContent")" ||
    fail "the outcome: $(value "document.getElementById('message').textContent")"

# a rig of one camera collects places
text="document.getElementById('places').textContent"
wait_for "$text" "1 place so far"
[ "$(value "/place of session/.test(document.querySelector('#captures .card').textContent)")" = \
    true ] || fail "the capture's card does not tell its session"
[ "$(value "document.getElementById('session').hidden")" = false ] || fail "the session is hidden"
screenshot "$OUT/page.png"
accessible "an armed rig"
value "document.getElementById('session-scene').click()" >/dev/null
wait_for "document.getElementById('message').textContent" \
    "1 place so far, a scene needs at least 2"
value "document.getElementById('session-end').click()" >/dev/null
wait_for "$text" "ended with 1 place: no scene, which needs at least 2"
wait_for "document.getElementById('session-end').disabled" true

# a scene with warnings says so
take=$(basename "$(find "$OUT/store" -maxdepth 1 -name '*-000001')")
mkdir -p "$OUT/results/$take"
echo '{"warnings": ["a", "b"]}' >"$OUT/results/$take/report.json"
wait_for "document.querySelector('#captures a.warnings').textContent" "2 warnings"
succeed status --set "control.socket=$SOCKET"
grep -q "$take: .*scene with 2 warnings" "$OUT/stdout.txt" ||
    fail "status: $(cat "$OUT/stdout.txt")"

# nobody there any more
kill -TERM $daemon
wait $daemon || fail "the daemon ends with $?"
wait_for "document.getElementById('state').textContent" "no answer"
[ "$(value "document.getElementById('capture').disabled")" = true ] || fail "the button still works"
accessible "no answer"
browser_close
rm -rf "${SOCKET%/*}"
finish
