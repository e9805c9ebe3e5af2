#!/usr/bin/env bash
# The training of the small network: the same graph in PyTorch as in C, every stage learns, resumes
# from its checkpoint with the same weights, and exports a model, with the completion branch. Needs
# PyTorch 2.2 or newer for $PYTHON (python3) and what `make all libsim` builds.
. tests/e2e/common.bash
export PYTHONDONTWRITEBYTECODE=1 # the folder of the sources stays clean
python=${PYTHON:-python3} small=tests/data/room
"$python" -c 'import numpy, torch' 2>"$OUT/torch.txt" || {
    echo "$python: $(tail -n 1 "$OUT/torch.txt"); PYTHON=... names one with PyTorch" >&2
    exit 1
}

script() { # name arguments...: of sim/train, its words in $OUT/stdout.txt
    "$python" "sim/train/$1.py" "${@:2}" >"$OUT/stdout.txt" 2>"$OUT/stderr.txt" ||
        fail "$*: $(tail -n 3 "$OUT/stderr.txt")$(grep differs "$OUT/stdout.txt")"
}

quick=(--scenes "$OUT/scenes" --tokens 200 --sizes 112 --val 2 --val-size 112 --least 2 --every 1
    --threads 1 --float)

train() { # folder stage steps options...
    script train "$2" --out "$OUT/$1" --steps "$3" "${quick[@]}" "${@:4}"
    grep -Eq 'loss (nan|inf)|norm (nan|inf)' "$OUT/stdout.txt" &&
        fail "$2: $(cat "$OUT/stdout.txt")"
}

script parity
script data "$OUT/scenes" --first 0 --count 2 --boxes 0 --size 112
script data "$OUT/scenes" --first 1000000 --count 2 --boxes 0 --size 112
script data "$OUT/stereo" --stereo --first 10000000 --count 2 --stride 15
script data "$OUT/stereo" --stereo --first 20000200 --count 1
for stage in geometry appearance render complete; do
    options=()
    [ $stage = complete ] && options=(--scenes "$OUT/stereo" --val 1)
    train one $stage 2 "${options[@]}"
    grep -q 'validation .* step 2 ' "$OUT/stdout.txt" || fail "$stage: not validated"
    train one $stage 4 "${options[@]}"
    grep -q 'continues at step 2' "$OUT/stdout.txt" || fail "$stage: does not go on"
done
train other geometry 2
cp "$OUT/other/geometry.safetensors" "$OUT/first.safetensors"
rm -r "$OUT/other"
train other geometry 2
cmp "$OUT/first.safetensors" "$OUT/other/geometry.safetensors" ||
    fail "other weights the second time"

# stopped by a signal: the step in hand is kept
"$python" sim/train/train.py geometry --out "$OUT/one" --steps 100000 "${quick[@]}" \
    >"$OUT/stdout.txt" 2>&1 &
until grep -q 'step 6 ' "$OUT/stdout.txt" || ! kill -0 $! 2>/dev/null; do sleep 0.2; done
kill -TERM $! && wait $! || fail "stopped training: $(tail -n 3 "$OUT/stdout.txt")"
train one geometry 20
step=$(sed -n 's/continues at step //p' "$OUT/stdout.txt")
[ "${step:-0}" -ge 6 ] || fail "after the signal: step \"$step\""

script export "$OUT/one/render.ckpt" "$OUT/model.safetensors" \
    --complete "$OUT/one/complete.safetensors"
succeed convert "$OUT/model.safetensors" --config "$OUT/model.json" --out "$OUT/model.hdrig"
succeed reconstruct --images $small --size 112 --model "$OUT/model.hdrig" --refine 0 \
    --out "$OUT/scene"

# from the model that ships: its completion branch stays as it is
train more geometry 1 --init sim/train/small.safetensors
train more appearance 1
script export "$OUT/more/appearance.ckpt" "$OUT/more.safetensors" --bf16
succeed convert "$OUT/more.safetensors" --config "$OUT/more.json" --out "$OUT/more.hdrig"
"$python" - sim/train/small.safetensors "$OUT/more.safetensors" <<'END' || fail "another branch"
import sys
sys.path.append("sim/train")
import export
old, new = (export.read_tensors(path) for path in sys.argv[1:])
same = [old[k].equal(new[k]) for k in old if k.startswith("encoder.complete.")]
sys.exit(not (same and all(same)))
END
finish
