/* Reading decodes one chunk (scanline block or tile) after the other, with one pipeline whose
 * buffers are used again, and converts it into the planes of the result. Writing converts one block
 * of rows after the other.
 *
 * OpenEXRCore 3.1 as distributed writes behind its buffers when it unpacks B44 files whose sides
 * are not multiples of four and miscounts the rows of subsampled channels; both kinds are refused
 * from the header. DWA it cannot decode. */
#include "drivers/format/exrfile.h"

#include "core/base/half.h"
#include "drivers/format/file.h"

#include <OpenEXR/openexr.h>
#include <endian.h>
#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    PART = 0,
    COLOURS = 3,
    CHANNELS_MAX = COLOURS + 2,
    EXPANSION_MAX =
        1032 // samples per byte of the file: DEFLATE's limit, above that of RLE, PIZ and PXR24
};

/* The library's last message. It reports while it holds its own locks, so asking it for user data
 * would hang. */
static _Thread_local char last_words[256];

static void keep_words(exr_const_context_t ctxt, exr_result_t code, const char *words)
{
    (void)ctxt;
    (void)code;
    snprintf(last_words, sizeof last_words, "%s", words ? words : "");
}

static err_t library_error(const char *name, exr_result_t code)
{
    err_t e = ERR_FORMAT;
    if (code == EXR_ERR_OUT_OF_MEMORY)
        e = ERR_NOMEM;
    if (code == EXR_ERR_FEATURE_NOT_IMPLEMENTED)
        e = ERR_UNSUPPORTED;
    if (code == EXR_ERR_WRITE_IO)
        e = ERR_IO;
    return err_fail(e, "%s: EXR: %s", name,
                    last_words[0] ? last_words : exr_get_default_error_message(code));
}

/* exr_add_part of 3.1 writes through NULL when there is no memory for a second part: it gets this
 * then, and the file is given up. */
static _Thread_local struct {
    _Alignas(max_align_t) uint8_t bytes[8192];
    size_t used;
    bool open;
} reserve;

static void *take_reserve(size_t n)
{
    n = (n + sizeof(max_align_t) - 1) / sizeof(max_align_t) * sizeof(max_align_t);
    if (!reserve.open || n > sizeof reserve.bytes - reserve.used)
        return NULL;
    void *p = memset(reserve.bytes + reserve.used, 0, n);
    reserve.used += n;
    return p;
}

/* Zeroed, so that a chunk that decodes to less than it should leaves zeros and not old memory. */
static void *alloc_zeroed(size_t n)
{
    void *p = calloc(1, n);
    if (!p)
        p = take_reserve(n);
    return p;
}

static void free_block(void *p)
{
    uintptr_t at = (uintptr_t)p - (uintptr_t)reserve.bytes;
    if (at >= sizeof reserve.bytes)
        free(p);
}

static exr_context_initializer_t library_settings(void)
{
    exr_context_initializer_t s = EXR_DEFAULT_CONTEXT_INITIALIZER;
    last_words[0] = 0;
    s.error_handler_fn = keep_words;
    s.alloc_fn = alloc_zeroed;
    s.free_fn = free_block;
    s.max_image_width = s.max_tile_width = EXRFILE_SIDE_MAX;
    s.max_image_height = s.max_tile_height = EXRFILE_SIDE_MAX;
    s.flags = EXR_CONTEXT_FLAG_STRICT_HEADER | EXR_CONTEXT_FLAG_DISABLE_CHUNK_RECONSTRUCTION;
    return s;
}

/* ---- reading ---- */

struct memory {
    const uint8_t *p;
    size_t n;
};

static int64_t memory_size(exr_const_context_t ctxt, void *user)
{
    (void)ctxt;
    return (int64_t)((struct memory *)user)->n;
}

static int64_t memory_read(exr_const_context_t ctxt, void *user, void *out, uint64_t n, uint64_t at,
                           exr_stream_error_func_ptr_t error)
{
    const struct memory *m = user;
    (void)ctxt;
    (void)error;
    if (at >= m->n)
        return 0;
    if (n > m->n - at)
        n = m->n - at;
    memcpy(out, m->p + at, n);
    return (int64_t)n;
}

