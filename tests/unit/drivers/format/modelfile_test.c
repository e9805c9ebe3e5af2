/* Weights files of the smallest network: what is written is read, and what is spoilt is refused. */
#include "drivers/format/modelfile.h"

#include "core/base/bytes.h"
#include "core/kernels/gemm.h"
#include "core/net/hashed.h"
#include "drivers/format/modelwrite.h"

#include "tests/unit/core/net/tiny_net.h"
#include "tests/unit/tmpdir.h"

#include <dirent.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

static struct arena tmp;
static atomic_bool cancel;

/* A value that a test puts into a tensor. */
static struct {
    const char *name;
    size_t at;
    float value;
    err_t fail;
} spoil;

static err_t fetch(void *ctx, const struct run *r, const struct tensor_spec *t, float *out)
{
    (void)ctx, (void)r;
    hashed_fill(t, 1, 0, table_count(t), out);
    if (spoil.name && strcmp(spoil.name, t->name) == 0) {
        out[spoil.at] = spoil.value;
        if (spoil.fail)
            return err_fail(spoil.fail, "no such value");
    }
    return OK;
}

static bool completes; // the network has the completion branch

static err_t write_model(const char *path, enum precision p, int threads)
{
    struct pool *pool = NULL;
    struct modelwrite w = {tiny_net, p, "hashed 1", "none", fetch, NULL};
    w.dims.complete = completes;
    assert_int_equal(pool_open(&pool, threads), OK);
    arena_free(&tmp);
    assert_int_equal(arena_init(&tmp, "tmp", modelwrite_need(&w, threads)), OK);
    const struct run r = {.pool = pool, .tmp = &tmp, .cancel = &cancel};
    err_t e = modelwrite_run(&r, &w, path);
    assert_true(tmp.used == 0);
    pool_close(pool);
    return e;
}

/* ---- what is written is read ---- */

static float value_at(const struct weight *w, int o, int i)
{
    int k = weight_k(w);
    size_t at = ((size_t)(o / PANEL) * (size_t)k + (size_t)i) * PANEL + (size_t)(o % PANEL);
    if (w->type == PRECISION_F32)
        return ((const float *)w->panels)[at];
    if (w->type == PRECISION_BF16) {
        uint32_t u = (uint32_t)((const uint16_t *)w->panels)[at] << 16;
        float v;
        memcpy(&v, &u, sizeof v);
        return v;
    }
    at = ((size_t)(o / PANEL) * (size_t)(k / 4) + (size_t)(i / 4)) * PANEL * 4 +
         (size_t)(o % PANEL) * 4 + (size_t)(i % 4);
    return w->scale[o] * (float)((const int8_t *)w->panels)[at];
}

static int turned; // products that are rotated

/* y_i = sum over j of (-1)^(pairs of neighbouring bits in j + bits that i and j share) x_j /
 * sqrt(edge): see hadamard_fn of gemm.h. */
static void rotate(float *row, int k, int edge)
{
    float out[1024];
    assert_true(edge <= 1024);
    for (int at = 0; at < k; at += edge) {
        for (int i = 0; i < edge; i++) {
            double sum = 0;
            for (int j = 0; j < edge; j++)
                sum +=
                    __builtin_parity((unsigned)(j & j >> 1)) ^ __builtin_parity((unsigned)(i & j))
                        ? -row[at + j]
                        : row[at + j];
            out[i] = (float)(sum / sqrt(edge));
        }
        memcpy(row + at, out, (size_t)edge * sizeof *out);
    }
}

