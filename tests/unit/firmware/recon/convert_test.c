/* The same weights from a checkpoint of PyTorch and from .safetensors under all names that the
 * releases use become the same file, and what the network cannot run with is refused by name. */
#include "firmware/recon/convert.h"

#include "drivers/format/checkpoint.h"
#include "drivers/format/modelfile.h"

#include "tests/unit/core/net/tiny_net.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#define TINY "tests/data/ckpt/tiny.ckpt"

/* How a .safetensors file differs from tiny.ckpt. */
static struct {
    const char *strip, *add;                // prefix taken off the names, put before them
    const char *without, *extra, *reshaped; // tensors
    const char *odd;                        // its last value is
    float value;
    const char *type; // this one is of I32
} change;

static float values[400000];

static void put_header(FILE *f, const struct checkpoint *c)
{
    struct safetensors_writer w;
    safetensors_begin(&w);
    for (int i = 0; i < c->n; i++) {
        const struct checkpoint_tensor *t = &c->tensors[i];
        struct safetensors_tensor s = {.name = t->name, .type = "F32", .rank = t->rank};
        memcpy(s.shape, t->shape, sizeof s.shape);
        if (t->type == CHECKPOINT_OTHER || (change.without && strstr(t->name, change.without)))
            continue;
        if (change.strip && strncmp(s.name, change.strip, strlen(change.strip)) == 0)
            s.name += strlen(change.strip);
        char longer[CHECKPOINT_NAME_CAP + 32];
        if (change.add) {
            snprintf(longer, sizeof longer, "%s%s", change.add, s.name);
            s.name = longer;
        }
        if (change.type && strcmp(t->name, change.type) == 0)
            s.type = "I32";
        if (change.reshaped && strcmp(t->name, change.reshaped) == 0) {
            s.shape[0] *= s.shape[1];
            s.shape[1] = 1;
        }
        safetensors_put(&w, &s);
    }
    if (change.extra)
        safetensors_put(&w, &(struct safetensors_tensor){
                                .name = change.extra, .type = "F32", .rank = 1, .shape = {0}});
    assert_int_equal(safetensors_end(&w, f), OK);
}

static const char *write_safetensors(void)
{
    const char *path = tmpdir_path("tiny.safetensors");
    struct checkpoint c;
    FILE *f = fopen(path, "wb");
    assert_int_equal(checkpoint_open(TINY, "encoder.", &c), OK);
    put_header(f, &c);
    for (int i = 0; i < c.n; i++) {
        const struct checkpoint_tensor *t = &c.tensors[i];
        size_t n = checkpoint_count(t);
        if (t->type == CHECKPOINT_OTHER || (change.without && strstr(t->name, change.without)))
            continue;
        assert_true(n <= sizeof values / sizeof values[0]);
        assert_int_equal(checkpoint_read(&c, t, values), OK);
        if (change.odd && strcmp(t->name, change.odd) == 0)
            values[n - 1] = change.value;
        fwrite(values, sizeof *values, n, f);
    }
    checkpoint_close(&c);
    assert_int_equal(fclose(f), 0);
    memset(&change, 0, sizeof change);
    return path;
}

static err_t convert(const char *in, const char *out, enum precision p, const char *config)
{
    static struct engine en;
    const struct convert_request q = {out, config, p, 1000};
    assert_int_equal(engine_open(&en, 2), OK);
    err_t e = convert_file(&en, &q, in);
    engine_close(&en);
    return e;
}

static const char *const config = "tests/data/ckpt/tiny.json";

