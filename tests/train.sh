#!/usr/bin/env bash
# The training of the small network: the same graph in PyTorch as in C, every stage learns, resumes
# from its checkpoint with the same weights, and exports a model. Needs
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

train() { # folder stage steps
    script train "$2" --out "$OUT/$1" --steps "$3" "${quick[@]}"
    grep -Eq 'loss (nan|inf)|norm (nan|inf)' "$OUT/stdout.txt" &&
        fail "$2: $(cat "$OUT/stdout.txt")"
}

script parity
script data "$OUT/scenes" --first 0 --count 2 --boxes 0 --size 112
script data "$OUT/scenes" --first 1000000 --count 2 --boxes 0 --size 112
for stage in geometry appearance render; do
    train one $stage 2
    grep -q 'validation .* step 2 ' "$OUT/stdout.txt" || fail "$stage: not validated"
    train one $stage 4
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

script export "$OUT/one/render.ckpt" "$OUT/model.safetensors"
succeed convert "$OUT/model.safetensors" --config "$OUT/model.json" --out "$OUT/model.hdrig"
succeed reconstruct --images $small --size 112 --model "$OUT/model.hdrig" --refine 0 \
    --out "$OUT/scene"
finish
