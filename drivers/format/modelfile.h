/* modelfile.h - weights files: a safetensors file that is mapped and used in place.
 *
 * __metadata__: format "hdrig-model", version "1", precision "fp32", "bf16" or "int8", config (JSON
 * of netdims.h), source and licence (words for people), checksum (below).
 * Tensors, by the table of core/net/table.h: products packed as core/net/model.h says, [panels, k,
 * 16] F32 or BF16 or [panels, k/4, 16, 4] I8, each on a border of 64 bytes of the file; then
 * NAME_scale [n] F32 of each I8 product; then plain ones, F32, [repeat * elements] where repeated.
 * Tensors that the network never reads are left out.
 *
 * The reader refuses everything that safetensors.h lists and
 *  1. another format or version, an unknown precision;
 *  2. dimensions that table_check refuses, or that miss or have a member of the wrong kind;
 *  3. a tensor that is missing, unknown, of another type or of another shape;
 *  4. data off their border: 64 bytes for products, 4 for others;
 *  5. numbers that are not finite in plain tensors, exact products and scales, scales below 0.
 * A check of all products would read gigabytes at each start, so only modelfile_verify does it.
 * Writers refuse numbers that are not finite.
 *
 * The checksum detects damage, not malice: 16 hexadecimal digits of the sum modulo 2^64 over all
 * 8-byte words w of the data (little-endian, the last filled up with 0) of z ^ z >> 31 after
 *   z = w + (i + 1) 0x9E3779B97F4A7C15, i the index of the word
 *   z = (z ^ z >> 30) 0xBF58476D1CE4E5B9,  z = (z ^ z >> 27) 0x94D049BB133111EB.
 * thread: any. */
#ifndef FORMAT_MODELFILE_H
#define FORMAT_MODELFILE_H

#include "core/net/model.h"
#include "drivers/format/file.h"
#include "drivers/format/safetensors.h"

struct modelfile {
    struct model model;
    struct model_tensor *tensors; // tensors of model
    struct safetensors head;
    struct file_map map;
    const char *checksum;
};

/* Map a weights file.
 * own:  modelfile_close.
 * err:  ERR_IO, ERR_FORMAT, ERR_UNSUPPORTED (version), ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t modelfile_open(const char *path, struct modelfile *out);

/* The same from memory on a border of 64 bytes. */
MUST_USE err_t modelfile_open_bytes(const char *what, const void *p, size_t n,
                                    struct modelfile *out);

/* Accepts a zeroed struct. */
void modelfile_close(struct modelfile *m);

/* Read all of it and compare the checksum.
 * err:  ERR_FORMAT. */
MUST_USE err_t modelfile_verify(const struct modelfile *m);

/* Type and shape under which a file holds tensor t; name and offsets are not set. */
struct safetensors_tensor modelfile_stored(const struct tensor_spec *t, enum precision file);

/* The word of a precision and back. false: unknown. */
const char *modelfile_precision(enum precision p);
bool modelfile_parse_precision(const char *word, enum precision *out);

/* A checksum in progress; zeroed at the start. */
struct modelfile_sum {
    uint64_t sum, words;
    uint8_t rest[8];
    size_t n_rest;
};
void modelfile_add(struct modelfile_sum *s, const void *p, size_t n);
uint64_t modelfile_total(const struct modelfile_sum *s);

extern const char modelfile_format[], modelfile_version[];

#endif
