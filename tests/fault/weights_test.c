/* Weights when memory runs out anywhere, libraries included. */
#include "core/net/hashed.h"
#include "drivers/format/checkpoint.h"
#include "drivers/format/modelfile.h"
#include "drivers/format/modelwrite.h"
#include "drivers/format/netdims.h"
#include "drivers/format/pickle.h"
#include "tests/fault/alloc_fail.h"
#include "tests/unit/core/net/tiny_net.h"
#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static char config[1024]; // configuration of tiny_net

/* libzip 1.7 loses blocks when zip_open finds no memory, so the other containers and the pickle. */
static err_t checkpoint(void *ctx)
{
    float v[16];
    struct checkpoint c;
    err_t e = checkpoint_open(ctx, "encoder.", &c);
    if (!e)
        e = checkpoint_read(&c, &c.tensors[0], v);
    checkpoint_close(&c);
    return e;
}

static err_t parse_pickle(void *ctx)
{
    const struct file_map *m = ctx;
    struct pickle p;
    err_t e = pickle_parse("lightning", m->p, m->n, &p);
    pickle_free(&p);
    return e;
}

static err_t fetch(void *ctx, const struct run *r, const struct tensor_spec *t, float *out)
{
    (void)ctx, (void)r;
    hashed_fill(t, 1, 0, table_count(t), out);
    return OK;
}

/* To where nothing is kept: what is written is then not read again. */
static err_t write_model(void *ctx)
{
    const struct modelwrite w = {tiny_net, PRECISION_S8, "hashed 1", "none", fetch, NULL};
    struct arena tmp;
    err_t e = arena_init(&tmp, "tmp", modelwrite_need(&w, 1));
    const struct run r = {.tmp = &tmp};
    if (!e)
        e = modelwrite_run(&r, &w, ctx);
    arena_free(&tmp);
    return e;
}

/* A header of the right words without the tensors. */
static err_t read_model(void *ctx)
{
    const struct file_map *m = ctx;
    struct modelfile out;
    err_t e = modelfile_open_bytes("model", m->p, m->n, &out);
    modelfile_close(&out);
    return e == ERR_FORMAT && strstr(err_text(), "is missing") ? OK : e;
}

static void survives(alloc_fail_fn *fn, const void *ctx)
{
    int refused = alloc_fail_sweep(fn, (void *)(uintptr_t)ctx);
    print_message("%d failing allocations refused\n", refused);
    assert_true(refused >= 3);
}

static const char *write_container(const char *name, bool model)
{
    const char *path = tmpdir_path(name);
    struct safetensors_writer w;
    FILE *f;
    safetensors_begin(&w);
    if (model) {
        safetensors_put_word(&w, "format", modelfile_format);
        safetensors_put_word(&w, "version", modelfile_version);
        safetensors_put_word(&w, "precision", "int8");
        safetensors_put_word(&w, "config", config);
    }
    safetensors_put(&w, &(struct safetensors_tensor){
                            .name = "model.x", .type = "F16", .rank = 2, .shape = {2, 3}});
    assert_int_equal(file_create(path, &f), OK);
    assert_int_equal(safetensors_end(&w, f), OK);
    fwrite("0123456789ab", 1, 12, f);
    assert_int_equal(file_finish(f, path), OK);
    return path;
}

static void checkpoints_survive(void **state)
{
    (void)state;
    survives(checkpoint, write_container("a.safetensors", false));
    survives(checkpoint, "tests/data/ckpt/old.pt");
}

static void pickles_survive(void **state)
{
    (void)state;
    struct file_map m;
    assert_int_equal(file_map("tests/fuzz/corpus/pickle/lightning", 1 << 20, &m), OK);
    survives(parse_pickle, &m);
    file_unmap(&m);
}

static void written_models_survive(void **state)
{
    (void)state;
    survives(write_model, "/dev/null");
}

static void read_models_survive(void **state)
{
    (void)state;
    struct file_map m;
    assert_int_equal(file_map(write_container("a.hdrig", true), 1 << 20, &m), OK);
    survives(read_model, &m);
    file_unmap(&m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(checkpoints_survive),
        cmocka_unit_test(pickles_survive),
        cmocka_unit_test(written_models_survive),
        cmocka_unit_test(read_models_survive),
    };
    FILE *f = fmemopen(config, sizeof config, "w");
    if (!f)
        return 1;
    netdims_put(f, &tiny_net);
    fclose(f);
    tmpdir_make();
    int failures = cmocka_run_group_tests(tests, NULL, NULL);
    tmpdir_remove();
    return failures;
}
