# A headless Chromium for the scripts of this folder, driven through its debugging pipe: messages of
# JSON that end with a zero byte. It needs OUT of common.bash.
no_browser() {
    if apt-get -qq --simulate install chromium >/dev/null 2>&1; then
        echo "no chromium: make deps-check installs it"
        exit 1
    fi
    echo "SKIPPED: there is no browser, and none can be installed here"
    exit 0
}

browser_open() { # width height px [arguments for the browser]...
    local program
    size="$1 $2 ${scale:-1} ${mobile:-false}"
    program=$(command -v chromium || command -v chromium-browser) || no_browser
    shift 2
    mkfifo "$OUT/to" "$OUT/from"
    "$program" --headless=new --no-sandbox --disable-dev-shm-usage \
        --user-data-dir="$OUT/browser" --remote-debugging-pipe "$@" \
        3<"$OUT/to" 4>"$OUT/from" >/dev/null 2>"$OUT/browser.txt" &
    browser=$!
    exec 5>"$OUT/to" 6<"$OUT/from"
    id=0 session=
    call Target.createTarget '{"url":"about:blank"}'
    call Target.attachToTarget "{\"targetId\":\"$(field targetId)\",\"flatten\":true}"
    session=$(field sessionId)
    resize $size
}

resize() { # width height px-of-the-device-for-one mobile
    call Emulation.setDeviceMetricsOverride "{\"width\":$1,\"height\":$2,
        \"deviceScaleFactor\":$3,\"mobile\":$4}"
}

browser_close() {
    exec 5>&- 6<&-
    kill $browser 2>/dev/null
    wait $browser 2>/dev/null
    rm -rf "$OUT/browser" "$OUT/to" "$OUT/from"
}

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

# The value of an expression in the page, also one that it promises.
value() {
    call Runtime.evaluate "{\"expression\":\"Promise.resolve(($1)).then(String)\",
        \"awaitPromise\":true}"
    field value
}

wait_for() { # expression value
    for _ in $(seq 300); do
        [ "$(value "$1")" = "$2" ] && return
        sleep 0.1
    done
    fail "$1 is \"$(value "$1")\", not \"$2\""
}

open_address() { # address
    call Page.navigate "{\"url\":\"$1\"}"
}

# ---- hands ----

mouse() { # type x y buttons [more]
    call Input.dispatchMouseEvent \
        "{\"type\":\"$1\",\"x\":$2,\"y\":$3,\"buttons\":$4,\"button\":\"${6:-left}\"${5:-}}"
}

drag() { # x y x y [button number [more]]
    mouse mousePressed "$1" "$2" "${6:-1}" ',"clickCount":1'"${7:-}" "${5:-left}"
    mouse mouseMoved "$3" "$4" "${6:-1}" "${7:-}" "${5:-left}"
    mouse mouseReleased "$3" "$4" 0 ',"clickCount":1'"${7:-}" "${5:-left}"
}

click() { # x y
    mouse mousePressed "$1" "$2" 1 ',"clickCount":1'
    mouse mouseReleased "$1" "$2" 0 ',"clickCount":1'
}

wheel() { # x y way
    mouse mouseWheel "$1" "$2" 0 ",\"deltaX\":0,\"deltaY\":$3"
}

press() { # key
    local text=
    [ ${#1} -gt 1 ] || text=",\"text\":\"$1\"" # other keys have none
    call Input.dispatchKeyEvent "{\"type\":\"keyDown\",\"key\":\"$1\"$text}"
    call Input.dispatchKeyEvent "{\"type\":\"keyUp\",\"key\":\"$1\"}"
}

touch() { # type points
    call Input.dispatchTouchEvent "{\"type\":\"$1\",\"touchPoints\":[$2]}"
}

swipe() { # x y x y
    touch touchStart "{\"x\":$1,\"y\":$2}"
    touch touchMove "{\"x\":$3,\"y\":$4}"
    touch touchEnd ''
}

screenshot() { # file
    call Page.captureScreenshot '{"format":"png","captureBeyondViewport":true}'
    field data | base64 -d >"$1"
    [ -s "$1" ] || fail "no screenshot $1"
}

# $OUT/hdrig.conf of a daemon with one simulated camera, which listens at SOCKET and PORT.
page_settings() {
    SOCKET=$(mktemp -d)/control
    PORT=$((20000 + $$ % 20000))
    printf '%s\n' "store.path = $OUT/store" "results.path = $OUT/results" "job.run = 0" \
        "control.socket = $SOCKET" "http.port = $PORT" "store.reserve_mb = 1" \
        "camera.1 = sim:kind=room,seed=5,size=56,samples=1,fps=50" >"$OUT/hdrig.conf"
}
