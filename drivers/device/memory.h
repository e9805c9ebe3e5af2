/* memory.h - how much memory this machine gives to this process. thread: any. */
#ifndef DEVICE_MEMORY_H
#define DEVICE_MEMORY_H

#include <stdint.h>

/* Bytes: all of the machine's, or what the control group of this process or one above it allows,
 * if that is less (version 2: memory.max in /sys/fs/cgroup). What cannot be read allows all.
 * root: begins the paths of /proc and /sys; "" for those of this machine. */
uint64_t memory_total(const char *root);

#endif
