/* memory.h - how much memory this machine gives to this process. thread: any. */
#ifndef DEVICE_MEMORY_H
#define DEVICE_MEMORY_H

#include <stdint.h>

/* Bytes: the memory of the machine, or less if the control group of this process or one above it
 * has a limit (version 2: memory.max in /sys/fs/cgroup). A limit that cannot be read counts as
 * none. root: begins the paths of /proc and /sys; "" for those of this machine. */
uint64_t memory_total(const char *root);

#endif
