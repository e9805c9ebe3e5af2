# Power cuts under a store on ext4: the kernel logs all writes, and every cut is made from the log.
# Disks are in memory.
. "${0%/*}/common.bash"

load brd rd_nr=4 rd_size=65536
load dm-log-writes
load ext4
data=/dev/ram0 log=/dev/ram1 work=/dev/ram2
mkdir -p disk
truncate -s 12M base
mkfs.ext4 -q -b 1024 -J size=1 -E lazy_itable_init=0,lazy_journal_init=0,nodiscard \
    -U 11111111-2222-3333-4444-555555555555 base
dd if=base of=$data bs=1M status=none
export DM_DISABLE_UDEV=1
dmsetup create log --table "0 $((12 << 11)) log-writes $data $log"
mount /dev/dm-0 disk
mkdir disk/store
sync
dmsetup message log 0 mark begin
for ((i = 0; i < 3; i++)); do
    id=$("$BIN/powercut" commit disk/store) || fail "$id"
    dmsetup message log 0 mark "=$id"
done
umount disk
dmsetup remove log

"$BIN/powercut" replay $log base $work disk >result || fail "$(cat result)"
cat result
between "cuts" "$(sed 's/.* marks, \([0-9]*\) cuts.*/\1/' result)" 500 100000
