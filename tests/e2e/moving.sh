#!/usr/bin/env bash
# Moving pictures: paths of the camera, sweeps of the exposure, false colours, videos, and failures
# of ffmpeg. Frames are always written; a video is complete or absent.
. tests/e2e/common.bash
make_set set 56 3 1
scene=$OUT/scene
succeed reconstruct --images "$OUT/set" --size 56 --refine 0 --out "$scene"
render=(render --scene "$scene")

frames() { # folder: how many
    find "$1" -name 'frame_*.png' | wc -l
}

same() { # what got expected
    [ "$2" = "$3" ] || fail "$1: $2, expected $3"
}

mean() { # file...
    "$BIN/look" mean "$@" || fail "look mean $*"
}

# bad requests
for bad in x ..3 1.. 1..x 1..50 -3..-41 1111111111111111111111111111111111111111111111..2; do
    expect 2 '^hdrig render: --ev: ' "${render[@]}" --path orbit --out "$OUT/no" --ev "$bad"
done
expect 2 '--fps is for --video' "${render[@]}" --path orbit --out "$OUT/no" --fps 10
expect 2 '--fps: 0 is not in 1..240' "${render[@]}" --path orbit --out "$OUT/no" --fps 0 \
    --video a.mp4
expect 2 '--frames: 2.5 is not a whole number' "${render[@]}" --path orbit --frames 2.5 \
    --out "$OUT/no"
expect 2 '--frames is for --path' "${render[@]}" --cameras "$scene/cameras.json" --frames 2 \
    --out "$OUT/no"
for bad in a.avi .mp4 "$OUT/.mp4" mp4; do
    expect 2 "--video: .* does not end in .mp4" "${render[@]}" --path orbit --out "$OUT/no" \
        --video "$bad"
done
sed '0,/"w": 56, "h": 56/s//"w": 28, "h": 28/' "$scene/cameras.json" >"$OUT/unequal.json"
expect 1 'camera 1 is for 56 x 56 px, the first for 28 x 28; a video has one size: give --size' \
    "${render[@]}" --cameras "$OUT/unequal.json" --out "$OUT/no" --video "$OUT/no.mp4"
nothing_at "$OUT/no"

# ways: the inputs exactly, or through them
succeed "${render[@]}" --path inputs --out "$OUT/inputs"
same "frames at the inputs" "$(frames "$OUT/inputs")" 3
succeed "${render[@]}" --path inputs --frames 9 --out "$OUT/way"
same "frames through the inputs" "$(frames "$OUT/way")" 9
mapfile -t ends < <(mean "$OUT"/inputs/frame_000[02].png "$OUT"/way/frame_000[08].png)
for i in 0 1; do
    awk -v a="${ends[i]}" -v b="${ends[i + 2]}" 'BEGIN { exit !(a > 1 && (a - b) ^ 2 < 0.01) }' ||
        fail "the way does not end at an input: ${ends[*]}"
done

# a file of the scene shows the same
succeed render --scene "$scene/scene.hdrig" --path inputs --out "$OUT/file"
same "frames of scene.hdrig" "$(cd "$OUT/file" && sha256sum frame_*)" \
    "$(cd "$OUT/inputs" && sha256sum frame_*)"
succeed convert-scene "$scene" --out "$OUT/scene.glb"
succeed render --scene "$OUT/scene.glb" --path inputs --out "$OUT/glb"
mean "$OUT"/inputs/frame_*.png "$OUT"/glb/frame_*.png |
    awk '{ v[NR] = $1 } END { exit !(NR == 6 && (v[2] - v[5]) ^ 2 < 1) }' ||
    fail "scene.glb shows something else"
rm "$OUT/scene.json"
expect 1 'scene.glb: the scene has no input views: give --cameras FILE' \
    render --scene "$OUT/scene.glb" --path inputs --out "$OUT/no"
succeed render --scene "$OUT/scene.glb" --cameras "$scene/cameras.json" --out "$OUT/glb"

# sweep: each frame brighter than the one before; the ends are those of single exposures
succeed "${render[@]}" --path orbit --frames 7 --ev -6..6 --out "$OUT/sweep"
mean "$OUT"/sweep/frame_*.png | awk 'NR > 1 && $1 <= last { exit 1 } { last = $1 }' ||
    fail "a sweep is not monotone: $(mean "$OUT"/sweep/frame_*.png | tr '\n' ' ')"
