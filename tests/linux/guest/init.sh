#!/bin/bash
# First process of the guest. Its root is that of the machine, read-only, or a copy of what it
# needs; what tests write goes to memory. TEST, BIN, MODULES and BENCH are words of the command line
# of the kernel.
export PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C TMPDIR=/run/tmp HOME=/run/tmp
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
mount -t tmpfs run /run
modprobe -d "$MODULES" configfs
mount -t configfs config /sys/kernel/config
mkdir -p "$TMPDIR" /dev/shm
ln -s /proc/self/fd /dev/fd
cd /run/tmp || exit
echo TEST_BEGIN
bash "$TEST" </dev/null
echo "TEST_EXIT $?"
exec "$BIN/poweroff"
