#!/usr/bin/env bash
# Extreme photographs and requests: black, white and equal pictures, exposures from 2^-26 to
# 2^26 s, small and odd sizes. The result is a scene of finite numbers that can be rendered, or one
# sentence.
. tests/e2e/common.bash
tiny=tests/data/ckpt
for precision in fp32 int8; do
    succeed convert "$tiny/tiny.ckpt" --config "$tiny/tiny.json" --precision $precision \
        --out "$OUT/$precision.hdrig"
done

flat() { # folder exposure value[:hot]...: pictures of one grey each, of this exposure
    local dir=$OUT/$1 exposure=$2 i=0 value hot
    shift 2
    mkdir -p "$dir"
    for value in "$@"; do
        hot=${value#*:}
        [ "$hot" != "$value" ] || hot=
        # shellcheck disable=SC2086
        "$BIN/make_flat" "$dir/$i.png" 64 "${value%:*}" $hot || exit 1
        i=$((i + 1))
    done
    exposed "$dir" $(for ((; i > 0; i--)); do echo "$exposure"; done)
}

exposed() { # folder exposure...: of its pictures 0.png, 1.png, ...
    local dir=$1 i=0 comma= t
    shift
    echo '{' >"$dir/exposure.json"
    for t in "$@"; do
        echo "$comma\"$i.png\": $t" >>"$dir/exposure.json"
        i=$((i + 1)) comma=,
    done
    echo '}' >>"$dir/exposure.json"
}

# A scene without numbers that are none, in its reports, cameras and pictures.
scene() { # name precision arguments...
    local name=$1 precision=$2
    shift 2
    succeed reconstruct --model "$OUT/$precision.hdrig" --set cameras.polish=0 \
        --set start.stereo=0 --refine 5 --size 56 --out "$OUT/$name" "$@"
    ! grep -Eiq '[^a-z](nan|inf)[^a-z]' "$OUT/$name"/*.json "$OUT/stdout.txt" ||
        fail "$name: $(grep -Eio '.{20}[^a-z](nan|inf)[^a-z]' "$OUT/$name"/*.json | head -n 1)"
    succeed render --scene "$OUT/$name" --path orbit --frames 1 --out "$OUT/$name-orbit"
}

flat black 1 0 0 0
flat white 1 255 255 255
flat mixed 1 0 255 128
flat hot 1 0:255 0 0
mkdir "$OUT/repeated"
make_set room 64 1 0
for i in 0 1 2 3; do
    cp "$OUT/room/images/train_ldr_000_0.png" "$OUT/repeated/$i.png"
done
exposed "$OUT/repeated" 1 1 1 1
for precision in fp32 int8; do
    for name in black white mixed hot repeated; do
        scene $name-$precision $precision --images "$OUT/$name"
    done
    i=0
    for pair in 1.49e-8:6.7e7 6.7e7:6.7e7 1.49e-8:1.49e-8 1e-30:1e30; do
        mkdir "$OUT/times-$precision-$i"
        cp "$OUT"/repeated/[01].png "$OUT/mixed/2.png" "$OUT/times-$precision-$i"
        exposed "$OUT/times-$precision-$i" ${pair%:*} ${pair#*:} ${pair%:*}
        scene at-$pair-$precision $precision --images "$OUT/times-$precision-$i"
        i=$((i + 1))
    done
    for size in 70 98 126 210; do
        scene size-$size-$precision $precision --images "$OUT/mixed" --size $size
    done
done

# views that are equal to the network are told the same
cam() { # view: its numbers
    tr -d '\n ' <"$OUT/repeated-fp32/cameras.json" | grep -o '{[^{}]*}' | sed -n "$1p" |
        sed 's/"name":"[^"]*",*//'
}
[ -n "$(cam 2)" ] && [ "$(cam 2)" = "$(cam 3)" ] || fail "equal views have other cameras"

# what is refused
images=(--images "$OUT/mixed" --model "$OUT/int8.hdrig" --out "$OUT/result")
expect 1 "--size 100, a network that makes the scene takes multiples of 14" \
    reconstruct "${images[@]}" --size 100 --refine 0
expect 2 '--size: .*56' reconstruct "${images[@]}" --size 42
expect 2 '--size: .*4080' reconstruct "${images[@]}" --size 4081
for bad in 0 -1 1e400 '"1"'; do
    exposed "$OUT/mixed" $bad 1 1
    expect 1 'exposure.json.*0.png' reconstruct "${images[@]}"
done
nothing_at "$OUT/result"
finish
