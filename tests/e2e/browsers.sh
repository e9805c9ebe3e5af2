#!/usr/bin/env bash
# The page of a scene in Chromium and in Firefox, both drawing in software: a person drags, turns
# the wheel, touches, presses keys, moves the slider; each time the picture changes, nothing is
# complained about, and both browsers show the same cameras in the same way.
. tests/e2e/common.bash
. tests/e2e/browser.bash
. tests/e2e/view.bash
"$BIN/make_view" "$OUT/walls" walls 3000 || exit 1

# The page gets what view.bash has for it before its own scripts.
printf '<script>\n%s\n</script>\n' "$HELP" >"$OUT/help.html"
sed "/<meta charset/r $OUT/help.html" "$OUT/walls/view.html" >"$OUT/page.html"

after() { # what was done
    [ "$(value "changed()")" = true ] || fail "$browser_name: $1 does not change the picture"
}

told_nothing() {
    [ "$(value "document.getElementById('message').hidden")" = true ] && return
    fail "$browser_name: $(value "document.getElementById('message').textContent")"
    browser_close
    finish
}

visit() {
    local x y
    browser_open 800 600 "$@"
    open_address "file://$(realpath "$OUT")/page.html"
    wait_for "window.viewer && (viewer.firstPicture() > 0 ||
        !document.getElementById('message').hidden)" true
    told_nothing
    value "changed()" >/dev/null
    drag 400 200 460 230
    after "a drag"
    wheel 400 200 -240
    after "the wheel"
    press .
    after "a key"
    swipe 400 200 450 200
    after "a finger"
    read -r x y <<<"$(value "middleOf('ev')")"
    drag "$x" "$y" $((x + 60)) "$y"
    after "the slider"
    [ "$(value "viewer.state.ev > 1")" = true ] ||
        fail "$browser_name: the slider leads to $(value "viewer.state.ev")"
    press 3
    after "false colours"
    read -r x y <<<"$(value "middleOf('light')")"
    drag "$x" "$y" "$x" "$y"
    wait_for "/median .* stops/.test(document.getElementById('spread').textContent)" true
    press 1
    for picture in "0 0" "1 -6" "2 3"; do
        value "display(${picture/ /, })" | base64 -d >"$OUT/$browser_name ${picture}.png"
    done
    [ -z "$(value "errors.join('; ')")" ] || fail "$browser_name: $(value "errors.join('; ')")"
    screenshot "$OUT/$browser_name.png"
    browser_close
}

browser_name=chromium
visit --use-angle=swiftshader --enable-unsafe-swiftshader
command -v firefox-esr >/dev/null && command -v Xvfb >/dev/null || {
    echo "not checked: Firefox, as it or Xvfb is not installed"
    finish
    exit
}
. tests/e2e/firefox.bash
browser_name=firefox
visit
for picture in "0 0" "1 -6" "2 3"; do
    read -r psnr codes < <("$BIN/compare" display "$OUT/chromium $picture.png" \
        "$OUT/firefox $picture.png")
    at_least "view and exposure $picture in both browsers: PSNR" "$psnr" 40
    echo "view and exposure $picture in both browsers: $psnr dB, at most $codes"
done
finish