struct reader {
    const char *name;
    size_t n_bytes;
    exr_context_t ctxt;
    exr_storage_t storage;
    int first_row;                // first row of the data window
    const char *channel[COLOURS]; // in the file; three times "Y" if it is grey
    struct image *out;
    int x, y; // in out, top left pixel of the chunk being read
    exr_decode_pipeline_t pipe;
    bool pipe_open;
};

static err_t check_window(struct reader *r)
{
    exr_attr_box2i_t data, display;
    exr_result_t code = exr_get_data_window(r->ctxt, PART, &data);
    if (!code)
        code = exr_get_display_window(r->ctxt, PART, &display);
    if (code)
        return library_error(r->name, code);
    if (memcmp(&data, &display, sizeof data) != 0)
        return err_fail(
            ERR_UNSUPPORTED,
            "%s: EXR: data window (%d %d %d %d) is not the display window (%d %d %d %d)", r->name,
            data.min.x, data.min.y, data.max.x, data.max.y, display.min.x, display.min.y,
            display.max.x, display.max.y);
    int64_t w = (int64_t)data.max.x - data.min.x + 1, h = (int64_t)data.max.y - data.min.y + 1;
    if (w < 1 || h < 1 || w > EXRFILE_SIDE_MAX || h > EXRFILE_SIDE_MAX || w * h > EXRFILE_PX_MAX)
        return err_fail(ERR_FORMAT,
                        "%s: EXR: %lld x %lld px, allowed are 1 to %d a side and %d in all",
                        r->name, (long long)w, (long long)h, EXRFILE_SIDE_MAX, EXRFILE_PX_MAX);
    r->first_row = data.min.y;
    r->out->w = (int)w;
    r->out->h = (int)h;
    r->out->channels = COLOURS;
    return OK;
}

static err_t check_coding(struct reader *r)
{
    exr_compression_t c;
    exr_result_t code = exr_get_storage(r->ctxt, PART, &r->storage);
    if (!code)
        code = exr_get_compression(r->ctxt, PART, &c);
    if (code)
        return library_error(r->name, code);
    if (r->storage != EXR_STORAGE_SCANLINE && r->storage != EXR_STORAGE_TILED)
        return err_fail(ERR_UNSUPPORTED, "%s: EXR: deep data are not supported", r->name);
    if (c > EXR_COMPRESSION_PXR24)
        return err_fail(ERR_UNSUPPORTED,
                        "%s: EXR: compression %d (B44 or DWA) is not supported, use ZIP or PIZ",
                        r->name, (int)c);
    return OK;
}

static bool has_channel(const exr_attr_chlist_t *list, const char *name)
{
    for (int i = 0; i < list->num_channels; i++)
        if (strcmp(list->entries[i].name.str, name) == 0)
            return true;
    return false;
}

static err_t check_channels(struct reader *r)
{
    static const char *const rgb[COLOURS] = {"R", "G", "B"};
    const exr_attr_chlist_t *list;
    exr_result_t code = exr_get_channels(r->ctxt, PART, &list);
    if (code)
        return library_error(r->name, code);
    for (int i = 0; i < list->num_channels; i++)
        if (list->entries[i].x_sampling != 1 || list->entries[i].y_sampling != 1)
            return err_fail(ERR_UNSUPPORTED, "%s: EXR: channel %.64s is subsampled %d x %d",
                            r->name, list->entries[i].name.str, list->entries[i].x_sampling,
                            list->entries[i].y_sampling);
    bool grey = has_channel(list, "Y") && !has_channel(list, "RY") && !has_channel(list, "R");
    for (int c = 0; c < COLOURS; c++) {
        r->channel[c] = grey ? "Y" : rgb[c];
        if (!has_channel(list, r->channel[c]))
            return err_fail(ERR_FORMAT, "%s: EXR: has no channel %s, only %d others", r->name,
                            r->channel[c], list->num_channels);
    }
    uint64_t samples = (uint64_t)r->out->w * (uint64_t)r->out->h * (uint64_t)list->num_channels;
    if (samples / EXPANSION_MAX > r->n_bytes)
        return err_fail(ERR_FORMAT, "%s: EXR: %zu bytes cannot hold %d x %d px of %d channels",
                        r->name, r->n_bytes, r->out->w, r->out->h, list->num_channels);
    return OK;
}

