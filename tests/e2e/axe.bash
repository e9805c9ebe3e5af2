# Accessibility of the page that browser.bash shows: axe-core, which make deps-check fetches.
AXE=build/axe.min.js
[ -s $AXE ] || echo "not checked: accessibility, for which axe-core could not be fetched"

# accessible NAME: as it is, the page has no serious fault for a desktop in light colours, and none
# for a telephone in dark ones.
accessible() {
    local device script rules="{ 'target-size': { enabled: true } }"
    [ -s $AXE ] || return 0
    if [ "$(value "typeof axe")" = undefined ]; then
        script=$(sed 's/\\/\\\\/g; s/"/\\"/g; s/\x01/\\u0001/g; s/\x02/\\u0002/g; s/$/\\n/' $AXE |
            tr -d '\n')
        call Runtime.evaluate "{\"expression\":\"$script\"}"
    fi
    for device in "light 1280 800 1 false" "dark 360 640 2 true"; do
        call Emulation.setEmulatedMedia "{\"features\":[{\"name\":\"prefers-color-scheme\",
            \"value\":\"${device%% *}\"}]}"
        resize ${device#* }
        value "new Promise((done) => setTimeout(done, 200))" >/dev/null
        found=$(value "axe.run({ rules: $rules }).then((r) => r.violations
            .map((v) => v.impact + ' ' + v.id + ': ' + v.nodes.map((n) => n.target +
            (n.any[0] ? ' (' + n.any[0].message + ')' : '')).join(', ')).join('; ')
            .replaceAll(String.fromCharCode(34), String.fromCharCode(39)))")
        [ -z "$found" ] || echo "$1, $device: $found"
        case $found in *serious* | *critical* | *"no answer"*)
            fail "$1, $device: faults in accessibility"
        esac
    done
    call Emulation.setEmulatedMedia '{"features":[]}'
    resize $size
}
