#!/usr/bin/env bash
# Takes with simulated cameras at the extremes: a manifest has the exposures that the simulator
# used, or the tool ends with the reason; nothing half-written is left in either case.
. tests/e2e/common.bash
TAKES=$OUT/takes
FAST=kind=room,size=112,clock=virtual,fps=200 # waits take no time, whatever the machine is doing
INSTANT=kind=room,clock=virtual,fps=1000
MINUTE=longest=60e6
mkdir "$TAKES"

sim() { # name options
    echo "sim:seed=5,samples=1,truth=$OUT/$1.truth,$2"
}

# The tool ends with 0 (and a take) or 1; its messages are in $ERR.
shoot() { # name options arguments...
    local uri
    uri=$(sim "$1" "$2")
    take=$TAKES/$1
    shift 2
    timeout 60 "$HDRIG" capture --camera "$uri" --out "$take" "$@" >"$OUT/stdout.txt" 2>"$ERR"
    code=$?
}

figure() { # key: of the take's manifest, the first
    grep -o "\"$1\": [^,}]*" "$take/manifest.json" | head -n 1 | sed 's/.*: //'
}

frames() { # exposure, proof, sequence, time stamp: a line each
    sed -n 's/.*"raw": .*"exposure_s": \([^,]*\),.*"proof": "\([^"]*\)".*"sequence": \([0-9]*\),.*'\
'"timestamp_ns": "\([0-9]*\)".*/\1 \2 \3 \4/p' "$take/manifest.json"
}

# Every file is as the manifest says, and so is every exposure that it calls proven, within its
# tolerance; with `common` but for a factor that all have.
agrees() { # name [common]
    local said=$OUT/said.txt
    sed -n 's/.*{"name": "\([^"]*\)".*"sha256": "\([0-9a-f]*\)".*/\2  \1/p' \
        "$take/manifest.json" >"$OUT/sums.txt"
    [ -s "$OUT/sums.txt" ] && (cd "$take" && sha256sum --quiet -c -) <"$OUT/sums.txt" ||
        fail "$1: files differ from the manifest"
    frames >"$said"
    awk -v most="$(figure tolerance_stops)" -v common="${2-}" '
        NR == FNR { truth[$1 " " $2] = $4 * $5; next }
        { key = $3 " " $4; off = key in truth ? log($1 / truth[key]) / log(2) : 99 }
        off == 99 { print "a frame that never was: " $0; bad = 1 }
        $2 ~ /^unverified/ { next }
        { lo = n ? (off < lo ? off : lo) : off; hi = n++ ? (off > hi ? off : hi) : off }
        !common && (off > most || off < -most) {
            print "recorded " $1 " s, was " truth[key] " s"; bad = 1
        }
        END {
            if (common && hi - lo > 2 * most) { print "off by " lo " and " hi; bad = 1 }
            exit bad
        }' "$OUT/$1.truth" "$said" >"$OUT/off.txt" || fail "$1: $(head -n 1 "$OUT/off.txt")"
}

unverified() {
    frames | grep -c ' unverified'
}

complete() { # name options arguments...
    shoot "$@"
    if [ $code -ne 0 ]; then
        fail "$1: exit $code: $(tail -n 1 "$ERR")"
    else
        agrees "$1"
    fi
}

# The take is right, or there is none and the sentence says why. factor=common: the light or the
# device changes for all frames alike, which nobody can see.
factor=
honest() { # regex name options arguments...
    local regex=$1
    shift
    shoot "$@"
    if [ $code -eq 0 ]; then
        agrees "$1" "$factor"
    elif [ $code -ne 1 ] || ! tail -n 1 "$ERR" | grep -Eq "^hdrig capture: .*($regex)"; then
        fail "$1: exit $code: \"$(tail -n 1 "$ERR")\" does not match $regex"
    fi
}

refused() { # regex name options arguments...
    local regex=$1
    shift
    shoot "$@"
    [ $code -eq 1 ] || fail "$1: exit $code, expected 1: $(tail -n 1 "$ERR")"
    tail -n 1 "$ERR" | grep -Eq "^hdrig capture: .*($regex)" ||
        fail "$1: \"$(tail -n 1 "$ERR")\" does not match $regex"
    grep -q '100 %.*/0$' "$ERR" && fail "$1: a bracket that was given up counts as complete"
}

exposures() { # seconds...: of the take, within 0.05 stops
    frames | awk -v want="$*" '
        { x = log($1) / log(2); n = split(want, w, " ") }
        NR > n || x - log(w[NR]) / log(2) > 0.05 || x - log(w[NR]) / log(2) < -0.05 { bad = 1 }
        END { exit bad || NR != n }' ||
        fail "${take##*/}: exposures are $(frames | cut -d' ' -f1 | tr '\n' ' '), not $*"
}

ineffective='pictures do not show it'
relit='light or the scene changed'