static float read_sample(const uint8_t *p, int type)
{
    uint16_t h;
    uint32_t u;
    float f;
    if (type == EXR_PIXEL_HALF) {
        memcpy(&h, p, sizeof h);
        return half_to_float(le16toh(h));
    }
    memcpy(&u, p, sizeof u);
    u = le32toh(u);
    if (type == EXR_PIXEL_UINT)
        return (float)u;
    memcpy(&f, &u, sizeof f);
    return f;
}

static void unpack_row(const struct reader *r, const exr_coding_channel_info_t *ch,
                       const uint8_t *in, int y)
{
    size_t width = (size_t)r->out->w, plane = width * (size_t)r->out->h;
    for (size_t c = 0; c < COLOURS; c++) {
        if (strcmp(ch->channel_name, r->channel[c]) != 0)
            continue;
        float *out = r->out->px + c * plane + (size_t)(r->y + y) * width + (size_t)r->x;
        for (int i = 0; i < ch->width; i++)
            out[i] = read_sample(in + (ptrdiff_t)i * ch->bytes_per_element, ch->data_type);
    }
}

/* Called by the library with a decoded chunk: row after row, in each row all channels one after the
 * other. Its own routine for this writes through the pointers of channels that were not requested.
 * */
static exr_result_t unpack_chunk(exr_decode_pipeline_t *pipe)
{
    const struct reader *r = pipe->decoding_user_data;
    const uint8_t *in = pipe->unpacked_buffer;
    uint64_t row_bytes = 0;
    for (int i = 0; i < pipe->channel_count; i++)
        row_bytes +=
            (uint64_t)pipe->channels[i].width * (uint64_t)pipe->channels[i].bytes_per_element;
    if (!in || row_bytes * (uint64_t)pipe->chunk.height != pipe->chunk.unpacked_size)
        return EXR_ERR_CORRUPT_CHUNK;
    for (int y = 0; y < pipe->chunk.height; y++)
        for (int i = 0; i < pipe->channel_count; i++) {
            const exr_coding_channel_info_t *ch = &pipe->channels[i];
            unpack_row(r, ch, in, y);
            in += (ptrdiff_t)ch->width * ch->bytes_per_element;
        }
    return EXR_ERR_SUCCESS;
}

static err_t check_chunk(const struct reader *r, const exr_chunk_info_t *chunk)
{
    bool raw = chunk->compression == EXR_COMPRESSION_NONE;
    if (chunk->width < 1 || chunk->height < 1 || chunk->width > r->out->w - r->x ||
        chunk->height > r->out->h - r->y || (raw && chunk->packed_size != chunk->unpacked_size))
        return err_fail(ERR_FORMAT, "%s: EXR: a chunk of %d x %d px in %llu bytes at (%d, %d)",
                        r->name, chunk->width, chunk->height,
                        (unsigned long long)chunk->packed_size, r->x, r->y);
    return OK;
}

/* The chunk whose top left pixel is (r->x, r->y). */
static err_t read_chunk(struct reader *r, const exr_chunk_info_t *chunk)
{
    err_t e = check_chunk(r, chunk);
    if (e)
        return e;
    exr_result_t code;
    if (r->pipe_open) {
        code = exr_decoding_update(r->ctxt, PART, chunk, &r->pipe);
    } else {
        code = exr_decoding_initialize(r->ctxt, PART, chunk, &r->pipe);
        r->pipe_open = true;
        if (!code)
            code = exr_decoding_choose_default_routines(r->ctxt, PART, &r->pipe);
        r->pipe.unpack_and_convert_fn = unpack_chunk;
        r->pipe.decoding_user_data = r;
    }
    if (!code)
        code = exr_decoding_run(r->ctxt, PART, &r->pipe);
    return code ? library_error(r->name, code) : OK;
}

