#!/usr/bin/env bash
# A printed board of tags: its PDF; rigs calibrated from takes of it, in metres, also one whose
# cameras see nothing in common; and what is said where that is not possible.
. tests/e2e/common.bash

# A rig file: cameras of one lens, `step` degrees apart, on a circle of `radius` m that they look
# out of.
ring() { # n step radius
    awk -v n="$1" -v step="$2" -v radius="$3" 'BEGIN {
        print "{\"generator\": \"hdrig\", \"unit\": \"m\", \"cameras\": ["
        for (i = 0; i < n; i++) {
            a = (i - (n - 1) / 2) * step * 3.14159265358979 / 180
            printf "{\"name\": \"cam_%02d.png\", \"w\": 480, \"h\": 360,", i
            printf "\"fx\": 420, \"fy\": 420,"
            printf "\"cx\": 240, \"cy\": 180, \"q\": [%.9g, 0, %.9g, 0],", cos(a / 2), -sin(a / 2)
            printf "\"t\": [0, %.9g, %.9g],", 0.02 * (i % 3), -radius
            printf "\"model\": \"RADIAL\", \"params\": [420, 240, 180, -0.1, 0.01]}%s\n",
                i + 1 < n ? "," : ""
        }
        print "]}"
    }'
}

take() { # name rig seed arguments...
    local name=$1 rig=$2 seed=$3
    shift 3
    succeed simulate --rig "$OUT/$rig.json" --kind room --seed "$seed" --samples 1 \
        --exposures 0.25,2 --out "$OUT/$name" "$@"
}

calibrate() { # file arguments...
    local file=$1
    shift
    succeed rig calibrate "$@" --set cameras.same=size --out "$OUT/$file.json"
}

# Whether two rigs are the same: the worst angle between cameras of both below `degrees`, lengths
# within `share`.
compare() { # rig rig degrees share
    awk -v degrees="$3" -v share="$4" '
    function number(key, n, part) {
        part = $0
        if (!sub(".*\"" key "\": *\\[?", "", part)) return 0
        split(part, value, /[],]/)
        return 1
    }
    FNR == 1 { file++; n = 0 }
    {
        if (number("q")) for (k = 1; k <= 4; k++) q[file, n, k] = value[k]
        if (number("t")) { for (k = 1; k <= 3; k++) t[file, n, k] = value[k]; n++ }
    }
    function matrix(f, i, w, x, y, z) {
        w = q[f, i, 1]; x = q[f, i, 2]; y = q[f, i, 3]; z = q[f, i, 4]
        r[f, i, 0] = 1 - 2 * (y * y + z * z); r[f, i, 1] = 2 * (x * y - w * z)
        r[f, i, 2] = 2 * (x * z + w * y); r[f, i, 3] = 2 * (x * y + w * z)
        r[f, i, 4] = 1 - 2 * (x * x + z * z); r[f, i, 5] = 2 * (y * z - w * x)
        r[f, i, 6] = 2 * (x * z - w * y); r[f, i, 7] = 2 * (y * z + w * x)
        r[f, i, 8] = 1 - 2 * (x * x + y * y)
        for (k = 0; k < 3; k++)
            c[f, i, k] = -(r[f, i, k] * t[f, i, 1] + r[f, i, 3 + k] * t[f, i, 2] + \
                r[f, i, 6 + k] * t[f, i, 3])
    }
    function apart(f, i, j, sum) {
        sum = 0
        for (k = 0; k < 3; k++) sum += (c[f, i, k] - c[f, j, k]) ^ 2
        return sqrt(sum)
    }
    END {
        for (f = 1; f <= 2; f++) for (i = 0; i < n; i++) matrix(f, i)
        for (i = 1; i < n; i++) for (j = 0; j < i; j++) {
            sum = 0 # of squares of Ri Rj^T, which differ by 2 sqrt(2) sin(angle / 2)
            for (a = 0; a < 3; a++) for (b = 0; b < 3; b++) {
                d = 0
                for (k = 0; k < 3; k++)
                    d += r[1, i, 3 * a + k] * r[1, j, 3 * b + k] - \
                        r[2, i, 3 * a + k] * r[2, j, 3 * b + k]
                sum += d * d
            }
            angle = sqrt(sum / 2) * 180 / 3.14159265358979
            worst = angle > worst ? angle : worst
            all[1] += apart(1, i, j); all[2] += apart(2, i, j)
        }
        ratio = all[2] / all[1] - 1
        printf "%d cameras: %.4f degrees, lengths %+.3f %%\n", n, worst, 100 * ratio
        exit !(n > 1 && worst < degrees && (ratio < 0 ? -ratio : ratio) < share)
    }' "$OUT/$1.json" "$OUT/$2.json"
}