static void all_sources_give_the_same_data(void **state)
{
    (void)state;
    static const char *const strips[] = {NULL, "encoder.", NULL, NULL},
                             *adds[] = {NULL, NULL, "module._orig_mod.", "_orig_mod.module.model."};
    for (int p = PRECISION_F32; p <= PRECISION_S8; p++)
        for (int k = 0; k < 4; k++) {
            struct modelfile a, b;
            change.strip = strips[k];
            change.add = adds[k];
            const char *path = write_safetensors();
            assert_int_equal(convert(TINY, tmpdir_path("a"), (enum precision)p, config), OK);
            assert_int_equal(convert(path, tmpdir_path("b"), (enum precision)p, config), OK);
            assert_int_equal(modelfile_open(tmpdir_path("a"), &a), OK);
            assert_int_equal(modelfile_open(tmpdir_path("b"), &b), OK);
            assert_int_equal(a.head.size, b.head.size);
            assert_memory_equal((const char *)a.model.map + a.head.data,
                                (const char *)b.model.map + b.head.data, a.head.size);
            assert_string_equal(a.checksum, b.checksum);
            assert_memory_equal(&a.model.dims, &tiny_net, sizeof tiny_net);
            assert_int_equal(modelfile_verify(&a), OK);
            assert_non_null(strstr(a.model.source, "tiny.ckpt sha256:"));
            assert_non_null(strstr(b.model.source, "tiny.safetensors sha256:"));
            modelfile_close(&a);
            modelfile_close(&b);
        }
}

/* A checkpoint does not tell whether its angles were rounded: the dimensions do, else they were. */
static void rounded_angles_are_as_the_dimensions_say(void **state)
{
    static const char *const says[] = {"", "\"rope_bf16\": true,", "\"rope_bf16\": false,"};
    static char text[4096];
    (void)state;
    FILE *f = fopen(config, "r");
    assert_non_null(f);
    size_t n = fread(text, 1, sizeof text - 1, f);
    fclose(f);
    text[n] = 0;
    char *rest = strstr(text, "\"embed\"");
    assert_non_null(rest);
    assert_null(strstr(text, "rope_bf16"));
    for (int k = 0; k < 3; k++) {
        struct modelfile m;
        assert_non_null(f = fopen(tmpdir_path("dims.json"), "w"));
        fprintf(f, "%.*s%s%s", (int)(rest - text), text, says[k], rest);
        assert_int_equal(fclose(f), 0);
        assert_int_equal(convert(TINY, tmpdir_path("a"), PRECISION_F32, tmpdir_path("dims.json")),
                         OK);
        assert_int_equal(modelfile_open(tmpdir_path("a"), &m), OK);
        assert_int_equal(m.model.dims.rope_bf16, k < 2);
        modelfile_close(&m);
    }
}

static void refused(err_t code, const char *sentence)
{
    const char *out = tmpdir_path("refused");
    err_t e = convert(write_safetensors(), out, PRECISION_S8, config);
    if (e != code || !strstr(err_text(), sentence))
        fail_msg("%d, not %d (%s): %s", e, code, sentence, err_text());
    assert_false(file_exists(out));
}

static void what_does_not_fit_is_named(void **state)
{
    (void)state;
    change.without = "encoder.hdr_conv.0.bias";
    refused(ERR_FORMAT, "tensors are missing (1): encoder.hdr_conv.0.bias");
    change.without = "encoder.hdr_head.";
    refused(ERR_FORMAT, ": encoder.hdr_head.patch_embed.weight, ");
    assert_non_null(strstr(err_text(), ", ..."));
    change.reshaped = "encoder.hdr_conv.0.weight";
    refused(ERR_FORMAT, "tensors have another shape (1): encoder.hdr_conv.0.weight [16,1,3,3], not "
                        "[4,4,3,3]");
    change.type = "encoder.camera_head.token_norm.weight";
    refused(ERR_FORMAT, "tensors are not float32, bfloat16 or float16 (1): "
                        "encoder.camera_head.token_norm.weight is I32; save them so");
    change.extra = "encoder.camera_head.token_norm.bias";
    refused(ERR_FORMAT, "token_norm.bias is there twice");
}