static err_t read_scanlines(struct reader *r)
{
    int32_t lines;
    exr_result_t code = exr_get_scanlines_per_chunk(r->ctxt, PART, &lines);
    if (code)
        return library_error(r->name, code);
    for (r->y = 0; r->y < r->out->h; r->y += lines) {
        exr_chunk_info_t chunk;
        code = exr_read_scanline_chunk_info(r->ctxt, PART, r->first_row + r->y, &chunk);
        err_t e = code ? library_error(r->name, code) : read_chunk(r, &chunk);
        if (e)
            return e;
    }
    return OK;
}

static err_t read_tiles(struct reader *r)
{
    int32_t tw, th;
    exr_result_t code = exr_get_tile_sizes(r->ctxt, PART, 0, 0, &tw, &th);
    if (!code && (tw < 1 || th < 1))
        code = EXR_ERR_INVALID_ATTR;
    if (code)
        return library_error(r->name, code);
    for (r->y = 0; r->y < r->out->h; r->y += th)
        for (r->x = 0; r->x < r->out->w; r->x += tw) {
            exr_chunk_info_t chunk;
            code = exr_read_tile_chunk_info(r->ctxt, PART, r->x / tw, r->y / th, 0, 0, &chunk);
            err_t e = code ? library_error(r->name, code) : read_chunk(r, &chunk);
            if (e)
                return e;
        }
    return OK;
}

static err_t read_planes(struct reader *r)
{
    r->out->px = calloc((size_t)r->out->w * (size_t)r->out->h, COLOURS * sizeof(float));
    if (!r->out->px)
        return err_fail(ERR_NOMEM, "%s: no memory for %d x %d px", r->name, r->out->w, r->out->h);
    return r->storage == EXR_STORAGE_TILED ? read_tiles(r) : read_scanlines(r);
}

err_t exrfile_read_mem(const void *bytes, size_t n, const char *name, struct image *out)
{
    struct memory m = {bytes, n};
    struct reader r = {.name = name, .n_bytes = n, .out = out};
    exr_context_initializer_t s = library_settings();
    s.user_data = &m;
    s.read_fn = memory_read;
    s.size_fn = memory_size;
    memset(out, 0, sizeof *out);
    exr_result_t code = exr_start_read(&r.ctxt, name, &s);
    if (code)
        return library_error(name, code);
    err_t e = check_window(&r);
    if (!e)
        e = check_coding(&r);
    if (!e)
        e = check_channels(&r);
    if (!e)
        e = read_planes(&r);
    if (r.pipe_open)
        exr_decoding_destroy(r.ctxt, &r.pipe);
    exr_finish(&r.ctxt);
    if (e)
        exrfile_free(out);
    return e;
}

err_t exrfile_read(const char *path, struct image *out)
{
    struct file_map m;
    memset(out, 0, sizeof *out);
    err_t e = file_map(path, EXRFILE_BYTES_MAX, &m);
    if (!e)
        e = exrfile_read_mem(m.p, m.n, path, out);
    file_unmap(&m);
    return e;
}

void exrfile_free(struct image *im)
{
    free(im->px);
    memset(im, 0, sizeof *im);
}

/* ---- writing ---- */

struct channel {
    const char *name;
    const float *px; // (h, w)
    bool half;
    void *rows; // one block of converted rows
};

struct writer {
    const char *path;
    int w, h, part;
    FILE *f;
    uint64_t at; // position of f
    exr_context_t ctxt;
    struct channel channel[CHANNELS_MAX];
    int n_channels;
    exr_encode_pipeline_t pipe;
    bool pipe_open;
    size_t saturated;
};

static int64_t file_write(exr_const_context_t ctxt, void *user, const void *bytes, uint64_t n,
                          uint64_t at, exr_stream_error_func_ptr_t error)
{
    struct writer *w = user;
    (void)ctxt;
    (void)error;
    if (at != w->at && fseeko(w->f, (off_t)at, SEEK_SET) != 0)
        return -1;
    size_t put = fwrite(bytes, 1, n, w->f);
    w->at = at + put;
    return (int64_t)put;
}

static void add_channel(struct writer *w, const char *name, const float *px, bool half)
{
    if (px)
        w->channel[w->n_channels++] = (struct channel){name, px, half, NULL};
}