same() { # truth found degrees share
    compare "$@" || fail "$2.json differs from the truth"
}

# the sheet
succeed rig board --out "$OUT/board.pdf"
grep -q '6 x 4 tags of 37 mm on a4' "$OUT/stdout.txt" || fail "it says: $(cat "$OUT/stdout.txt")"
cp "$OUT/board.pdf" "$OUT/first.pdf"
succeed rig board --out "$OUT/board.pdf"
cmp "$OUT/board.pdf" "$OUT/first.pdf" || fail "two boards differ"
succeed rig board --out "$OUT/board.pdf" --paper a3 --tag 55
cmp -s "$OUT/board.pdf" "$OUT/first.pdf" && fail "a3 is a4"
expect 2 'allowed are 10 to 79 mm' rig board --out "$OUT/no.pdf" --tag 200
expect 2 'it is a4, a3 or letter' rig board --out "$OUT/no.pdf" --paper a5
expect 2 'out is needed' rig board
echo mine >"$OUT/mine.pdf"
expect 1 'not written by hdrig' rig board --out "$OUT/mine.pdf"

# cameras that see the same, in metres
ring 3 8 -1 >"$OUT/in.json"
for i in 1 2 3; do
    take "in$i" in $((60 + i)) --board a3 --distance 0.7
done
calibrate found "$OUT/in1" "$OUT/in2" "$OUT/in3" --tag 55
grep -q '3 cameras from 3 takes, .* corners of tags fit to 0.*in metres' "$OUT/stdout.txt" ||
    fail "it says: $(cat "$OUT/stdout.txt")"
grep -q '"unit": "m"' "$OUT/found.json" || fail "no unit in $(cat "$OUT/found.json")"
[ "$(grep -c deviation "$OUT/found.json")" = 3 ] || fail "no deviations"
same in found 0.05 0.002

# without the size the scale is free; twice the size is twice the rig
calibrate free "$OUT/in1" "$OUT/in2" "$OUT/in3"
grep -q 'the scale is free' "$OUT/stdout.txt" || fail "it says: $(cat "$OUT/stdout.txt")"
grep -q '"unit"' "$OUT/free.json" && fail "a unit without a size"
calibrate twice "$OUT/in1" "$OUT/in2" "$OUT/in3" --tag 110
compare found twice 0.01 0.99 >/dev/null && fail "the size of a tag changes nothing"
compare found twice 0.01 1.01 || fail "tags of twice the size do not make the rig twice as large"

# a scene of a rig in metres
succeed reconstruct --images "$OUT/in1" --rig "$OUT/found.json" --refine 0 --model none \
    --out "$OUT/scene"
for file in cameras.json scene.json; do
    grep -q '"unit": "m"' "$OUT/scene/$file" || fail "$file does not tell metres"
done
grep -q '"metres":true' "$OUT/scene/view.html" || fail "the page does not tell metres"
succeed reconstruct --images "$OUT/in1" --rig "$OUT/free.json" --refine 0 --model none \
    --out "$OUT/any"
grep -q '"metres":false' "$OUT/any/view.html" || fail "metres of a rig without scale"

# cameras that look away from each other
ring 3 50 0.15 >"$OUT/out.json"
for i in 1 2; do
    take "out$i" out $((70 + i)) --board a3 --before 1-2 --distance 0.55
    take "out$((i + 2))" out $((72 + i)) --board a3 --before 2-3 --distance 0.55
done
calibrate tied "$OUT/out1" "$OUT/out2" "$OUT/out3" "$OUT/out4" --tag 55
same out tied 0.25 0.01
expect 1 'nothing ties the camera of' rig calibrate "$OUT/out1" "$OUT/out2" --tag 55 \
    --set cameras.same=size --out "$OUT/no.json"
nothing_at "$OUT/no.json"

# a take without the board among them; none with it
take bare in 80
calibrate found "$OUT/in1" "$OUT/in2" "$OUT/bare" --tag 55
grep -q 'bare: no camera sees the board' "$ERR" || fail "it says: $(cat "$ERR")"
expect 1 'no camera sees 4 tags of a board' rig calibrate "$OUT/bare" --tag 55 \
    --set cameras.same=size --out "$OUT/no.json"
expect 2 'no-board' rig calibrate "$OUT/in1" --tag 55 --no-board --out "$OUT/no.json"
expect 2 'tag' rig calibrate "$OUT/in1" --tag -3 --out "$OUT/no.json"

# worlds that cannot be
expect 2 'need --board' simulate --tag 30 --out "$OUT/no"
expect 2 'is not like 1-2' simulate --board a4 --before 3-9 --views 3 --out "$OUT/no"
finish
