#!/usr/bin/env bash
# check.sh - one scene by RANKS processes of Open MPI, each in a network namespace of its own on one
# core, over links of RATES: that cameras, depth and network give the bytes of one process, how far
# refinement is from it in dB, and what each stage takes and sends. VIEWS of SIZE px, STEPS of
# refinement; MODEL: of the network.
# With more ranks than cores the seconds say nothing, but the bytes do.
# Run by make check-mpi, from the root with HDRIG and OUT.
. tests/e2e/common.bash
RANKS=${RANKS:-1 2 3 4} RATES=${RATES:-100mbit 1gbit 10gbit} VIEWS=${VIEWS:-8} SIZE=${SIZE:-336}
STEPS=${STEPS:-200} MODEL=$(realpath "${MODEL:-build/small.hdrig}")
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_rmaps_base_oversubscribe=1
export PRTE_ALLOW_RUN_AS_ROOT=1 PRTE_ALLOW_RUN_AS_ROOT_CONFIRM=1
tag=hm$$
most=$(printf '%s\n' $RANKS 2 | sort -n | tail -n 1)
cores=$(nproc)
hdrig=$(realpath "$HDRIG")

# ---- machines: namespaces on a bridge ----

SPACES=yes
ip netns add $tag-hub 2>/dev/null || SPACES=
[ -n "$SPACES" ] || echo "not checked: no network namespaces may be made here, links have no limit"

remove_spaces() {
    [ -z "$SPACES" ] || ip netns list | awk -v t="$tag-" 'index($1, t) == 1 { print $1 }' |
        xargs -r -n 1 ip netns del
}
trap remove_spaces EXIT

make_spaces() {
    local i
    ip netns exec $tag-hub ip link add br0 type bridge
    ip netns exec $tag-hub ip link set br0 up
    for i in $(seq 0 $((most - 1))); do
        ip netns add $tag-$i && ip link add $tag$i netns $tag-hub type veth peer name eth0 \
            netns $tag-$i || return
        ip netns exec $tag-hub ip link set $tag$i master br0 up
        ip netns exec $tag-$i ip addr add 10.78.1.$((i + 1))/16 dev eth0
        ip netns exec $tag-$i ip link set eth0 up
        ip netns exec $tag-$i ip link set lo up
    done
}

set_rate() { # of all links, both ways
    local i
    [ -n "$SPACES" ] || return 0
    for i in $(seq 0 $((most - 1))); do
        ip netns exec $tag-$i tc qdisc replace dev eth0 root tbf rate "$1" burst 256k latency 50ms
        ip netns exec $tag-hub tc qdisc replace dev $tag$i root tbf rate "$1" burst 256k \
            latency 50ms
    done
}

# What mpirun starts on another machine: in its namespace, on one core.
cat >"$OUT/agent.sh" <<X
#!/bin/sh
i=\$((\${1##*.} - 1))
shift
exec ip netns exec $tag-\$i taskset -c \$((i % $cores)) sh -c "\$*"
X
chmod +x "$OUT/agent.sh"

ranks() { # number of ranks, arguments of hdrig...
    local n=$1 i
    shift
    if [ "$n" = 1 ]; then
        taskset -c 0 "$hdrig" "$@" --threads 1
        return
    fi
    local words=(mpirun.openmpi -n "$n" --bind-to none)
    if [ -n "$SPACES" ]; then
        for i in $(seq 1 "$n"); do echo 10.78.1.$i; done >"$OUT/hosts"
        words=(ip netns exec $tag-0 taskset -c 0 "${words[@]}" --hostfile "$OUT/hosts"
            --map-by ppr:1:node --mca plm_rsh_agent "$PWD/$OUT/agent.sh" --mca btl tcp,self
            --mca btl_tcp_if_include eth0 --mca oob_tcp_if_include eth0)
    fi
    "${words[@]}" "$hdrig" "$@" --threads 1
}

# ---- one job ----

stages() { # report: stage, seconds and MB sent of each
    awk '/"seconds": \{/ { s = 1 } /"bytes_sent": \{/ { s = 2 } /\}/ { s = 0 }
        s && match($0, /"[a-z]+": [0-9.e+]+/) {
            split(substr($0, RSTART, RLENGTH), p, ": "); gsub(/"/, "", p[1])
            v[s, p[1]] = p[2]; if (s == 1 && p[1] != "total") name[++n] = p[1] }
        END { for (i = 1; i <= n; i++)
                  if (v[1, name[i]] >= 0.2 || v[2, name[i]] > 0)
                      printf " %s %.1f s %.1f MB;", name[i], v[1, name[i]], v[2, name[i]] / 1e6
        }' "$1"
}

run() { # name ranks rate arguments...
    local name=$1 n=$2 rate=$3 from=$EPOCHREALTIME
    shift 3
    set_rate "$rate"
    rm -rf "${OUT:?}/$name"
    ranks "$n" reconstruct --images "$OUT/set" --rig none --size "$SIZE" "$@" --out "$OUT/$name" \
        >"$OUT/stdout.txt" 2>"$ERR" || { fail "$name, $n ranks: $(tail -n 2 "$ERR")"; return 1; }
    awk -v a="$from" -v b="$EPOCHREALTIME" -v t="$n ranks, $rate: $name" \
        -v w="$(sed -n 's/.*"seconds_waited": \([0-9.e-]*\).*/\1/p' "$OUT/$name/report.json")" \
        'BEGIN { printf "%-34s %7.1f s, %5.1f s of waiting:", t, b - a, w }'
    stages "$OUT/$name/report.json"
    echo
}

held_out() { # of a result
    sed -n 's/.*"held_out_psnr": \([0-9.]*\).*/\1/p' "$OUT/$1/report.json"
}

# ---- all ----

[ -z "$SPACES" ] || make_spaces || fail "no namespaces"
succeed simulate --kind room --seed 77 --views "$VIEWS" --size "$SIZE" --samples 1 \
    --exposures 0.25,1,4 --out "$OUT/set"
for n in $RANKS; do
    run stereo "$n" 1gbit --model none --refine 0 || continue
    here=$(sha256sum <"$OUT/stereo/scene.hdrig")
    [ "$here" = "${stereo:=$here}" ] || fail "stereo: $n ranks: other bytes"
    run network "$n" 1gbit --model "$MODEL" --set start.stereo=0 --refine 0 || continue
    here=$(sha256sum <"$OUT/network/scene.hdrig")
    [ "$here" = "${network:=$here}" ] || fail "network: $n ranks: other bytes"
    run refined "$n" 1gbit --model none --refine "$STEPS" || continue
    db=$(held_out refined)
    echo "    held-out squares $db dB"
    awk -v a="$db" -v b="${first:=$db}" 'BEGIN { exit !((a - b) ^ 2 <= 0.01) }' ||
        fail "refined: $n ranks: $db dB, the first $first"
done
[ -z "$SPACES" ] || for rate in $RATES; do
    run refined 2 "$rate" --model none --refine "$STEPS"
done
finish