/* A product of the model against the values it was made of. */
static void check_product(const struct model *m, const struct tensor_spec *t, const float *want)
{
    char name[NET_NAME_CAP];
    struct weight w;
    snprintf(name, sizeof name, "%.*s", (int)(strlen(t->name) - strlen(".weight")), t->name);
    assert_int_equal(model_weight(m, name, &w), OK);
    struct product_shape p = table_product(t);
    assert_true(w.n == p.n && w.segs == p.segs && w.seg == p.seg);
    assert_int_equal(w.rotate, model_rotation(t, m->precision));
    turned += w.rotate > 0;
    assert_true(weight_k(&w) <= 20000);
    assert_int_equal(w.type, model_type(t, m->precision));
    assert_true((uintptr_t)w.panels % 64 == 0 && !w.scale == (w.type != PRECISION_S8));
    for (int o = 0; o < w.n; o++) {
        static float row[20000]; // more than any k
        /* kernels hand what rounding took on, so up to twice of it is missing */
        float bound = 0, step = w.type == PRECISION_F32 ? 0 : w.segs > 1 ? 0x1p-7f : 0x1p-8f;
        for (int i = 0; i < weight_k(&w); i++)
            row[i] = want[table_source(t, o, i)];
        if (w.rotate)
            rotate(row, weight_k(&w), w.rotate);
        for (int i = 0; i < weight_k(&w); i++)
            bound = fmaxf(bound, fabsf(row[i]));
        for (int i = 0; i < weight_k(&w); i++)
            assert_true(fabsf(value_at(&w, o, i) - row[i]) <= step * 1.01f * bound);
    }
    snprintf(name, sizeof name, "%.*s.bias", (int)(strlen(t->name) - strlen(".weight")), t->name);
    const struct model_tensor *bias = model_find(m, name);
    assert_ptr_equal(w.bias, bias ? bias->data : NULL);
    if (bias)
        assert_true(table_count(&bias->spec) * (size_t)bias->spec.repeat == (size_t)w.n);
}

struct comparing {
    const struct model *m;
    int n;
};

static err_t check_tensor(void *ctx, const struct tensor_spec *t)
{
    static float want[100000];
    struct comparing *c = ctx;
    const float *plain;
    size_t n = table_count(t);
    assert_true(n <= sizeof want / sizeof want[0]);
    hashed_fill(t, 1, 0, n, want);
    if (!t->used) {
        assert_null(model_find(c->m, t->name));
        return OK;
    }
    assert_string_equal(c->m->tensors[c->n++].spec.name, t->name);
    if (t->role != ROLE_PLAIN) {
        check_product(c->m, t, want);
        return OK;
    }
    assert_int_equal(model_plain(c->m, t->name, &plain), OK);
    for (int k = 0; k < t->repeat; k++)
        assert_memory_equal(plain + (size_t)k * n, want, n * sizeof *want);
    return OK;
}

static void what_is_written_is_read(void **state)
{
    (void)state;
    const char *path = tmpdir_path("model.hdrig");
    for (int p = PRECISION_F32; p <= PRECISION_S8; p++) {
        struct modelfile m;
        const float *plain;
        struct weight w;
        assert_int_equal(write_model(path, (enum precision)p, 1), OK);
        assert_int_equal(modelfile_open(path, &m), OK);
        assert_memory_equal(&m.model.dims, &tiny_net, sizeof tiny_net);
        assert_string_equal(m.model.source, "hashed 1");
        assert_string_equal(m.model.licence, "none");
        assert_int_equal(m.model.precision, p);
        struct comparing c = {&m.model, 0};
        assert_int_equal(table_walk(&tiny_net, check_tensor, &c), OK);
        assert_int_equal(c.n, m.model.n);
        assert_int_equal(turned, p == PRECISION_S8 ? 9 : 0); // fc2 of the blocks
        assert_int_equal(modelfile_verify(&m), OK);
        assert_int_equal(model_plain(&m.model, "encoder.nothing", &plain), ERR_FORMAT);
        assert_int_equal(model_weight(&m.model, "encoder.depth_head.norm", &w), ERR_FORMAT);
        modelfile_close(&m);
    }
}

/* A file without the branch is as it was before there was one. */
static void a_completion_branch_is_kept(void **state)
{
    const char *path = tmpdir_path("model.hdrig");
    (void)state;
    for (int k = 0; k < 2; k++) {
        struct modelfile m;
        struct weight w;
        completes = k == 1;
        assert_int_equal(write_model(path, PRECISION_S8, 2), OK);
        assert_int_equal(modelfile_open(path, &m), OK);
        assert_true(m.model.dims.complete == completes);
        assert_true(!memmem(m.model.map, m.head.data, "complete", 8) == !completes);
        assert_int_equal(model_weight(&m.model, "encoder.complete.up.2", &w),
                         completes ? OK : ERR_FORMAT);
        assert_true(!completes || (w.n == 64 && w.segs == 1 && w.seg == 96));
        modelfile_close(&m);
    }
    completes = false;
}