/* Products, exact ones and plain tensors, in every precision, also those that int8 smooths. */
static void weights_out_of_range_are_named(void **state)
{
    static const char *const names[] = {
        "encoder.aggregator.frame_blocks.1.mlp.fc2.weight",
        "encoder.aggregator.global_blocks.3.norm1.weight", "encoder.hdr_conv.2.weight",
        "encoder.aggregator.camera_token", "encoder.depth_head.resize_layers.0.bias"};
    static const float odd[] = {NAN, -INFINITY, 3e38f, -1048577};
    (void)state;
    for (int i = 0; i < 20; i++) {
        char text[160];
        for (int p = PRECISION_F32; p <= PRECISION_S8; p++) {
            change.odd = names[i % 5];
            change.value = odd[i / 5];
            const char *path = write_safetensors(), *out = tmpdir_path("refused");
            snprintf(text, sizeof text, "tensor %s: element ", names[i % 5]);
            assert_int_equal(convert(path, out, (enum precision)p, config), ERR_FORMAT);
            if (!strstr(err_text(), text))
                fail_msg("%s: %s", text, err_text());
            snprintf(text, sizeof text, " is %g, weights are within -1.04858e+06 and 1.04858e+06",
                     (double)odd[i / 5]);
            if (!strstr(err_text(), text))
                fail_msg("%s: %s", text, err_text());
            assert_false(file_exists(out));
        }
    }
    change.odd = names[0];
    change.value = 1048576;
    assert_int_equal(convert(write_safetensors(), tmpdir_path("fine"), PRECISION_S8, config), OK);
}

/* Unused ones may be missing or be anything, and strangers are left out. */
static void what_is_not_read_does_not_matter(void **state)
{
    (void)state;
    const char *out = tmpdir_path("fine");
    static const char *const unused[] = {"mask_token", "div_term", "input_merger",
                                         "gaussian_param_head.scratch.output_conv2"};
    for (int k = 0; k < 4; k++) {
        change.without = unused[k];
        change.extra = k == 0 ? "point_head.norm.weight" : NULL;
        assert_int_equal(convert(write_safetensors(), out, PRECISION_S8, config), OK);
    }
    change.odd = "encoder.gaussian_param_head.input_merger.0.weight";
    change.value = NAN;
    assert_int_equal(convert(write_safetensors(), out, PRECISION_S8, config), OK);
}

static void requests_are_checked(void **state)
{
    (void)state;
    const char *out = tmpdir_path("none");
    assert_int_equal(convert(TINY, out, PRECISION_S8, NULL), ERR_UNSUPPORTED);
    assert_non_null(strstr(err_text(), "4 frame blocks: which layers to keep"));
    assert_int_equal(convert(TINY, out, PRECISION_S8, "full"), ERR_FORMAT);
    assert_int_equal(convert(TINY, out, PRECISION_S8, "none.json"), ERR_IO);
    assert_int_equal(convert(TINY, out, PRECISION_S8, tmpdir_text("a.json", "{}")), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "has no object \"model\""));
    assert_int_equal(
        convert(TINY, out, PRECISION_S8, tmpdir_text("a.json", "{\"model\": {\"embed\": 31}}")),
        ERR_FORMAT);
    assert_non_null(strstr(err_text(), "embed is 31"));
    atomic_store(&engine_cancel, true);
    assert_int_equal(convert(TINY, out, PRECISION_S8, config), ERR_CANCELLED);
    atomic_store(&engine_cancel, false);
    assert_false(file_exists(out));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(all_sources_give_the_same_data),
        cmocka_unit_test(rounded_angles_are_as_the_dimensions_say),
        cmocka_unit_test(what_does_not_fit_is_named),
        cmocka_unit_test(weights_out_of_range_are_named),
        cmocka_unit_test(what_is_not_read_does_not_matter),
        cmocka_unit_test(requests_are_checked),
    };
    tmpdir_make();
    int failures = cmocka_run_group_tests(tests, NULL, NULL);
    tmpdir_remove();
    return failures;
}
