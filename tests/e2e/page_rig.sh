#!/usr/bin/env bash
# The rig of several boards on the status page, on a telephone and with 128 boards: the daemon has
# none, the page is told of one.
. tests/e2e/common.bash
. tests/e2e/browser.bash
. tests/e2e/axe.bash
SOCKET=$(mktemp -d)/control
PORT=$((20000 + $$ % 20000))
world="sim:kind=room,seed=5,size=56,samples=1,fps=50,views=5"
printf '%s\n' "store.path = $OUT/store" "results.path = $OUT/results" "job.run = 0" \
    "control.socket = $SOCKET" "http.port = $PORT" "store.reserve_mb = 1" \
    "camera.1 = $world,view=0" "camera.2 = $world,view=1" "camera.3 = $world,view=2" \
    "camera.4 = $world,view=3" "camera.5 = $world,view=4" >"$OUT/hdrig.conf"
"${HDRIG%/*}/hdrigd" --config "$OUT/hdrig.conf" 2>"$OUT/hdrigd.txt" &
daemon=$!
scale=2 mobile=true browser_open 360 740 --disable-gpu
for _ in $(seq 300); do
    [ -S "$SOCKET" ] && break
    sleep 0.1
done

is() { # expression value
    [ "$(value "$1")" = "$2" ] || fail "$1 is \"$(value "$1")\", not \"$2\""
}

run() { # expression, in several lines
    value "$(tr '\n' ' ' <<<"$1")" >/dev/null
}

text() { # selector
    echo "document.querySelector('$1').textContent"
}

fits() { # width
    is "document.documentElement.scrollWidth <= $1" true
    is "Math.max(...[...document.querySelectorAll('#rig :not(thead *)')].map(\
e => e.getBoundingClientRect().right)) <= $1" true
}

call Page.navigate "{\"url\":\"http://localhost:$PORT/\"}"
wait_for "document.getElementById('state').textContent" armed

# without a rig the page is as it was
is "document.getElementById('rig').hidden" true
is "document.getElementById('rig-sentence').hidden" true
is "document.getElementById('capture').disabled" false

# every camera has a picture in the list of captures, the middle exposure
value "document.getElementById('capture').click()" >/dev/null
wait_for "document.querySelectorAll('#captures .sheet img').length" 5
is "[...document.querySelectorAll('#captures .sheet img')].map(i => i.alt.slice(0, 8)).join()" \
    train_00,train_01,train_02,train_03,train_04
is "document.querySelector('#captures .sheet').open" true
wait_for "document.querySelector('#captures img').naturalWidth" 56

# a rig whose boards are not all there
run "(() => { $(sed 's/\\/\\\\/g; s/"/\\"/g' tests/e2e/page_rig.js)
    Object.assign(window, { rigOf, pretend }); pretend(rigOf(8)); })()"
wait_for "document.querySelectorAll('#boards-rows tr').length" 8
is "$(text '#rig-name')" Rig
is "$(text '#rig-state')" 'board-01 leads the rig, 6 of 8 boards ready'
is "$(text '#rig-sentence')" 'board-05 is not there since 754 s'
is "document.getElementById('capture').disabled" true
is "[...document.querySelectorAll('#rig-missing li')].map(e => e.textContent).join('|')" \
    "board-04 is not ready: the disk has 120 MB left, store.reserve_mb is 512|\
board-05 is not there: for 12 minutes"
is "document.querySelectorAll('#rig-takes .parts li').length" 5
is "$(text '#rig-takes .failed')" '1 failed: board-05 (the camera was lost)'
is "$(text '#rig-takes .stored')" '2 stored on the board: board-02, board-07'
is "$(text '#rig-takes p')" 'brings the pictures here: 1 of 8 boards'
is "$(text '#rig-takes .warnings')" "board-05: the camera was lost; 2 of 8 parts are \
there: hdrig rig accept 0123abcd-000017 joins these, hdrig rig forget 0123abcd-000017 gives them up"
is "document.querySelectorAll('#rig-last .start').length" 24
is "document.querySelectorAll('#rig-map .view').length" 8
is "document.querySelectorAll('#rig-map .view.away text')[0].textContent" 'board-05, not there'
is "document.querySelector('#rig-map svg').getAttribute('aria-label')" \
    '8 cameras from above: 6 ready, 1 not ready, 1 not there'
fits 360
screenshot "$OUT/phone.png"

# what screen readers are told: the table stays one, sentences are not spoken again for nothing
call Accessibility.enable '{}'
call Accessibility.getFullAXTree '{}'
for role in table rowheader columnheader cell; do
    grep -q "\"value\":\"$role\"" <<<"$answer" || fail "no $role in the accessibility tree"
done
run "(() => { window.changes = 0; new MutationObserver((all) => changes += all.length).observe(
    document.querySelector('body'), { childList: true, characterData: true, subtree: true }) })()"
run "(() => { const r = document.querySelectorAll('[aria-live], #rig'); window.spoken = 0;
    r.forEach((e) => new MutationObserver((all) => spoken += all.length).observe(e,
        { childList: true, characterData: true, subtree: true })) })()"
wait_for 'changes > 3' true
is spoken 0

# ready
run "pretend({ ...rigOf(4), ready: true, sentence: 'ready', takes: [] }, { state: 'armed' })"
wait_for "document.querySelectorAll('#boards-rows tr').length" 4
is "document.getElementById('capture').disabled" false
is "document.getElementById('rig-takes').hidden" true

# names that are markup, values that are not there
run "(() => { const r = rigOf(2); r.members[0].name = '<b>x</b>'; r.members[1].clock = '';
    r.members[1].free_mb = -1; delete r.last; delete r.views;
    r.takes = [{ id: '', phase: 'metering', reason: 'a < b', parts: [] }]; pretend(r); })()"
wait_for "document.querySelectorAll('#boards-rows tr').length" 2
is "$(text '#boards-rows th')" '<b>x</b>'
is "document.querySelectorAll('#rig b').length" 0
is "$(text '#boards-rows tr:nth-child(2) td:nth-child(5)')" 'not known yet'
is "document.getElementById('rig-last').hidden && document.getElementById('rig-map').hidden" true
is "document.getElementById('cancel').hidden" false

# a member
run "pretend({ role: 'member', name: 'rig', board: 'left', state: 'alone', ready: false,
    sentence: 'no conductor leads the rig' })"
wait_for "$(text '#rig-state')" 'left waits for a conductor'
is "document.getElementById('boards').hidden" true
is "document.getElementById('capture').disabled" true

# 128 boards, on a telephone and on a desk
run "pretend(rigOf(128))"
wait_for "document.querySelectorAll('#boards-rows tr').length" 128
is "document.querySelectorAll('#rig-missing li').length" 6
fits 360
screenshot "$OUT/phone128.png"
call Emulation.setDeviceMetricsOverride \
    '{"width":1200,"height":900,"deviceScaleFactor":1,"mobile":false}'
fits 1200
screenshot "$OUT/desk128.png"
accessible "128 boards"
is "document.getElementById('message').matches('.kept, :empty')" true

kill -TERM $daemon
wait $daemon || fail "the daemon ends with $?"
wait_for "document.getElementById('state').textContent" "no answer"
is "document.getElementById('capture').disabled" true
browser_close
rm -rf "${SOCKET%/*}"
finish