succeed "${render[@]}" --path orbit --frames 7 --ev -6 --out "$OUT/dark"
cmp -s "$OUT/dark/frame_0000.png" "$OUT/sweep/frame_0000.png" || fail "a sweep begins elsewhere"
succeed "${render[@]}" --path orbit --frames 7 --ev 6 --out "$OUT/bright"
cmp -s "$OUT/bright/frame_0006.png" "$OUT/sweep/frame_0006.png" || fail "a sweep ends elsewhere"

# false colours are those of the radiance, which EXR has in half floats; the exposure moves them
zero() { # folder: the luminance of 0 stops
    sed -n 's/.*"false_colour_0": \([0-9.e+-]*\).*/\1/p' "$1/report.json"
}
succeed "${render[@]}" --path inputs --hdr --out "$OUT/hdr"
for ev in 0 2; do
    succeed "${render[@]}" --path inputs --false-colour --ev $ev --out "$OUT/false$ev"
    differ=$("$BIN/look" false "$OUT/hdr/frame_0001.exr" "$OUT/false$ev/frame_0001.png" \
        "$(zero "$OUT/false$ev")")
    at_least "agreement of false colours at $ev EV" "$((8 - differ))" 6
done
at_least "difference of false colours 2 stops apart" "$("$BIN/look" false \
    "$OUT/hdr/frame_0001.exr" "$OUT/false2/frame_0001.png" "$(zero "$OUT/false0")")" 20
at_least "stops between them" \
    "$(awk -v a="$(zero "$OUT/false0")" -v b="$(zero "$OUT/false2")" 'BEGIN { print a / b }')" 3.999
mean "$OUT/false0/legend.png" >/dev/null
[ ! -e "$OUT/inputs/legend.png" ] || fail "a legend without false colours"

# ffmpeg that is not there, or dies
mkdir "$OUT/bin" "$OUT/films"
for tool in find grep ls rm tail wc; do
    ln -s "$(command -v $tool)" "$OUT/bin"
done
without() { # code regex arguments...: frames, no video
    local code=$1 regex=$2
    shift 2
    rm -rf "$OUT/frames"
    expect "$code" "^hdrig render: .*$regex" "${render[@]}" --path orbit --frames 60 \
        --out "$OUT/frames" "$@"
    same "frames without a video" "$(frames "$OUT/frames")" 60
    grep -q '"video": null' "$OUT/frames/report.json" || fail "report.json claims a video"
    same "left of a video" "$(ls -A "$OUT/films")" ""
}
rm -rf "$OUT/frames"
PATH=$OUT/bin expect 1 \
    'ffmpeg, which makes videos, is not installed: apt-get install ffmpeg$' "${render[@]}" \
    --path orbit --out "$OUT/frames" --video "$OUT/films/a.mp4"
! grep -q ' step ' "$ERR" || fail "no ffmpeg: told after work"
nothing_at "$OUT/frames"
cat >"$OUT/bin/ffmpeg" <<'EOF'
#!/bin/sh
case "$*" in *-encoders*) echo ' V....D libx264  H.264'; exit;; esac
for out; do :; done
head -c 20000 >"${out#file:}"
exit 7
EOF
chmod +x "$OUT/bin/ffmpeg"
PATH=$OUT/bin:$PATH without 1 'films/a.mp4: ffmpeg ended with exit code 7' \
    --video "$OUT/films/a.mp4"

PATH=$OUT/bin:$PATH expect 1 'films/a.mp4: ffmpeg ended with exit code 7$' "${render[@]}" \
    --path orbit --frames 60 --video "$OUT/films/a.mp4"
same "left of a video alone" "$(ls -A "$OUT/films")" ""

if ! command -v ffmpeg >/dev/null; then
    echo "no ffmpeg: videos are left out"
    finish
    exit
fi

entries=codec_name,width,height,pix_fmt,color_range,color_space,r_frame_rate,duration,nb_read_frames
probe() { # file: these
    ffprobe -v error -select_streams v -count_frames -of csv=p=0 \
        -show_entries "stream=$entries" "$1"
}

# frames have the shape of the photographs, which the scene squeezes to squares
cp -r "$OUT/set" "$OUT/wide"
for photo in "$OUT"/set/images/*.png; do
    ffmpeg -v error -y -i "$photo" -vf crop=56:42 "$OUT/wide/images/${photo##*/}"
done
sed -i 's/PINHOLE 56 56 \([^ ]*\) \([^ ]*\) 28 28/PINHOLE 56 42 \1 \2 28 21/' \
    "$OUT/wide/sparse/0/cameras.txt"
