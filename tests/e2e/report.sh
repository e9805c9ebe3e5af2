#!/usr/bin/env bash
# report.html in a browser, from the disk: every section is there, its figures are those of
# report.json, nothing is loaded or forbidden; for all kinds of photographs and scenes.
. tests/e2e/common.bash
. tests/e2e/browser.bash
. tests/e2e/axe.bash
tiny=tests/data/ckpt
succeed convert "$tiny/tiny.ckpt" --config "$tiny/tiny.json" --precision int8 \
    --out "$OUT/int8.hdrig"
"$BIN/make_set" "$OUT/many" 64 16 1 one || exit 1
make_set brackets 64 4 1

flat() { # folder exposure value name...: grey pictures of these names
    local dir=$OUT/$1 exposure=$2 value=$3 comma=
    shift 3
    mkdir "$dir"
    for name; do
        "$BIN/make_flat" "$dir/$name.png" 64 "$value" || exit 1
        printf '%s"%s.png": %s\n' "${comma:-"{"}" "${name//\"/\\\"}" "$exposure"
        comma=,
    done >"$dir/exposure.json"
    echo '}' >>"$dir/exposure.json"
}
flat black 1 0 a b
flat white 1 255 a b
flat named 1 100 '<script>alert(1)<!--' 'quo"te' $'\xc3\xb6ffnung \xe2\x82\xac'

modelled() { # name arguments...
    local name=$1
    shift
    succeed reconstruct --size 56 --out "$OUT/$name-scene" "$@"
    cp "$OUT/$name-scene/report.html" "$OUT/$name.html"
}
guess=(--model "$OUT/int8.hdrig" --set cameras.polish=0 --set start.stereo=0)
modelled room --images tests/data/room --rig none --model none --size 112 --refine 20
modelled forward --images tests/data/room --model "$OUT/int8.hdrig" --refine 0
modelled many --images "$OUT/many" --refine 2
modelled brackets --images "$OUT/brackets" --refine 2
for name in black white named; do
    modelled $name --images "$OUT/$name" "${guess[@]}" --refine 2
done
succeed eval --data tests/data/room --rig none --scene "$OUT/room-scene" --out "$OUT/measured-scene"
cp "$OUT/measured-scene/report.html" "$OUT/measured.html"

# what a page may not do, to see that the checks below would tell
sed 's|<main|<img src="http://localhost:9/x.png"><script>document.title = "bad"</script><main|' \
    "$OUT/room.html" >"$OUT/bad.html"

sed 's|"viewer": "view.html"|"viewer": null|' "$OUT/room.html" >"$OUT/unseen.html"

mobile=true browser_open 360 740 --disable-gpu
call Page.enable '{}'
call Page.addScriptToEvaluateOnNewDocument '{"source":"window.problems = [];
    addEventListener(\"error\", (e) => problems.push(e.message || \"not loaded\"), true);
    addEventListener(\"securitypolicyviolation\", (e) => problems.push(e.violatedDirective));
    console.error = (...words) => problems.push(words.join());"}'

show() { # name
    call Page.navigate "{\"url\":\"file://$(realpath "$OUT")/$1.html\"}"
    wait_for "document.URL.endsWith('/$1.html') && document.readyState" complete
}

data="JSON.parse(document.getElementById('data').textContent)"
# Figures on the page that are not those of its data, as far as they have digits.
differ="(() => { const data = $data;
    return [...document.querySelectorAll('[data-key]')].filter((e) => {
        const v = e.dataset.key.split('.').reduce((o, k) => o[k], data), words = e.textContent;
        const text = words.replaceAll(',', '').replace('\\u2212', '-');
        const scale = text.endsWith('%') ? 100 : text.endsWith('ms') ? 1000 : 1;
        const digits = (text.split('.')[1] || '').split(' ')[0].length;
        return v === null ? words !== 'not known' : words === '< 0.1 %' ? !(v > 0 && v < 0.0005)
            : !(Math.abs(parseFloat(text) - v * scale) <= 0.51 * 10 ** -digits);
    }).map((e) => e.dataset.key).join(); })()"
differ=${differ//$'\n'/ }

is() { # what expression value
    local got
    got=$(value "$2")
    [ "$got" = "$3" ] || fail "$1 is \"$got\", not \"$3\""
}

check() { # name sections
    show "$1"
    is "$1: problems" "problems.join()" ""
    is "$1: loaded" "performance.getEntriesByType('resource').length" 0
    is "$1: sections" "[...document.querySelectorAll('section')].map((s) => s.id).join(' ')" "$2"
    is "$1: figures that differ" "$differ" ""
    at_least "$1: minus screens of a telephone" \
        "$(value "-document.documentElement.scrollHeight / innerHeight")" -3.5
    value "openAll()" >/dev/null
    is "$1: words on words" "$meet" 0
    is "$1: axes without titles" "$bare" false
    is "$1: wider than a telephone" "document.documentElement.scrollWidth <= innerWidth" true
    is "$1: pictures that fail" \
        "[...document.images].filter((i) => !i.complete || !i.naturalWidth).length" 0
    is "$1: words that are none" \
        "/NaN|undefined|Infinity|object Object/.test(document.body.innerText)" false
    is "$1: drawings that are none" \
        "[...document.querySelectorAll('svg')].some((s) => s.innerHTML.includes('NaN'))" false
}

# Words in drawings that lie on one another.
meet="[...document.querySelectorAll('svg')].reduce((all, s) => {
    const boxes = [...s.querySelectorAll('text')].map((t) => t.getBoundingClientRect());
    return all + boxes.filter((a, i) => boxes.slice(i + 1).some((b) => a.left < b.right - 1 &&
        b.left < a.right - 1 && a.top < b.bottom - 2 && b.top < a.bottom - 2)).length; }, 0)"
