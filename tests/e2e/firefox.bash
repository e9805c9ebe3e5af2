# Firefox in place of the Chromium of browser.bash, driven through Marionette, the protocol that
# Firefox has built in: length:[0,number,command,parameters]. Its screen is Xvfb: without one it has
# no WebGL. It needs OUT of common.bash. Scripts see what belongs to the window, not what others
# declare with let and const.
browser_open() { # width height
    local port
    browser= screen=
    mkdir "$OUT/firefox"
    printf 'user_pref("%s", %s);\n' marionette.port 0 webgl.force-enabled true \
        browser.shell.checkDefaultBrowser false datareporting.policy.dataSubmissionEnabled false \
        >"$OUT/firefox/user.js"
    Xvfb -screen 0 1280x1024x24 -displayfd 7 7>"$OUT/display" 2>/dev/null &
    screen=$!
    wait_for_file "$OUT/display"
    DISPLAY=:$(cat "$OUT/display") firefox-esr --marionette --no-remote \
        --profile "$OUT/firefox" about:blank >/dev/null 2>"$OUT/firefox.txt" &
    browser=$!
    wait_for_file "$OUT/firefox/MarionetteActivePort"
    port=$(cat "$OUT/firefox/MarionetteActivePort")
    exec 5<>"/dev/tcp/127.0.0.1/$port"
    id=0
    receive
    call WebDriver:NewSession '{}'
    call WebDriver:SetWindowRect "{\"width\":$1,\"height\":$2}"
}

wait_for_file() {
    for _ in $(seq 600); do
        [ -s "$1" ] && return
        sleep 0.1
    done
    fail "there is no $1"
    browser_close
    exit 1
}

browser_close() {
    exec 5>&-
    kill $browser $screen 2>/dev/null
    wait $browser $screen 2>/dev/null
    rm -rf "$OUT/firefox"
}

receive() { # the next message is in $answer
    local LC_ALL=C length
    IFS= read -r -d : -t 60 length <&5 && IFS= read -r -N "$length" -t 60 answer <&5 && return
    fail "Firefox does not answer"
    exit 1
}

call() { # COMMAND PARAMS: the answer is in $answer
    local LC_ALL=C message
    id=$((id + 1))
    message="[0,$id,\"$1\",$2]"
    printf '%d:%s' ${#message} "$message" >&5
    receive
    case $answer in *'"error":"'*)
        fail "Firefox refuses $1: $(cut -c 1-300 <<<"$answer")"
    esac
}

open_address() { # address
    call WebDriver:Navigate "{\"url\":\"$1\"}"
}

value() { # expression
    call WebDriver:ExecuteScript "{\"args\":[],
        \"script\":\"return Promise.resolve((${1//$'\n'/ })).then(String)\"}"
    sed 's/.*"value":"\([^"]*\)".*/\1/' <<<"$answer"
}

act() { # kind [parameters] actions
    call WebDriver:PerformActions "{\"actions\":[{\"type\":\"$1\",\"id\":\"$1$2\"$3,
        \"actions\":[$4]}]}"
    call WebDriver:ReleaseActions '{}'
}

pointer() { # mouse|touch x y x y
    act pointer "$1" ",\"parameters\":{\"pointerType\":\"$1\"}" \
        "{\"type\":\"pointerMove\",\"x\":$2,\"y\":$3},{\"type\":\"pointerDown\",\"button\":0},
        {\"type\":\"pointerMove\",\"x\":$4,\"y\":$5,\"duration\":50},
        {\"type\":\"pointerUp\",\"button\":0}"
}

drag() { # x y x y
    pointer mouse "$@"
}

swipe() { # x y x y
    pointer touch "$@"
}

wheel() { # x y way
    act wheel "" "" "{\"type\":\"scroll\",\"x\":$1,\"y\":$2,\"deltaX\":0,\"deltaY\":$3}"
}

press() { # key
    act key "" "" "{\"type\":\"keyDown\",\"value\":\"$1\"},{\"type\":\"keyUp\",\"value\":\"$1\"}"
}

screenshot() { # file
    call WebDriver:TakeScreenshot '{"full":false}'
    sed 's/.*"value":"\([^"]*\)".*/\1/' <<<"$answer" | base64 -d >"$1"
    [ -s "$1" ] || fail "no screenshot $1"
}