succeed reconstruct --images "$OUT/wide" --size 56 --refine 0 --out "$OUT/squeezed"
for path in orbit inputs; do
    succeed render --scene "$OUT/squeezed" --path $path --out "$OUT/wide-$path"
    same "$path" "$(ffprobe -v error -show_entries stream=width,height -of csv=p=0 \
        "$OUT/wide-$path/frame_0001.png")" 56,42
done

# videos: whole, of even sides, with the same frames beside them
succeed "${render[@]}" --path orbit --frames 12 --size 57 --video "$OUT/films/a.mp4" \
    --out "$OUT/frames"
same "orbit" "$(probe "$OUT/films/a.mp4")" h264,58,58,yuv420p,tv,bt709,30/1,0.400000,12
succeed "${render[@]}" --path orbit --frames 12 --size 57 --out "$OUT/plain"
same "frames beside a video" "$(cd "$OUT/frames" && sha256sum frame_*)" \
    "$(cd "$OUT/plain" && sha256sum frame_*)"
rm "$OUT/films/a.mp4"
succeed "${render[@]}" --path orbit --frames 12 --size 57 --video "$OUT/films/a.mp4"
same "a video alone" "$(probe "$OUT/films/a.mp4")" h264,58,58,yuv420p,tv,bt709,30/1,0.400000,12
same "beside a video alone" "$(ls -A "$OUT/films")" a.mp4
expect 2 'hdr writes frames: give --out' "${render[@]}" --path orbit --hdr \
    --video "$OUT/films/b.mp4"
succeed "${render[@]}" --path inputs --frames 10 --fps 25 --ev -2..2 --false-colour \
    --video "$OUT/films/a.mp4" --out "$OUT/frames"
same "inputs" "$(probe "$OUT/films/a.mp4")" h264,56,56,yuv420p,tv,bt709,25/1,0.400000,10
both="b.mp4 files.sha256 frame_0000.png frame_0001.png report.json"
for round in first again; do # in the folder of the frames, which is replaced
    succeed "${render[@]}" --path inputs --frames 2 --video "$OUT/both/b.mp4" --out "$OUT/both/"
    same "$round" "$(ls "$OUT/both" | xargs)" "$both"
done
tool=$(readlink -f "$HDRIG")
(cd "$OUT/both" && "$tool" render --scene ../scene --path inputs \
    --frames 2 --video b.mp4 --out ../both >/dev/null 2>&1) || fail "a video in this folder"
same "this folder" "$(ls "$OUT/both" | xargs)" "$both"
rm "$OUT/films/a.mp4"

succeed "${render[@]}" --path inputs --frames 2 --video "$OUT/./fresh/b.mp4" --out "$OUT/fresh"
same "a new folder by two names" "$(ls "$OUT/fresh" | xargs)" \
    "$both"

# where there is no place, or no space
without 1 'nowhere/a.mp4: cannot create: No such file' --video "$OUT/nowhere/a.mp4"
mkdir "$OUT/small"
if mount -t tmpfs -o size=8k tmpfs "$OUT/small" 2>/dev/null; then
    trap 'umount "$OUT/small"' EXIT
    without 3 'small/a.mp4: .*No space left on device' --video "$OUT/small/a.mp4"
    same "left on the small disk" "$(ls -A "$OUT/small")" ""
else
    echo "no right to mount a small file system: left out"
fi

# Ctrl-C in the middle, and a kill after which the next run tidies up
stop_by() { # signal code
    : >"$ERR"
    "$HDRIG" "${render[@]}" --path orbit --frames 9999 --video "$OUT/films/a.mp4" \
        --out "$OUT/long" >"$OUT/stdout.txt" 2>"$ERR" &
    pid=$!
    for ((i = 0; i < 600; i++)); do
        [ -s "$OUT/films/.tmp-a.mp4-$pid/a.mp4" ] && break
        sleep 0.1
    done
    kill -"$1" $pid
    wait $pid
    same "exit code of $1" $? "$2"
}
stop_by INT 130
nothing_at "$OUT/long"
same "left of a video by Ctrl-C" "$(ls -A "$OUT/films")" ""
! pgrep -f "file:$OUT/films/.tmp-a.mp4" >/dev/null || fail "ffmpeg still runs"
stop_by KILL 137 2>/dev/null
same "left by a kill" "$(ls -A "$OUT/films")" ".tmp-a.mp4-$pid"
succeed "${render[@]}" --path orbit --frames 2 --video "$OUT/films/a.mp4" --out "$OUT/long"
same "after a kill" "$(ls -A "$OUT/films")" a.mp4
same "left of frames" "$(find "$OUT" -maxdepth 1 -name '.tmp-*')" ""
finish
