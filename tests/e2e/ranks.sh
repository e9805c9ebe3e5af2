#!/usr/bin/env bash
# Several ranks of Open MPI or MPICH make the scene of one process, byte for byte; a rank that
# fails, dies or is another program ends all with a sentence and leaves nothing.
. tests/e2e/common.bash
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_rmaps_base_oversubscribe=1
hdrig=$(realpath "$HDRIG")
model=$(realpath build/small.hdrig)
for launcher in mpirun.openmpi mpirun.mpich; do
    [ -x "$(command -v $launcher)" ] || { echo "not checked: there is no $launcher"; exit 0; }
done
make_set set 112 6 2
cd "$OUT" || exit 1
OUT=$PWD ERR=$PWD/stderr.txt HDRIG=$hdrig

# The exit code, and what all ranks have said is in $ERR.
start() { # launcher arguments...
    "$@" >stdout.txt 2>"$ERR"
}

refused() { # regex launcher arguments...
    local regex=$1
    shift
    start "$@" && fail "$*: exit 0"
    grep -Eq "$regex" "$ERR" ||
        fail "$*: \"$(grep hdrig "$ERR" | head -n 1)\" does not match $regex"
    nothing_at bad
}

scene_of() { # folder
    sha256sum <"$1/scene.hdrig"
}

# ---- the same bytes ----

set="reconstruct --images set --rig none --size 112 --refine 0"
stereo="$set --model none"
network="$set --model $model --set start.stereo=0"
open_mpi=mpirun.openmpi
for what in stereo network; do
    job=${!what}
    succeed $job --out $what.1
    for n in 2 3 8; do
        start mpirun.openmpi -n $n "$hdrig" $job --threads 1 --out $what.$n ||
            fail "$what: $n ranks: $(tail -n 3 "$ERR")"
        cmp $what.1/scene.hdrig $what.$n/scene.hdrig || fail "$what: $n ranks: another scene"
        grep -q "\"ranks\": $n" $what.$n/report.json || fail "$what: the report names no $n ranks"
        [ "$(grep -c '^write 100 %' "$ERR")" = 1 ] || fail "$what: not one rank tells its progress"
    done
    start mpirun.mpich -n 2 "$hdrig" $job --threads 1 --out $what.mpich ||
        fail "$what: MPICH: $(tail -n 3 "$ERR")"
    cmp $what.1/scene.hdrig $what.mpich/scene.hdrig || fail "$what: MPICH: another scene"
done

start mpirun.openmpi -n 2 "$hdrig" eval --data set --rig none --model none --size 112 --refine 0 \
    --json eval.json || fail "eval: $(tail -n 3 "$ERR")"
[ "$(grep -c '^LDR' stdout.txt)" = 1 ] || fail "eval: not one table"

start mpirun.openmpi -n 3 "$hdrig" bench --gaussians 2000 --size 64 --threads 1 \
    --json bench.json || fail "bench: $(tail -n 3 "$ERR")"
awk -v host="$(uname -n)" 'NR > 1 && $2 == host && $8 > 0 && $9 <= 1 { all += $10; n++ }
    END { exit !(n == 3 && NR == 5 && all > 99.7 && all < 100.3) }' stdout.txt ||
    fail "bench: not a table of three ranks: $(cat stdout.txt)"
[ "$(grep -c '"host": ' bench.json)" = 3 ] || fail "bench: not three ranks in JSON"

# one rank a machine, as the README starts them
echo localhost >hosts
start mpirun.openmpi --hostfile hosts --map-by ppr:1:node --bind-to none "$hdrig" $stereo \
    --out listed || fail "a list of machines: $(tail -n 3 "$ERR")"
! grep -q '"ranks": [2-9]' listed/report.json || fail "several ranks on one machine"

# ---- files that only the first rank has ----

mkdir elsewhere
start mpirun.openmpi -n 1 "$hdrig" $stereo --out sent : \
    -wdir "$PWD/elsewhere" -x "TMPDIR=$PWD/elsewhere" -n 1 "$hdrig" $stereo --out sent ||
    fail "photographs that are not there: $(tail -n 3 "$ERR")"