meet=${meet//$'\n'/ }

bare="[...document.querySelectorAll('.chart')].some((s) => !s.querySelector('[transform]'))"

shown() { # name key member-of-an-object, or "" for one at the top
    local file=$OUT/$1-scene/report.json want
    want=$(number "$file" "${2%.*}" "${2##*.}")
    [ "$2" != "${2%.*}" ] || want=$(sed -n "s/^  \"$2\": \\([-0-9.e+]*\\).*/\\1/p" "$file")
    is "$1: $2 of its data" "${data}.$2" "$want"
    is "$1: $2 on the page" "document.querySelectorAll('[data-key=\\\"$2\\\"]').length > 0" true
}

show bad
is "forbidden things" "problems.sort().join()" "img-src,not loaded,script-src-elem"
is "title of the bad page" "document.title" "Scan report"

before="verdict warnings photographs exposures cameras tone"
after="modelled cost"
check room "$before residuals $after"
for key in gaussians quality.ldr_input_psnr quality.held_out_psnr seconds.total peak_rss_mb; do
    shown room $key
done
is "photographs" "document.querySelectorAll('#photographs .card').length" 9
is "strips" "document.querySelectorAll('#residuals img').length" 9
is "bars of exposures" "document.querySelectorAll('#exposures .bar').length" 3
is "cameras drawn" "document.querySelectorAll('#cameras .dot').length" 18
is "numbers of cameras" "[...new Set([...document.querySelectorAll('#photographs h3 small')]
    .map((e) => e.textContent))].sort().join('')" 123456789
is "curves" "document.querySelectorAll('#tone .curve, #tone .family').length" 9
is "the worst first" "[...document.querySelectorAll('#residuals [data-key]')]
    .map((e) => parseFloat(e.textContent)).every((x, i, v) => !i || v[i - 1] <= x)" true
is "how the cameras were found" \
    "document.getElementById('cameras').textContent.includes('observations agree')" true
is "warnings of a good scene" "document.querySelectorAll('.warnings li').length" \
    "$(sed -n '/"warnings": \[/,/\]/p' "$OUT/room-scene/report.json" | grep -c '^    "')"
is "address of the scene" "document.querySelector('#summary a').getAttribute('href')" view.html
screenshot "$OUT/page.png"
accessible "report"
show unseen
is "address of a scene that is not there" "document.querySelector('#summary a')" null

is "the short sentence" "/^(Good|Usable|Rough)/.test(
    document.querySelector('#verdict strong').textContent)" true
is "questions" "document.querySelectorAll('#verdict h3').length" 3

check forward "$before residuals $after"
is "a forward pass" "document.getElementById('modelled').textContent.includes('single pass')" true
check measured "$before measured $after"
is "what was measured" "document.querySelectorAll('#measured tr').length > 3" true
check many "$before residuals $after"
is "photographs" "document.querySelectorAll('#photographs .card').length" 16
is "photographs behind a click" "document.querySelectorAll('#photographs details details').length" 0
is "those behind a click" "document.querySelectorAll('#residuals details details img').length" 4
check brackets "$before residuals $after"
is "photographs of brackets" "document.querySelectorAll('#photographs .card').length" \
    "$(sed -n 's/^  "photographs": \([0-9]*\).*/\1/p' "$OUT/brackets-scene/report.json")"
accessible "report of brackets"
is "places of brackets" "document.querySelectorAll('#cameras .dot').length" 8

for name in black white named; do
    check $name "$before residuals $after"
    is "$name: one exposure" \
        "document.querySelector('.warnings').textContent.includes('have one exposure')" true
done
show black
is "advice" "document.querySelector('#verdict ul').textContent.length > 20" true
all="document.querySelector('.warnings').textContent.includes('100 % of the pixels are"
is "black" "$all dark')" true
show white
is "white" "$all clipped')" true
show named
is "names" "[...document.querySelectorAll('#photographs h3')].map((e) => e.lastChild.data)
    .join('|').replace(String.fromCharCode(34), 'Q') ===
    '<script>alert(1)<!--.png|quoQte.png|\\u00f6ffnung \\u20ac.png'" true
browser_close
finish
