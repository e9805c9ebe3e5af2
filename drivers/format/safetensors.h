/* safetensors.h - the container of scenes and weights: 8 bytes little-endian header length, JSON
 * {"__metadata__": {key: string}, name: {"dtype", "shape", "data_offsets": [begin, end]}, ...}, raw
 * data (github.com/huggingface/safetensors).
 *
 * The reader refuses
 *  1. a header length above 4 MB or beyond the file;
 *  2. a header that is not JSON;
 *  3. tensors with other members than dtype, shape and data_offsets, a type that the format does
 *     not have, more than 8 extents or extents that are no whole numbers;
 *  4. a name that occurs twice;
 *  5. offsets beyond the file or whose length is not that of the shape;
 *  6. data that overlap, leave holes or do not end with the file.
 * thread: any. */
#ifndef FORMAT_SAFETENSORS_H
#define FORMAT_SAFETENSORS_H

#include "core/base/err.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

enum { SAFETENSORS_RANK_MAX = 8, SAFETENSORS_ALIGN = 64 };

struct safetensors_tensor {
    const char *name;
    const char *type; // "F32", "BF16", ...
    int rank;
    size_t shape[SAFETENSORS_RANK_MAX];
    size_t begin, end; // bytes in the data
};

struct safetensors {
    struct cJSON *doc;
    const char *what;  // begins the sentences; not owned
    size_t data, size; // the data: offset in the file, bytes
    int n;
    struct safetensors_tensor *tensors; // (n) by name
};

/* Read the header. p: the first n bytes of a file of `file` bytes, the header at least.
 * own:  safetensors_close; names live as long. `what` must, too.
 * err:  ERR_FORMAT, ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t safetensors_open(const char *what, const void *p, size_t n, uint64_t file,
                                struct safetensors *out);

/* Bytes of a file that safetensors_open needs, from its first 8.
 * err:  ERR_FORMAT (1). */
MUST_USE err_t safetensors_header(const char *what, const uint8_t first[8], uint64_t file,
                                  size_t *out);

/* Accepts a zeroed struct. */
void safetensors_close(struct safetensors *s);

/* Tensor of that name; NULL if there is none. */
const struct safetensors_tensor *safetensors_find(const struct safetensors *s, const char *name);

/* Word of the metadata; "" if there is none. */
const char *safetensors_word(const struct safetensors *s, const char *key);

/* Writes a header: begin, words of the metadata, tensors in the order of their data, end. Errors
 * are kept until the end. */
struct safetensors_writer {
    FILE *f;
    char *text;
    size_t bytes; // length of text
    uint64_t at;  // end of the data so far
    int words, tensors;
    bool bad; // no memory
};
void safetensors_begin(struct safetensors_writer *w);
void safetensors_put_word(struct safetensors_writer *w, const char *key, const char *text);
void safetensors_put(struct safetensors_writer *w, const struct safetensors_tensor *t);

/* Write length and header to f, with blanks so that the data begin on a border of
 * SAFETENSORS_ALIGN. Errors of f stay in f. The writer is released in any case; f NULL: only that.
 * err:  ERR_NOMEM. */
MUST_USE err_t safetensors_end(struct safetensors_writer *w, FILE *f);

#endif
