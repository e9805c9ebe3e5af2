/* The one file that knows zlib (RFC 1952) and libzstd (RFC 8878). */
#include "drivers/format/compressed.h"

#include "drivers/format/file.h"
#include "drivers/format/origin.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>
#include <zstd.h>
#include <zstd_errors.h>

enum {
    BLOCK = 1 << 16,
    GZIP_ONLY = 16 + MAX_WBITS,
    GZIP_LEVEL = 9,
    GZIP_MEMORY = 6, // short blocks: the arrays of a file have little in common
    GZIP_MEMORY_LONG = MAX_MEM_LEVEL,
    ZSTD_LEVEL = 19,
    ZSTD_WINDOW_LOG_MAX = 27 // 128 MB, what readers accept without asking
};

static const size_t ONCE = (size_t)1 << 30; // zlib counts in unsigned int

static size_t min_size(size_t a, size_t b)
{
    return a < b ? a : b;
}

/* ---- in ---- */

err_t compressed_open(struct compressed_in *in, const char *what, enum compressed_kind kind,
                      const void *p, size_t n)
{
    *in = (struct compressed_in){.what = what, .kind = kind, .p = p, .left = n};
    if (kind == COMPRESSED_GZIP) {
        z_stream *z = calloc(1, sizeof *z);
        if (z && inflateInit2(z, GZIP_ONLY) != Z_OK) {
            free(z);
            z = NULL;
        }
        in->state = z;
    }
    if (kind == COMPRESSED_ZSTD) {
        ZSTD_DStream *z = ZSTD_createDStream();
        if (z)
            ZSTD_DCtx_setParameter(z, ZSTD_d_windowLogMax, ZSTD_WINDOW_LOG_MAX);
        in->state = z;
    }
    if (kind != COMPRESSED_PLAIN && !in->state)
        return err_fail(ERR_NOMEM, "%s: no memory to unpack it", what);
    return OK;
}

static const char no_memory[] = "no memory";

/* Unpack up to *n bytes; *n becomes their number. Returns the error's text, or NULL. */
static const char *inflate_some(struct compressed_in *in, uint8_t *out, size_t *n)
{
    z_stream *z = in->state;
    size_t take = min_size(in->left, ONCE), room = min_size(*n, ONCE);
    z->next_in = (Bytef *)(uintptr_t)in->p;
    z->avail_in = (uInt)take;
    z->next_out = out;
    z->avail_out = (uInt)room;
    int code = inflate(z, Z_NO_FLUSH);
    size_t used = take - z->avail_in;
    in->p += used;
    in->left -= used;
    *n = room - z->avail_out;
    in->ended = code == Z_STREAM_END;
    if (code == Z_OK || code == Z_STREAM_END || (code == Z_BUF_ERROR && in->left == 0))
        return NULL;
    return code == Z_MEM_ERROR ? no_memory : z->msg ? z->msg : "not a gzip stream";
}

static const char *zstd_some(struct compressed_in *in, uint8_t *out, size_t *n)
{
    ZSTD_inBuffer from = {in->p, in->left, 0};
    ZSTD_outBuffer to = {out, *n, 0};
    size_t code = ZSTD_decompressStream(in->state, &to, &from);
    in->p += from.pos;
    in->left -= from.pos;
    *n = to.pos;
    in->ended = code == 0;
    if (!ZSTD_isError(code))
        return NULL;
    return ZSTD_getErrorCode(code) == ZSTD_error_memory_allocation ? no_memory
                                                                   : ZSTD_getErrorName(code);
}

static const char *plain_some(struct compressed_in *in, uint8_t *out, size_t *n)
{
    *n = min_size(*n, in->left);
    if (*n > 0)
        memcpy(out, in->p, *n);
    in->p += *n;
    in->left -= *n;
    in->ended = in->left == 0;
    return NULL;
}

err_t compressed_some(struct compressed_in *in, const char *part, void *out, size_t n, size_t *got)
{
    uint8_t *to = out;
    for (*got = 0; *got < n && !in->ended;) {
        size_t made = n - *got, left = in->left;
        const char *wrong = in->kind == COMPRESSED_GZIP   ? inflate_some(in, to + *got, &made)
                            : in->kind == COMPRESSED_ZSTD ? zstd_some(in, to + *got, &made)
                                                          : plain_some(in, to + *got, &made);
        if (wrong == no_memory)
            return err_fail(ERR_NOMEM, "%s: %s: no memory to unpack it", in->what, part);
        if (wrong)
            return err_fail(ERR_FORMAT, "%s: %s: damaged (%s)", in->what, part, wrong);
        *got += made;
        if (!in->ended && made == 0 && in->left == left)
            return err_fail(ERR_FORMAT, "%s: %s: cut off", in->what, part);
    }
    return OK;
}

err_t compressed_finish(struct compressed_in *in, const char *part)
{
    uint8_t more;
    size_t got;
    err_t e = compressed_some(in, part, &more, 1, &got);
    if (!e && got > 0)
        e = err_fail(ERR_FORMAT, "%s: %s: more bytes than its header says", in->what, part);
    return e;
}

