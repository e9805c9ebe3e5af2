/* truth.h - what a frame of usbcam really is, written into its first bytes: over the pixels, or as
 * a comment of the JPEG. */
#ifndef LINUX_TRUTH_H
#define LINUX_TRUTH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

struct truth {
    char magic[4];   // "HDRT"
    uint32_t number; // number of the sensor's frame
    double exposure; // s, times gain
};

enum { TRUTH_COMMENT = 4 + sizeof(struct truth) }; // marker, length, truth; after the first 2 bytes

static inline bool truth_read(const uint8_t *data, size_t n, struct truth *out)
{
    size_t at = n > 2 && data[0] == 0xff && data[1] == 0xd8 ? 6 : 0;
    if (n < at + sizeof *out)
        return false;
    memcpy(out, data + at, sizeof *out);
    return memcmp(out->magic, "HDRT", 4) == 0;
}

#endif
