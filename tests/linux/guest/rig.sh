# A rig of MEMBERS boards behind links with delays and losses, each as fast as its camera: what
# tests/rig checks, with its settings.
. "${0%/*}/common.bash"
if [ "$BENCH" != uml ]; then
    echo "skipped: a rig of boards, whose programs are not in the guest"
    exit
fi
mkdir -p /run/netns rig
tools=$(realpath "$BIN/../..")
cd "${0%/tests/*}"
export HDRIG=$tools/hdrig BIN=$tools/tests/e2e OUT=$TMPDIR/rig
MEMBERS=${MEMBERS:-4} TAKES=${TAKES:-4} FAULTS=${FAULTS:-0} bash tests/rig/check.sh