err_t compressed_read(struct compressed_in *in, const char *part, void *out, size_t n)
{
    size_t got;
    err_t e = compressed_some(in, part, out, n, &got);
    if (!e && got < n)
        e = err_fail(ERR_FORMAT, "%s: %s: cut off", in->what, part);
    return e;
}

void compressed_close(struct compressed_in *in)
{
    if (in->state && in->kind == COMPRESSED_GZIP) {
        inflateEnd(in->state);
        free(in->state);
    }
    if (in->state && in->kind == COMPRESSED_ZSTD)
        ZSTD_freeDStream(in->state);
    in->state = NULL;
}

/* ---- out ---- */

/* Only read, by deflate: OS 255 is "unknown" (RFC 1952, 2.3.1). */
static gz_header gzip_head = {.os = 255, .comment = (Bytef *)(uintptr_t)ORIGIN_COMMENT};

static bool is_gzip(enum compressed_kind kind)
{
    return kind == COMPRESSED_GZIP || kind == COMPRESSED_GZIP_LONG;
}

err_t compressed_begin(struct compressed_out *out, const char *what, enum compressed_kind kind,
                       FILE *f, uint64_t size)
{
    *out = (struct compressed_out){.what = what, .kind = kind, .f = f};
    if (is_gzip(kind)) {
        const int memory = kind == COMPRESSED_GZIP ? GZIP_MEMORY : GZIP_MEMORY_LONG;
        z_stream *z = calloc(1, sizeof *z);
        if (z && (deflateInit2(z, GZIP_LEVEL, Z_DEFLATED, GZIP_ONLY, memory, Z_DEFAULT_STRATEGY) !=
                      Z_OK ||
                  deflateSetHeader(z, &gzip_head) != Z_OK)) {
            free(z);
            z = NULL;
        }
        out->state = z;
    }
    if (kind == COMPRESSED_ZSTD) {
        ZSTD_CCtx *z = ZSTD_createCCtx();
        if (z)
            ZSTD_CCtx_setParameter(z, ZSTD_c_compressionLevel, ZSTD_LEVEL);
        if (z)
            ZSTD_CCtx_setPledgedSrcSize(z, size); // little memory for little data
        out->state = z;
    }
    if (kind != COMPRESSED_PLAIN && !out->state)
        return err_fail(ERR_NOMEM, "%s: no memory to pack it", what);
    return OK;
}

static err_t put_bytes(const struct compressed_out *out, const void *p, size_t n)
{
    if (fwrite(p, 1, n, out->f) == n)
        return OK;
    int why = errno;
    return err_fail(file_code(why), "%s: writing failed: %s", out->what, strerror(why));
}

static err_t deflate_some(struct compressed_out *out, const void *p, size_t n, bool end)
{
    z_stream *z = out->state;
    uint8_t block[BLOCK];
    int code;
    err_t e;
    block[0] = 0; // cppcheck does not know that what follows fills it; below too
    z->next_in = (Bytef *)(uintptr_t)p;
    z->avail_in = (uInt)n;
    do {
        z->next_out = block;
        z->avail_out = BLOCK;
        code = deflate(z, end ? Z_FINISH : Z_NO_FLUSH);
        e = put_bytes(out, block, BLOCK - z->avail_out);
    } while (!e && code == Z_OK && (z->avail_out == 0 || end));
    if (!e && code != Z_OK && code != Z_STREAM_END && code != Z_BUF_ERROR)
        return err_fail(ERR_NOMEM, "%s: gzip: error %d", out->what, code);
    return e;
}

static err_t zstd_put(struct compressed_out *out, const void *p, size_t n, bool end)
{
    uint8_t block[BLOCK];
    ZSTD_inBuffer from = {p, n, 0};
    size_t left;
    err_t e;
    block[0] = 0;
    do {
        ZSTD_outBuffer to = {block, BLOCK, 0};
        left = ZSTD_compressStream2(out->state, &to, &from, end ? ZSTD_e_end : ZSTD_e_continue);
        if (ZSTD_isError(left))
            return err_fail(ERR_NOMEM, "%s: zstd: %s", out->what, ZSTD_getErrorName(left));
        e = put_bytes(out, block, to.pos);
    } while (!e && (end ? left > 0 : from.pos < from.size));
    return e;
}

err_t compressed_put(struct compressed_out *out, const void *p, size_t n)
{
    err_t e = OK;
    if (out->kind == COMPRESSED_PLAIN)
        return put_bytes(out, p, n);
    if (out->kind == COMPRESSED_ZSTD)
        return zstd_put(out, p, n, false);
    for (size_t at = 0; is_gzip(out->kind) && at < n && !e; at += ONCE)
        e = deflate_some(out, (const uint8_t *)p + at, min_size(n - at, ONCE), false);
    return e;
}

err_t compressed_end(struct compressed_out *out)
{
    err_t e = OK;
    if (out->state && is_gzip(out->kind)) {
        e = deflate_some(out, "", 0, true);
        deflateEnd(out->state);
        free(out->state);
    }
    if (out->state && out->kind == COMPRESSED_ZSTD) {
        e = zstd_put(out, "", 0, true);
        ZSTD_freeCCtx(out->state);
    }
    out->state = NULL;
    return e;
}