# ---- exposures from the shortest to 60 s
complete long $INSTANT,size=112,$MINUTE,full=1e8 --bracket -6,-3,0 --middle 60
exposures 0.9375 7.5 60
[ "$(unverified)" -eq 0 ] || fail "long: not proven"
complete short $FAST,full=100,quantum=1 --bracket -9,-5,0 --middle 0.0005
exposures 0.000001 0.000015 0.0005
[ "$(unverified)" -eq 0 ] || fail "short: not proven"
complete wide $INSTANT,size=112,$MINUTE --bracket 10.55,-10.965,0 --middle 0.04
exposures 0.00002 0.04 60
complete nine $INSTANT,size=112 --bracket -4,-3,-2,-1,0,1,2,3,4 --middle 0.004
[ "$(frames | wc -l)" -eq 9 ] || fail "nine: $(frames | wc -l) frames"
complete limits $INSTANT,size=112,longest=1e5 --bracket -4,0,4 --middle 0.05
grep -q 'no exposures as long as some of these' "$ERR" || fail "limits: says nothing of them"

# ---- scenes
complete room $FAST
at_least "room: exposures" "$(frames | wc -l)" 2
awk -v c="$(figure clipped)" -v d="$(figure dark)" 'BEGIN { exit !(c <= 0.001 && d <= 0.01) }' ||
    fail "room: $(figure clipped) clipped, $(figure dark) dark"
complete lamp kind=dark,size=112,clock=virtual,fps=200
awk -v c="$(figure clipped)" 'BEGIN { exit !(c <= 0.001) }' ||
    fail "lamp: $(figure clipped) clipped"
complete black $INSTANT,size=112,full=1e8,longest=1e4 # nothing shows within 10 ms
[ "$(unverified)" -ge 1 ] || fail "black: pixels prove nothing there"
grep -q 'too dark' "$ERR" && grep -q 'not proven by its pixels' "$ERR" ||
    fail "black: $(cat "$ERR")"
complete glare $INSTANT,size=112,full=10,quantum=1000
[ "$(unverified)" -ge 1 ] || fail "glare: pixels prove nothing there"
grep -q 'the scene is too bright for it' "$ERR" || fail "glare: $(cat "$ERR")"
complete rggb kind=room,size=128,clock=virtual,fps=200,format=rggb # extended after a look at it
awk -v d="$(figure dark)" 'BEGIN { exit !(d <= 0.01) }' || fail "rggb: $(figure dark) dark"
complete bggr $INSTANT,size=256,$MINUTE,format=bggr,full=1e8 --bracket -5,0 --middle 60
[ "$(figure tolerance_stops)" = 0.1 ] || fail "a mosaic's numbers are linear"
[ "$(ls "$take/merged")" = 00.exr ] || fail "bggr: not merged"

# ---- troubles
for k in 1 2 3; do
    honest "many frames are lost|$relit" "lost$k" "$FAST,faults=at frame $((k * 7)) lose 0.05"
done
honest "$ineffective|reports an exposure" late $FAST,metadata=late --bracket -4,0,4 --middle 0.004
honest "$ineffective" lagged $FAST,readback=lagged,metadata=absent --bracket -4,0,4 --middle 0.004
honest "$ineffective" changing $FAST,delay=3,claim=1,metadata=absent --bracket -3,0,3 --middle 0.004
refused "$ineffective" ignored "$FAST,faults=at frame 0 ignore 0"
refused "$ineffective|$relit" deaf "$FAST,metadata=absent,faults=at frame 20 ignore 0"
refused "$ineffective" rolls "$FAST,faults=at frame 0 rollover 656"
factor=common
honest "$ineffective|reports" steps "$FAST,faults=at frame 0 quantum 0.003"
honest "$relit" relit "$FAST,metadata=absent,faults=at frame 18 digital 2" \
    --bracket -3,-2,-1,0,1,2,3 --middle 0.004
honest "$relit" twice \
    "$FAST,metadata=absent,faults=at frame 18 digital 2;at frame 40 digital 5" \
    --bracket -3,-2,-1,0,1,2,3 --middle 0.004
honest "$relit|$ineffective" drift "$FAST,faults=at frame 12 gain 1.02"
factor=
refused 'digital gain' digital "$FAST,faults=at frame 3 digital 2"
refused 'unplugged' unplugged "$FAST,faults=at frame 20 unplug"
seq 16 266 | sed 's/.*/at frame & error/' >"$OUT/torn.txt"
refused "lost or damaged" torn "$FAST,faults=$OUT/torn.txt"
refused 'refuses the exposure' busy "$FAST,faults=at frame 14 refuse busy 0"
refused "$ineffective; unless its response curve is an unusual one.*hdrig calibrate" filmic \
    $FAST,curve=filmic