static exr_result_t declare_channels(struct writer *w)
{
    exr_result_t code = EXR_ERR_SUCCESS;
    for (int i = 0; i < w->n_channels && !code; i++)
        code = exr_add_channel(w->ctxt, w->part, w->channel[i].name,
                               w->channel[i].half ? EXR_PIXEL_HALF : EXR_PIXEL_FLOAT,
                               EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1);
    return code;
}

/* World to camera for row vectors and a camera with y up: the columns are those of R transposed, y
 * negated. */
static exr_attr_m44f_t world_to_camera(const struct camera *c)
{
    float w = c->q[0], x = c->q[1], y = c->q[2], z = c->q[3];
    const float rot[3][3] = {
        {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
        {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
        {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)},
    };
    exr_attr_m44f_t out = {{0}};
    for (int row = 0; row < 3; row++) {
        float sign = row == 1 ? -1.0f : 1.0f;
        for (int k = 0; k < 3; k++)
            out.m[4 * k + row] = sign * rot[row][k];
        out.m[12 + row] = sign * c->t[row];
    }
    out.m[15] = 1.0f;
    return out;
}

/* World to NDC: homogeneous x = (fx X + cx Z) / w, y = (cy Z - fy Y) / h with Y up, divided by
 * Z. */
static exr_attr_m44f_t world_to_ndc(const struct camera *c, const exr_attr_m44f_t *cam)
{
    exr_attr_m44f_t out = {{0}};
    for (int k = 0; k < 4; k++) {
        float x = cam->m[4 * k], y = cam->m[4 * k + 1], z = cam->m[4 * k + 2];
        out.m[4 * k] = (c->fx * x + c->cx * z) / (float)c->w;
        out.m[4 * k + 1] = (c->cy * z - c->fy * y) / (float)c->h;
        out.m[4 * k + 2] = out.m[4 * k + 3] = z;
    }
    return out;
}

static exr_result_t declare_camera(exr_context_t ctxt, const struct camera *c)
{
    exr_attr_m44f_t cam = world_to_camera(c), ndc = world_to_ndc(c, &cam);
    const exr_attr_v2f_t focal = {{{c->fx, c->fy}}}, centre = {{{c->cx, c->cy}}};
    exr_result_t code = exr_attr_set_m44f(ctxt, PART, "worldToCamera", &cam);
    if (!code)
        code = exr_attr_set_m44f(ctxt, PART, "worldToNDC", &ndc);
    if (!code)
        code = exr_attr_set_v2f(ctxt, PART, "hdrigFocal", &focal);
    if (!code)
        code = exr_attr_set_v2f(ctxt, PART, "hdrigCentre", &centre);
    return code;
}

static exr_result_t add_part(struct writer *w, const char *name)
{
    reserve.open = true;
    reserve.used = 0;
    exr_result_t code = exr_add_part(w->ctxt, name, EXR_STORAGE_SCANLINE, NULL);
    reserve.open = false;
    return reserve.used ? EXR_ERR_OUT_OF_MEMORY : code;
}

/* Part w->part as every file has it. */
static exr_result_t declare_part(struct writer *w, const char *name, exr_compression_t coding)
{
    static const exr_attr_chromaticities_t rec709 = {0.64f, 0.33f, 0.30f,   0.60f,
                                                     0.15f, 0.06f, 0.3127f, 0.3290f};
    exr_result_t code = add_part(w, name);
    if (!code)
        code = exr_initialize_required_attr_simple(w->ctxt, w->part, w->w, w->h, coding);
    if (!code)
        code = declare_channels(w);
    if (!code)
        code = exr_attr_set_chromaticities(w->ctxt, w->part, "chromaticities", &rec709);
    return code;
}

static exr_result_t write_header(struct writer *w, const struct exrfile_extra *extra)
{
    exr_result_t code = declare_part(w, "hdrig", EXR_COMPRESSION_ZIP);
    if (!code && extra->exposure_s > 0.0f)
        code = exr_attr_set_float(w->ctxt, PART, "expTime", extra->exposure_s);
    if (!code && extra->log2t)
        code = exr_attr_set_float(w->ctxt, PART, "hdrigExposureLog2", *extra->log2t);
    if (!code && extra->cam)
        code = declare_camera(w->ctxt, extra->cam);
    return code ? code : exr_write_header(w->ctxt);
}

/* NaN becomes 0 and infinity the largest float, so that the file holds finite values only. */
static size_t clean_floats(const float *in, size_t n, float *out)
{
    size_t saturated = 0;
    for (size_t i = 0; i < n; i++) {
        bool inf = isinf(in[i]);
        out[i] = isnan(in[i]) ? 0.0f : inf ? copysignf(FLT_MAX, in[i]) : in[i];
        saturated += inf;
    }
    return saturated;
}

static size_t clean_half(const float *in, size_t n, uint16_t *out)
{
    size_t saturated = half_from_floats_sat(in, n, out);
    for (size_t i = 0; i < n; i++)
        if (isnan(in[i]))
            out[i] = 0;
    return saturated;
}

static exr_result_t write_block(struct writer *w, int y)
{
    exr_chunk_info_t chunk;
    exr_result_t code = exr_write_scanline_chunk_info(w->ctxt, w->part, y, &chunk);
    if (!code)
        code = w->pipe_open ? exr_encoding_update(w->ctxt, w->part, &chunk, &w->pipe)
                            : exr_encoding_initialize(w->ctxt, w->part, &chunk, &w->pipe);
    if (code)
        return code;
    size_t at = (size_t)y * (size_t)w->w, n = (size_t)chunk.height * (size_t)w->w;
    for (int i = 0; i < w->pipe.channel_count; i++) {
        exr_coding_channel_info_t *out = &w->pipe.channels[i];
        struct channel *in = w->channel;
        while (strcmp(in->name, out->channel_name) != 0)
            in++;
        w->saturated += in->half ? clean_half(in->px + at, n, in->rows)
                                 : clean_floats(in->px + at, n, in->rows);
        out->encode_from_ptr = in->rows;
        out->user_pixel_stride = out->bytes_per_element;
        out->user_line_stride = out->bytes_per_element * w->w;
    }
    if (!w->pipe_open)
        code = exr_encoding_choose_default_routines(w->ctxt, w->part, &w->pipe);
    w->pipe_open = true;
    return code ? code : exr_encoding_run(w->ctxt, w->part, &w->pipe);
}

/* All of part w->part. */
static err_t write_blocks(struct writer *w)
{
    int32_t lines;
    exr_result_t code = exr_get_scanlines_per_chunk(w->ctxt, w->part, &lines);
    for (int i = 0; i < w->n_channels && !code; i++) {
        struct channel *c = &w->channel[i];
        if (c->rows) // set by the part before: all parts have the same blocks
            continue;
        c->rows = calloc((size_t)lines * (size_t)w->w, c->half ? sizeof(uint16_t) : sizeof(float));
        if (!c->rows)
            return err_fail(ERR_NOMEM, "%s: no memory for %d rows of %d px", w->path, lines, w->w);
    }
    for (int y = 0; y < w->h && !code; y += lines)
        code = write_block(w, y);
    if (w->pipe_open)
        exr_encoding_destroy(w->ctxt, &w->pipe);
    w->pipe_open = false;
    return code ? library_error(w->path, code) : OK;
}

/* Start with an empty file. own: write_end. */
static exr_result_t write_begin(struct writer *w)
{
    exr_context_initializer_t s = library_settings();
    s.user_data = w;
    s.write_fn = file_write;
    return exr_start_write(&w->ctxt, w->path, EXR_WRITE_FILE_DIRECTLY, &s);
}

/* e: an earlier error, kept. */
static err_t write_end(struct writer *w, err_t e)
{
    exr_result_t code = exr_finish(&w->ctxt); // writes the table of chunks
    for (int i = 0; i < w->n_channels; i++)
        free(w->channel[i].rows);
    return e || !code ? e : library_error(w->path, code);
}

static err_t write_open_file(struct writer *w, const struct exrfile_extra *extra)
{
    exr_result_t code = write_begin(w);
    if (!code)
        code = write_header(w, extra);
    return write_end(w, code ? library_error(w->path, code) : write_blocks(w));
}

err_t exrfile_write(const char *path, const struct image *rgb, const struct exrfile_extra *extra,
                    size_t *saturated)
{
    if (saturated)
        *saturated = 0;
    if (!rgb->px || rgb->channels < COLOURS || rgb->w < 1 || rgb->h < 1 ||
        rgb->w > EXRFILE_SIDE_MAX || rgb->h > EXRFILE_SIDE_MAX)
        return err_fail(
            ERR_ARG, "%s: EXR: no RGB image of 1 to %d px a side to write (%d x %d, %d channels)",
            path, EXRFILE_SIDE_MAX, rgb->w, rgb->h, rgb->channels);
    struct writer w = {.path = path, .w = rgb->w, .h = rgb->h};
    size_t plane = (size_t)rgb->w * (size_t)rgb->h;
    add_channel(&w, "A", extra->alpha, extra->half);
    add_channel(&w, "B", rgb->px + 2 * plane, extra->half);
    add_channel(&w, "G", rgb->px + plane, extra->half);
    add_channel(&w, "R", rgb->px, extra->half);
    add_channel(&w, "Z", extra->depth, false);
    err_t e = file_create(path, &w.f);
    if (e)
        return e;
    e = write_open_file(&w, extra);
    if (e && !ferror(w.f)) { // else file_finish knows the system's reason
        file_discard(w.f, path);
        return e;
    }
    if (saturated)
        *saturated = w.saturated;
    return file_finish(w.f, path);
}

/* ---- several parts ---- */

static exr_result_t declare_attrs(struct writer *w, const struct exrfile_part *part)
{
    exr_result_t code = EXR_ERR_SUCCESS;
    for (int i = 0; i < part->n_attr && !code; i++) {
        const struct exrfile_attr *a = &part->attr[i];
        code = a->text ? exr_attr_set_string(w->ctxt, w->part, a->name, a->text)
                       : exr_attr_set_float(w->ctxt, w->part, a->name, a->number);
    }
    return code;
}

static exr_result_t write_headers(struct writer *w, const struct exrfile_parts *p)
{
    exr_result_t code = EXR_ERR_SUCCESS;
    for (w->part = 0; w->part < p->n && !code; w->part++) {
        code = declare_part(w, p->part[w->part].name, EXR_COMPRESSION_PIZ);
        if (!code)
            code = declare_attrs(w, &p->part[w->part]);
    }
    return code ? code : exr_write_header(w->ctxt);
}

static err_t write_part(struct writer *w, const struct exrfile_parts *p)
{
    const struct image *im;
    err_t e = p->fill(p->ctx, w->part, &im);
    if (e)
        return e;
    if (!im->px || im->channels < COLOURS || im->w != w->w || im->h != w->h)
        return err_fail(ERR_ARG, "%s: EXR: part %s is %d x %d of %d channels instead of %d x %d",
                        w->path, p->part[w->part].name, im->w, im->h, im->channels, w->w, w->h);
    size_t plane = (size_t)w->w * (size_t)w->h;
    for (int i = 0; i < COLOURS; i++) // B, G, R
        w->channel[i].px = im->px + (size_t)(COLOURS - 1 - i) * plane;
    return write_blocks(w);
}

err_t exrfile_put_parts(FILE *f, const char *name, const struct exrfile_parts *p)
{
    struct writer w = {.path = name, .w = p->w, .h = p->h, .f = f, .n_channels = COLOURS};
    if (p->n < 1 || p->w < 1 || p->h < 1 || p->w > EXRFILE_SIDE_MAX || p->h > EXRFILE_SIDE_MAX)
        return err_fail(ERR_ARG, "%s: EXR: %d parts of %d x %d px, allowed are 1 to %d a side",
                        name, p->n, p->w, p->h, EXRFILE_SIDE_MAX);
    w.channel[0] = (struct channel){"B", NULL, true, NULL};
    w.channel[1] = (struct channel){"G", NULL, true, NULL};
    w.channel[2] = (struct channel){"R", NULL, true, NULL};
    exr_result_t code = write_begin(&w);
    if (!code)
        code = write_headers(&w, p);
    err_t e = code ? library_error(name, code) : OK;
    for (w.part = 0; w.part < p->n && !e; w.part++)
        e = write_part(&w, p);
    return write_end(&w, e);
}