static void threads_do_not_change_a_byte(void **state)
{
    (void)state;
    for (int p = PRECISION_F32; p <= PRECISION_S8; p++) {
        struct file_map a, b;
        assert_int_equal(write_model(tmpdir_path("a"), (enum precision)p, 1), OK);
        assert_int_equal(write_model(tmpdir_path("b"), (enum precision)p, 5), OK);
        assert_int_equal(file_map(tmpdir_path("a"), 1 << 24, &a), OK);
        assert_int_equal(file_map(tmpdir_path("b"), 1 << 24, &b), OK);
        assert_int_equal(a.n, b.n);
        assert_memory_equal(a.p, b.p, a.n);
        file_unmap(&a);
        file_unmap(&b);
    }
}

/* ---- writing that fails ---- */

/* What is in the folder under a name that is not the user's. */
static int leftovers(void)
{
    DIR *d = opendir(tmpdir_root);
    int n = 0;
    for (struct dirent *entry; d && (entry = readdir(d));)
        n += strncmp(entry->d_name, ".tmp-", 5) == 0;
    if (d)
        closedir(d);
    return n;
}

static void failed(const char *path, err_t code, const char *sentence)
{
    assert_int_equal(write_model(path, PRECISION_S8, 2), code);
    if (sentence)
        assert_non_null(strstr(err_text(), sentence));
    assert_int_equal(leftovers(), 0);
    spoil.name = NULL;
    spoil.fail = OK;
}

static void failed_writing_leaves_what_was_there(void **state)
{
    (void)state;
    static const char former[] = "{\"generator\": \"hdrig\"}";
    const char *path = tmpdir_text("kept", former),
               *qkv = "encoder.aggregator.frame_blocks.2.attn.qkv.weight";
    struct file_map m;
    spoil.name = qkv;
    spoil.at = 1234;
    spoil.value = NAN;
    failed(path, ERR_FORMAT, "frame_blocks.2.attn.qkv.weight: element 1234 is not finite");
    spoil.name = "encoder.hdr_conv.2.bias";
    spoil.at = 83;
    spoil.value = -INFINITY;
    failed(path, ERR_FORMAT, "encoder.hdr_conv.2.bias: element 83 is not finite");
    spoil.name = qkv;
    spoil.fail = ERR_IO;
    failed(path, ERR_IO, "kept: no such value");
    atomic_store(&cancel, true);
    failed(path, ERR_CANCELLED, NULL);
    atomic_store(&cancel, false);
    failed("/dev/full", ERR_LIMIT, "No space left");
    failed(tmpdir_path("no/folder"), ERR_IO, "no/folder");
    assert_int_equal(file_map(path, 100, &m), OK);
    assert_memory_equal(m.p, former, m.n);
    file_unmap(&m);
    assert_int_equal(write_model(path, PRECISION_S8, 2), OK);
}

/* ---- hostile files ---- */

static uint8_t *copy; // on a border of 64 bytes
static size_t n_copy;

/* A file of this precision in memory. */
static void load(enum precision p)
{
    struct file_map m;
    const char *path = tmpdir_path("load");
    assert_int_equal(write_model(path, p, 1), OK);
    assert_int_equal(file_map(path, 1 << 24, &m), OK);
    free(copy);
    copy = aligned_alloc(64, (m.n + 4096) / 64 * 64);
    memcpy(copy, m.p, m.n);
    n_copy = m.n;
    file_unmap(&m);
}

static err_t parse(const void *p, size_t n)
{
    struct modelfile m;
    err_t e = modelfile_open_bytes("f", p, n, &m);
    if (e)
        assert_true(m.tensors == NULL && m.head.doc == NULL);
    modelfile_close(&m);
    return e;
}

/* The file with `from` in its header replaced by `to`. */
static err_t parse_changed(const char *from, const char *to)
{
    struct bytes b = bytes_of(copy, n_copy);
    size_t n = (size_t)bytes_u64(&b), a = strlen(from), c = strlen(to);
    const uint8_t *at = memmem(copy + 8, n, from, a);
    assert_non_null(at);
    size_t before = (size_t)(at - copy), header = (8 + n - a + c + 63) / 64 * 64,
           data = n_copy - 8 - n, size = header + data;
    uint8_t *out = aligned_alloc(64, (size + 63) / 64 * 64);
    memset(out, ' ', header);
    bytes_put_u64(out, header - 8);
    memcpy(out + 8, copy + 8, before - 8);
    memcpy(out + before, to, c);
    memcpy(out + before + c, at + a, 8 + n - before - a);
    memcpy(out + header, copy + 8 + n, data);
    err_t e = parse(out, size);
    free(out);
    return e;
}

