#!/usr/bin/env bash
# The commands of README.md run as printed, in their order, and give the promised results. Stand-ins
# replace photographs, the released checkpoint (a tiny one), LPIPS of VGG16 (AlexNet of numbers),
# cameras of /dev (simulated), sudo, systemctl and the browser; make only prints its commands.
# Settings keep sizes small.
. tests/e2e/common.bash
readme=$PWD/README.md root=$PWD tool=$(realpath "$HDRIG") tiny=$PWD/tests/data/ckpt
sandbox=$(realpath "$OUT")/sandbox bin=$(realpath "$OUT")/bin
socket=$(mktemp -d)/control # a socket's path is short
pids=$sandbox/../pids
mkdir -p "$sandbox/build" "$sandbox/photos" "$bin"
: >"$pids"

stop_daemon() {
    while read -r pid; do
        kill "$pid"
        tail --pid="$pid" -f /dev/null
    done <"$pids"
    : >"$pids"
}
trap stop_daemon EXIT

echo '{"model": {"lpips": "alexnet"}}' >"$sandbox/alexnet.json"
stand_in() { # path: its text on stdin
    { echo '#!/usr/bin/env bash' && cat; } >"$1"
    chmod +x "$1"
}
# After the name of the command, and the files that may follow it.
stand_in "$sandbox/build/hdrig" <<END
command=\$1
shift
case \$command in
convert) case "\$*" in
    *--lpips*) set -- --hashed 1 --config "$sandbox/alexnet.json" --out "\${@: -1}" ;;
    *) set -- "\$@" --config "$tiny/tiny.json" ;;
    esac ;;
simulate) set -- "\$@" --samples 1 ;;
bench) set -- "\$@" --gaussians 1000 --size 56 ;;
esac
files=()
while [[ \$# -gt 0 && \$1 != -* ]]; do files+=("\$1") && shift; done
exec "$tool" "\$command" "\${files[@]}" --set size=112 --set refine.steps=10 \\
    --set control.socket="$socket" --set calibration.path="$sandbox/calibration" \\
    "\${@/v4l2:\/dev\/video0/sim:kind=room,seed=5,size=56,samples=1,fps=100,clock=virtual}"
END
ln -s "$sandbox/build/hdrig" "$bin/hdrig"
stand_in "$sandbox/build/hdrigd" <<END
"${tool}d" "\$@" 2>>"$sandbox/../daemon.txt" &
echo \$! >>"$pids"
for _ in {1..600}; do
    "$tool" status --set control.socket="$socket" 2>&1 | grep -q '^armed' && exit
    sleep 0.1
done
exit 1
END
stand_in "$bin/sudo" <<<'exec "$@"'
stand_in "$bin/systemctl" <<END
[ "\$1 \$2" = "enable --now" ] && [ -f "$root/board/common/\$3.service" ] &&
    exec "$sandbox/build/\$3" --config FILE
END
stand_in "$bin/make" <<END
unset MAKEFLAGS MAKELEVEL MFLAGS
exec "$(command -v make)" -C "$root" -n "\$@"
END
stand_in "$bin/xdg-open" <<<'[ -f "$1" ]'
cat >"$sandbox/FILE" <<END
camera.1 = sim:kind=room,seed=5,size=56,samples=1,fps=100,clock=virtual
calibration.path = $sandbox/calibration
store.path = $sandbox/captures
results.path = $sandbox/results
store.reserve_mb = 1
job.run = 0
http.port = 0
control.socket = $socket
END
cp "$tiny/tiny.ckpt" "$sandbox/InstantHDR.ckpt"
echo localhost >"$sandbox/hosts"
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 # CI is root

# the photographs and their exposures are those of the example
sed -n '/^    {$/,/^    }$/p' "$readme" >"$sandbox/photos/exposure.json"
i=0
for name in $(sed -n 's/^ *"\([^"]*\)": .*/\1/p' "$sandbox/photos/exposure.json"); do
    cp tests/data/room/images/train_ldr_00$i"_"?.png "$sandbox/photos/$name"
    i=$((i + 1))
done
at_least "photographs in the example" $i 4
for take in take1 take2; do # of a rig
    cp -r tests/data/room "$sandbox/$take"
done

commands=0
while IFS= read -r line; do
    commands=$((commands + 1))
    case $line in *--config\ FILE*) [[ $line != *hdrigd* ]] || stop_daemon ;; esac
    (cd "$sandbox" && PATH=$bin:$PATH BROWSER=xdg-open timeout 120 bash -c "$line") \
        >"$OUT/stdout.txt" 2>"$ERR" </dev/null || fail "$line: $(tail -n 1 "$ERR")"
    for made in $(grep -o -e '--\(out\|video\|json\) [^ ]*' <<<"$line" | sed 's/.* //'); do
        [ -e "$sandbox/$made" ] || fail "$line: no $made"
    done
done < <(sed -n 's/^    \([a-z].*\)/\1/p' "$readme")
at_least "commands in README.md" $commands 20
[ -s "$sandbox/scene/view.html" ] || fail "the example made no page"
[ -n "$(ls "$sandbox/captures")" ] || fail "hdrig capture took nothing"

# every option that the text names exists
for command in $("$HDRIG" --help | sed -n 's/^  \([a-z-]*\) .*/\1/p'); do
    "$HDRIG" "$command" --help
done >"$OUT/help.txt"
for command in $("$HDRIG" rig --help | sed -n 's/^  \([a-z]*\) .*/\1/p'); do
    "$HDRIG" rig "$command" --help
done >>"$OUT/help.txt"
for option in $(grep -o -e '[`(: ]--[a-z][a-z-]*' "$readme" | tr -d '`(: ' | sort -u); do
    # of systemctl, mpirun
    case $option in --now | --hostfile | --map-by | --bind-to) continue ;; esac
    grep -q -e "$option" "$OUT/help.txt" || fail "README.md: no $option"
done
version=$(make -s print-VERSION)
"$HDRIG" --version | grep -qx "hdrig $version" || fail "hdrig --version is not that of the Makefile"
"${HDRIG}d" --version | grep -qx "hdrigd $version" || fail "hdrigd --version"
env -u MAKEFLAGS make -n demo >"$OUT/stdout.txt" 2>&1
grep -q -e '-s -j[0-9]* all' "$OUT/stdout.txt" || fail "make demo builds on one core"
finish