succeed calibrate --camera "$(sim filmic $FAST,curve=filmic)" --longest 0.1 --out "$OUT/calibration"
complete calibrated $FAST,curve=filmic --set calibration.path="$OUT/calibration"
[ "$(figure tolerance_stops)" = 0.1 ] || fail "calibrated: the curve is not used"

# photographs of another program, three exposures 4 stops apart, played again; the curve is theirs
for curve in srgb filmic; do
    succeed simulate --out "$OUT/world_$curve" --seed 3 --views 2 --size 112 --samples 1 \
        --curve $curve
done
succeed capture --camera "replay:$OUT/world_srgb/images,clock=virtual" --out "$OUT/replayed"
replay=replay:$OUT/world_filmic/images,view=1,clock=virtual
expect 1 "$ineffective; unless its response curve" capture --camera "$replay" --out "$OUT/no"
succeed calibrate --camera "$replay" --out "$OUT/calibration"
succeed capture --camera "$replay" --bracket=-4,0,4 --middle 0.25 --out "$OUT/filmic" \
    --set calibration.path="$OUT/calibration"
for k in 0 1 2; do
    read -r _ codes < <("$BIN/compare" display "$OUT/filmic/images/train_00_0$k.png" \
        "$OUT/world_filmic/images/train_ldr_001_$((2 * k)).png")
    [ "$codes" = 0 ] || fail "replayed: photograph $k is off by $codes codes"
done

# ---- bad input
expect 1 'no such|cannot|not there' capture --camera v4l2:/dev/video99 --out "$TAKES/bad"
expect 1 'colour' capture --camera sim:colour=3 --out "$TAKES/bad"
expect 1 'begins with none of' capture --camera webcam:0 --out "$TAKES/bad"
expect 1 'view is 4, must be 0..3' capture --camera sim:views=4,view=4 --out "$TAKES/bad"
expect 1 'room already exists' capture --camera "$(sim bad $FAST)" --out "$TAKES/room"
expect 2 '--out is needed' capture --camera "$(sim bad $FAST)"
expect 2 'go with --camera' capture --out "$TAKES/bad"
expect 1 '--bracket' capture --camera "$(sim bad $FAST)" --out "$TAKES/bad" --bracket 1,x
expect 1 '--bracket' capture --camera "$(sim bad $FAST)" --out "$TAKES/bad" \
    --bracket 0,1,2,3,4,5,6,7,8,9
expect 1 '--middle' capture --camera "$(sim bad $FAST)" --out "$TAKES/bad" --middle 0
expect 1 'there is no folder' capture --camera "$(sim bad $FAST)" --out "$OUT/nowhere/bad"
expect 3 'bytes.* are to stay free, there is room for' capture \
    --camera "$(sim bad $FAST)" --out "$TAKES/bad" --set store.reserve_mb=1048576

# ---- Ctrl-C in an exposure of a minute, which is not waited for
"$HDRIG" capture --camera "$(sim stopped kind=room,size=112,fps=200,$MINUTE)" --out "$TAKES/bad" \
    --bracket 0,0 --middle 60 2>"$ERR" &
pid=$!
for _ in $(seq 300); do
    grep -q '^capture' "$ERR" && break
    sleep 0.1
done
from=$EPOCHREALTIME
kill -INT $pid
wait $pid
code=$?
[ $code -eq 130 ] || fail "Ctrl-C: exit $code: $(tail -n 1 "$ERR")"
at_least "seconds left after Ctrl-C" \
    "$(awk -v a="$from" -v b="$EPOCHREALTIME" 'BEGIN { print 30 - (b - a) }')" 0

# ---- a rig of four, as the reconstruction reads it
rig=()
for view in 0 1 2 3; do
    rig+=(--camera "sim:$FAST,seed=5,samples=1,views=4,view=$view")
done
succeed capture "${rig[@]}" --bracket -4,0,4 --middle 0.004 --out "$TAKES/rig"
[ "$(ls "$TAKES/rig/images" | wc -l)" -eq 12 ] || fail "rig: not twelve pictures"
succeed capture "${rig[@]}" --stagger --bracket -4,0,4 --middle 0.004 --out "$TAKES/staggered"
[ "$(ls "$TAKES/staggered/images" | wc -l)" -eq 4 ] || fail "staggered: not four pictures"
for take in "$TAKES/rig" "$TAKES/staggered"; do
    "$HDRIG" reconstruct --images "$take" --size 112 --refine 0 --out "$OUT/scene" \
        >"$OUT/stdout.txt" 2>"$ERR" ||
        grep -Eq 'cameras cannot be found' "$ERR" || fail "${take##*/}: $(tail -n 1 "$ERR")"
done

# ---- nothing but whole takes
for take in "$TAKES"/* "$TAKES"/.[!.]*; do
    [ -e "$take" ] || continue
    grep -q '"status": "complete"' "$take/manifest.json" || fail "left behind: $take"
done
finish
