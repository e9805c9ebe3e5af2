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
    local program size="$1 $2"
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
    call Emulation.setDeviceMetricsOverride "{\"width\":${size% *},\"height\":${size#* },
        \"deviceScaleFactor\":${scale:-1},\"mobile\":${mobile:-false}}"
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

screenshot() { # file
    call Page.captureScreenshot '{"format":"png","captureBeyondViewport":true}'
    field data | base64 -d >"$1"
    [ -s "$1" ] || fail "no screenshot $1"
}