static void refused(const char *from, const char *to, const char *sentence)
{
    assert_true(parse_changed(from, to) != OK);
    if (!strstr(err_text(), sentence))
        fail_msg("%s -> %s: %s", from, to, err_text());
}

static void hostile_headers_are_refused(void **state)
{
    (void)state;
    load(PRECISION_S8);
    assert_int_equal(parse(copy, n_copy), OK);
    refused("hdrig-model", "hdrig-scene", "format is \"hdrig-scene\"");
    refused("\"format\"", "\"farmat\"", "format is \"\"; see hdrig convert");
    refused("\"version\":\"1\"", "\"version\":\"9\"", "version \"9\"");
    assert_int_equal(parse_changed("\"version\":\"1\"", "\"version\":\"9\""), ERR_UNSUPPORTED);
    refused("\"int8\"", "\"int4\"", "precision \"int4\"");
    refused("\"int8\"", "\"bf16\"", "is I8, it must be BF16");
    refused("\\\"embed\\\":32", "\\\"embed\\\":48", "it must be");
    refused("\\\"embed\\\":32", "\\\"embed\\\":33", "embed is 33");
    refused("\\\"embed\\\":32", "\\\"enbed\\\":32", "dimension embed is missing");
    refused("\\\"embed\\\":32", "\\\"embed\\\":[]", "embed is not a whole number");
    refused("\\\"keep\\\":[0,1", "\\\"keep\\\":[1,1", "entry 1 is 1");
    refused("\\\"keep\\\":[0,1,2,3]", "\\\"keep\\\":[0,1,3]  ", "list of 4");
    refused("\\\"gauss\\\":true", "\\\"gauss\\\":1   ", "neither true nor false");
    refused("\\\"depth\\\":4", "\\\"depth\\\":9", "depth - 1 = 8");
    refused("\"config\":\"{", "\"config\":\"[", "config is not JSON");
    refused("encoder.hdr_conv.2.bias", "encoder.hdr_conv.3.bias", "hdr_conv.2.bias is missing");
    refused("conv.0.weight_scale", "conv.0.weight_scalf", "conv.0.weight_scale is missing");
    refused("\"I8\"", "\"U8\"", "is U8, it must be I8");
    refused("\"encoder.hdr_conv.2.bias\":{\"dtype\":\"F32\"",
            "\"encoder.hdr_conv.2.bias\":{\"dtype\":\"I32\"", "is I32, it must be F32");
}

static void shapes_and_places_are_checked(void **state)
{
    (void)state;
    const char *token = "camera_token\":{\"dtype\":\"F32\",\"shape\":[1,2,1,32]";
    load(PRECISION_F32);
    refused(token, "camera_token\":{\"dtype\":\"F32\",\"shape\":[1,1,2,32]",
            "camera_token: extent 1 is 1, it must be 2");
    refused(token, "camera_token\":{\"dtype\":\"F32\",\"shape\":[1,2,32]",
            "camera_token has 3 extents, it must have 4");
    refused("\"shape\":[1,2,1,32]", "\"shape\":[1,2,1,33]", "its shape needs 264");
    assert_int_equal(parse(copy, n_copy - 1), ERR_FORMAT);
    assert_int_equal(parse(copy, 1000), ERR_FORMAT);
    assert_int_equal(parse(copy, 7), ERR_FORMAT);
    /* An empty tensor fits in anywhere but is none of the network's. */
    refused("\"encoder.hdr_conv.2.bias\"",
            "\"extra\":{\"dtype\":\"F32\",\"shape\":[0],\"data_offsets\":[0,0]},"
            "\"encoder.hdr_conv.2.bias\"",
            "unknown tensor extra");
    /* More blanks: all data lie behind their border. */
    for (size_t more = 1; more <= 32; more *= 2) {
        struct bytes b = bytes_of(copy, n_copy);
        size_t n = 8 + (size_t)bytes_u64(&b);
        uint8_t *moved = aligned_alloc(64, (n_copy + more + 63) / 64 * 64);
        memcpy(moved, copy, n);
        memset(moved + n, ' ', more);
        memcpy(moved + n + more, copy + n, n_copy - n);
        bytes_put_u64(moved, n - 8 + more);
        assert_int_equal(parse(moved, n_copy + more), ERR_FORMAT);
        assert_non_null(strstr(err_text(), more < 4 ? "no multiple of 4" : "no multiple of 64"));
        free(moved);
    }
}

