/* compressed.h - streams of bytes, plain or compressed with gzip or zstd, read from memory and
 * written to a file. A gzip stream that is written carries our mark (origin.h). Only requested
 * bytes are unpacked, so a file decides neither memory nor time.
 * thread: one per stream. */
#ifndef FORMAT_COMPRESSED_H
#define FORMAT_COMPRESSED_H

#include "core/base/err.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

enum compressed_kind {
    COMPRESSED_PLAIN,
    COMPRESSED_GZIP,
    COMPRESSED_ZSTD,
    COMPRESSED_GZIP_LONG // written as gzip of long blocks, which take less time to unpack
};

struct compressed_in {
    const char *what; // begins the sentence
    enum compressed_kind kind;
    const uint8_t *p; // rest of the stream, not owned
    size_t left;
    bool ended;  // all of the stream has been read
    void *state; // owned by the library
};

/* Read a stream of n bytes at p.
 * own:  compressed_close.
 * err:  ERR_NOMEM. */
MUST_USE err_t compressed_open(struct compressed_in *in, const char *what,
                               enum compressed_kind kind, const void *p, size_t n);

/* Unpack the next n bytes; *got is less only at the end of the stream. `part` is for the
 * sentence.
 * err:  ERR_FORMAT (not such a stream, damaged, cut off), ERR_NOMEM. */
MUST_USE err_t compressed_some(struct compressed_in *in, const char *part, void *out, size_t n,
                               size_t *got);

/* As compressed_some, and fewer bytes are an error. */
MUST_USE err_t compressed_read(struct compressed_in *in, const char *part, void *out, size_t n);

/* The stream ends here, and its checksum, if it has one, is right.
 * err:  as compressed_some; ERR_FORMAT (it goes on). */
MUST_USE err_t compressed_finish(struct compressed_in *in, const char *part);

/* Accepts a zeroed stream. */
void compressed_close(struct compressed_in *in);

struct compressed_out {
    const char *what;
    enum compressed_kind kind;
    FILE *f; // not owned
    void *state;
};

/* Write a stream of `size` bytes into f, well packed rather than fast.
 * own:  compressed_end.
 * err:  ERR_NOMEM. */
MUST_USE err_t compressed_begin(struct compressed_out *out, const char *what,
                                enum compressed_kind kind, FILE *f, uint64_t size);

/* err:  ERR_NOMEM, ERR_IO, ERR_LIMIT (no space). */
MUST_USE err_t compressed_put(struct compressed_out *out, const void *p, size_t n);

/* Complete the stream and release its state. Accepts a zeroed one.
 * err:  as compressed_put. */
MUST_USE err_t compressed_end(struct compressed_out *out);

#endif
