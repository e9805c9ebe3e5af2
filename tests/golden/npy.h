/* npy.h - arrays of the golden sets and of dumps (NumPy format 1.0, C order, 4-byte values). */
#ifndef GOLDEN_NPY_H
#define GOLDEN_NPY_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Contents of a file as 4-byte words; *n words. Ends the program if it cannot be read.
 * own: free(). */
static inline void *npy_read(const char *path, size_t *n)
{
    FILE *f = fopen(path, "rb");
    unsigned char head[10];
    long end = 0;
    if (!f || fread(head, 1, 10, f) != 10 || memcmp(head, "\x93NUMPY\x01", 7) != 0 ||
        fseek(f, 0, SEEK_END) != 0 || (end = ftell(f)) < 0) {
        fprintf(stderr, "%s: not readable as .npy 1.0\n", path);
        exit(1);
    }
    long data = 10 + head[8] + 256 * head[9];
    size_t bytes = (size_t)(end - data);
    void *p = malloc(bytes + 1);
    if (!p || fseek(f, data, SEEK_SET) != 0 || fread(p, 1, bytes, f) != bytes) {
        fprintf(stderr, "%s: truncated\n", path);
        exit(1);
    }
    fclose(f);
    *n = bytes / 4;
    return p;
}

/* The same for tests/data/golden/<name>. */
static inline void *npy_load(const char *name, size_t *n)
{
    char path[256];
    snprintf(path, sizeof path, "tests/data/golden/%s", name);
    return npy_read(path, n);
}

#endif