/* Parse with element `at` of tensor `name` replaced by `v`, then put it back. */
static err_t parse_value(const char *name, size_t at, float v)
{
    struct safetensors head;
    assert_int_equal(safetensors_open("f", copy, n_copy, n_copy, &head), OK);
    const struct safetensors_tensor *t = safetensors_find(&head, name);
    assert_non_null(t);
    float *p = (float *)(copy + head.data + t->begin) + at, old = *p;
    safetensors_close(&head);
    *p = v;
    err_t e = parse(copy, n_copy);
    *p = old;
    return e;
}

static void numbers_are_checked(void **state)
{
    (void)state;
    load(PRECISION_S8);
    assert_int_equal(parse_value("encoder.hdr_conv.2.bias", 83, NAN), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "encoder.hdr_conv.2.bias: element 83 is not finite"));
    assert_int_equal(parse_value("encoder.hdr_conv.2.weight", 3, INFINITY), ERR_FORMAT);
    assert_int_equal(parse_value("encoder.generate_tonemapper.enc.0.weight_scale", 1, NAN),
                     ERR_FORMAT);
    assert_int_equal(parse_value("encoder.generate_tonemapper.enc.0.weight_scale", 1, -1),
                     ERR_FORMAT);
    assert_non_null(strstr(err_text(), "weight_scale: element 1 is -1, must be >= 0"));
    assert_int_equal(parse_value("encoder.generate_tonemapper.enc.0.weight_scale", 1, 0), OK);
}

static void damage_is_found_anywhere(void **state)
{
    (void)state;
    struct modelfile m;
    load(PRECISION_BF16);
    struct bytes b = bytes_of(copy, n_copy);
    size_t data = 8 + (size_t)bytes_u64(&b);
    assert_int_equal(modelfile_open_bytes("f", copy, n_copy, &m), OK);
    assert_int_equal(modelfile_verify(&m), OK);
    for (size_t at = data; at < n_copy; at += (at - data) % 9973 + 1) {
        copy[at] ^= 0x10;
        assert_int_equal(modelfile_verify(&m), ERR_FORMAT);
        assert_non_null(strstr(err_text(), "damaged"));
        copy[at] ^= 0x10;
        uint8_t *word = copy + data + (at - data) / 8 * 8, first[8];
        if (word + 16 <= copy + n_copy && memcmp(word, word + 8, 8) != 0) { // exchanged
            memcpy(first, word, 8);
            memmove(word, word + 8, 8);
            memcpy(word + 8, first, 8);
            assert_int_equal(modelfile_verify(&m), ERR_FORMAT);
            memmove(word + 8, word, 8);
            memcpy(word, first, 8);
        }
    }
    assert_int_equal(modelfile_verify(&m), OK);
    modelfile_close(&m);
}

/* Pieces of any length make the same sum. */
static void the_checksum_does_not_see_cuts(void **state)
{
    (void)state;
    uint8_t text[61];
    for (size_t i = 0; i < sizeof text; i++)
        text[i] = (uint8_t)(i * 11 + 3);
    struct modelfile_sum whole = {0};
    modelfile_add(&whole, text, sizeof text);
    for (size_t step = 1; step < sizeof text; step++) {
        struct modelfile_sum s = {0};
        for (size_t at = 0; at < sizeof text; at += step)
            modelfile_add(&s, text + at, sizeof text - at < step ? sizeof text - at : step);
        assert_true(modelfile_total(&s) == modelfile_total(&whole));
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_written_is_read),
        cmocka_unit_test(a_completion_branch_is_kept),
        cmocka_unit_test(threads_do_not_change_a_byte),
        cmocka_unit_test(failed_writing_leaves_what_was_there),
        cmocka_unit_test(hostile_headers_are_refused),
        cmocka_unit_test(shapes_and_places_are_checked),
        cmocka_unit_test(numbers_are_checked),
        cmocka_unit_test(damage_is_found_anywhere),
        cmocka_unit_test(the_checksum_does_not_see_cuts),
    };
    tmpdir_make();
    int failures = cmocka_run_group_tests(tests, NULL, NULL);
    arena_free(&tmp);
    free(copy);
    tmpdir_remove();
    return failures;
}
