# For scripts that look at the page of a scene, with browser.bash. HELP is in every such page: a
# list of what went wrong, pictures as base64, waiting.
read -r -d '' HELP <<'END'
window.errors = [];
for (const kind of ['error', 'unhandledrejection', 'securitypolicyviolation'])
  addEventListener(kind, (e) => errors.push(e.message || e.reason || e.blockedURI));
console.error = console.warn = (...what) => errors.push(what.join(' '));
async function display(view, ev) {
  const c = document.getElementById('view');
  c.style.width = c.style.height = viewer.info.size + 'px';
  viewer.showUnseen(true);
  viewer.go(view);
  viewer.setExposure(ev);
  await viewer.settled();
  viewer.draw();
  return c.toDataURL().split(',')[1];
}
function numbers() {
  const c = document.getElementById('view');
  const bytes = new Uint8Array(viewer.radiance(0, 0, c.width, c.height).buffer);
  return btoa(Array.from(bytes, (v) => String.fromCharCode(v)).join(''));
}
function exactly() {
  const c = document.getElementById('view'), out = new Float32Array(4 * c.width * c.height);
  for (let i = 0; i < c.width * c.height; i++)
    out.set(viewer.exact(i % c.width, Math.floor(i / c.width)), 4 * i);
  return btoa(Array.from(new Uint8Array(out.buffer), (v) => String.fromCharCode(v)).join(''));
}
async function redrawn() {
  const start = performance.now();
  viewer.setCamera(viewer.state.cam);
  await viewer.settled();
  viewer.draw();
  viewer.radiance(0, 0, 1, 1);
  return performance.now() - start;
}
/* Colours of all pixels of the picture as it is shown. */
function shown() {
  const c = document.getElementById('view'), copy = document.createElement('canvas');
  [copy.width, copy.height] = [c.width, c.height];
  const g = copy.getContext('2d');
  viewer.draw();
  g.drawImage(c, 0, 0);
  return g.getImageData(0, 0, c.width, c.height).data;
}
/* Whether the picture is another than at the last call. */
async function changed() {
  await viewer.settled();
  const text = shown().join(), other = text !== window.last;
  window.last = text;
  return other;
}
function middleOf(id) {
  const box = document.getElementById(id).getBoundingClientRect();
  return [box.left + box.width / 2, box.top + box.height / 2].map(Math.round).join(' ');
}
END

# A browser that draws in software.
open_browser() { # width height
    local source
    source=$(sed 's/\\/\\\\/g; s/"/\\"/g' <<<"$HELP" | tr '\n' ' ')
    browser_open "$1" "$2" --use-angle=swiftshader --enable-unsafe-swiftshader \
        --disable-background-networking --disable-component-update --disable-sync --no-first-run
    call Page.enable '{}'
    call Page.addScriptToEvaluateOnNewDocument "{\"source\":\"$source\"}"
}

open_page() { # address
    call Page.navigate "{\"url\":\"$1\"}"
    wait_for "window.viewer && viewer.firstPicture() > 0 && !document.body.className" true
}

told() { # regex: the sentence in the page
    grep -Eq "$1" <<<"$(value "document.getElementById('message').textContent")" ||
        fail "\"$(value "document.getElementById('message').textContent")\" does not match $1"
}

# Nothing was complained about, nothing was loaded but the worker from within.
quiet() { # page
    [ "$(value "errors.join('; ')")" = "" ] || fail "$1: $(value "errors.join('; ')")"
    [ "$(value "document.getElementById('message').hidden")" = true ] ||
        fail "$1: $(value "document.getElementById('message').textContent")"
    loaded=$(value "performance.getEntriesByType('resource').map((r) => r.name).filter((n) =>
        !/^(blob|data):/.test(n)).join(' ')")
    [ "$loaded" = "" ] || fail "$1: $loaded was loaded"
    [ "$(value "document.getElementById('view').getContext('webgl2').getError()")" = 0 ] ||
        fail "$1: an error of WebGL"
}

is() { # expression value
    local got
    got=$(value "$1")
    [ "$got" = "$2" ] || fail "$1 is \"$got\", not \"$2\""
}