cmp stereo.1/scene.hdrig sent/scene.hdrig || fail "photographs that are not there: another scene"
[ -z "$(ls -A elsewhere)" ] || fail "left behind: $(ls -A elsewhere)"

# ---- refusals ----

refused 'does not run on several ranks' $open_mpi -n 2 "$hdrig" render --scene stereo.1 --out bad
refused 'nowhere' $open_mpi -n 2 "$hdrig" reconstruct --images nowhere --out bad
[ "$(grep -c '^hdrig reconstruct: ' "$ERR")" = 1 ] ||
    fail "more than one rank tells of a failure of all"
refused 'several ranks measure splats only: start --what kernels without a launcher' \
    $open_mpi -n 2 "$hdrig" bench --what kernels
refused 'start --model without' $open_mpi -n 2 "$hdrig" bench --model $model
job="bench --gaussians 2000 --size 64 --json bad"
refused 'rank 1 of 2 \(.*\): .*max-memory' \
    $open_mpi -n 1 "$hdrig" $job : -n 1 "$hdrig" $job --max-memory 64
job="$stereo --out bad"
refused 'rank 1 \(.*\) has the instructions c, rank 0 .*HDRIG_CPU_MASK' \
    $open_mpi -n 1 "$hdrig" $job : -n 1 -x HDRIG_CPU_MASK=c "$hdrig" $job
cp "$hdrig" "$(dirname "$hdrig")"/*.so elsewhere
echo >>elsewhere/hdrig
refused 'rank 1 \(.*\) runs another build of this program' \
    $open_mpi -n 1 "$hdrig" $job : -n 1 elsewhere/hdrig $job
rm -r elsewhere/*
job+=" --gaussians-max 3000000"
refused 'rank 1 of 2 \(.*\): .*max-memory' \
    $open_mpi -n 1 "$hdrig" $job : -n 1 "$hdrig" $job --max-memory 64

# ---- a rank dies, or the user stops the job ----

long=${stereo/--refine 0/--refine 100000}
begin() { # starts ranks that refine for long; their launcher is $!
    : >"$ERR"
    "$1" -n 2 "$hdrig" $long --threads 1 --out bad >stdout.txt 2>"$ERR" &
    launcher=$!
    for ((i = 0; i < 600; i++)); do
        grep -q '^refine' "$ERR" && break
        sleep 0.1
    done
}

for mpi in mpirun.openmpi mpirun.mpich; do
    begin $mpi
    kill -9 "$(pgrep -f "$long" | tail -n 1)"
    wait $launcher && fail "$mpi: exit 0 though a rank died"
    grep -Eqi 'rank|process|terminat' "$ERR" || fail "$mpi: nothing tells of the rank that died"
    [ ! -e bad ] || fail "$mpi: a result in spite of a dead rank"
    ! pgrep -f "$long" >pids.txt || fail "$mpi: ranks go on: $(cat pids.txt)"
    begin $mpi
    kill -INT $launcher
    wait $launcher && fail "$mpi: exit 0 though interrupted"
    sleep 1
    [ ! -e bad ] || fail "$mpi: a result in spite of Ctrl-C"
    ! pgrep -f "$long" >pids.txt || fail "$mpi: ranks go on: $(cat pids.txt)"
done

# a machine without current says nothing, and nobody would tell the others
begin $open_mpi
kill -STOP "$(pgrep -f "$long" | tail -n 1)"
timeout 60 tail --pid $launcher -f /dev/null || fail "ranks wait for one that says nothing"
grep -Eq 'rank 0 of 2: rank 1 has said nothing for 30 s' "$ERR" ||
    fail "a rank that says nothing: $(grep hdrig "$ERR")"
[ ! -e bad ] || fail "a result in spite of a silent rank"
! pgrep -f "$long" >pids.txt || fail "ranks go on: $(cat pids.txt)"
finish
