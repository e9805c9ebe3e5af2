/* torchvision's AlexNet and the linear layers of LPIPS, both of hashed weights, become the weights
 * file that --hashed makes; what does not fit is refused by name. */
#include "firmware/recon/convert.h"

#include "core/net/hashed.h"
#include "drivers/format/modelfile.h"
#include "firmware/recon/network.h"

#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

/* How the files differ from what is right. */
static struct {
    const char *without, *odd; // tensors
    float value;               // of the last element of odd
    enum lpips_net linear;     // linear layers of this network
} change;

struct part {
    const char *prefix;
    struct safetensors_writer w;
    FILE *f;
};

static bool is_written(const struct part *p, const struct tensor_spec *t)
{
    return strncmp(t->name, p->prefix, strlen(p->prefix)) == 0 &&
           !(change.without && strcmp(t->name, change.without) == 0);
}

static err_t put_header(void *ctx, const struct tensor_spec *t)
{
    struct part *p = ctx;
    struct safetensors_tensor s = {.name = t->name, .type = "F32", .rank = t->rank};
    for (int k = 0; k < t->rank; k++)
        s.shape[k] = (size_t)t->shape[k];
    if (is_written(p, t))
        safetensors_put(&p->w, &s);
    return OK;
}

static err_t put_values(void *ctx, const struct tensor_spec *t)
{
    static float values[1 << 20];
    const struct part *p = ctx;
    const size_t n = table_count(t);
    if (!is_written(p, t))
        return OK;
    assert_true(n <= sizeof values / sizeof values[0]);
    hashed_fill(t, 1, 0, n, values);
    if (change.odd && strcmp(t->name, change.odd) == 0)
        values[n - 1] = change.value;
    fwrite(values, sizeof *values, n, p->f);
    return OK;
}

/* The tensors whose names begin with the prefix, and one that does not matter. */
static const char *write_part(enum lpips_net net, const char *prefix, const char *name)
{
    static const float zeros[4];
    const struct net_dims d = {.lpips = net};
    const char *path = tmpdir_path(name);
    struct part p = {.prefix = prefix, .f = fopen(path, "wb")};
    safetensors_begin(&p.w);
    assert_int_equal(table_walk(&d, put_header, &p), OK);
    safetensors_put(&p.w, &(struct safetensors_tensor){
                              .name = "classifier.6.bias", .type = "F32", .rank = 1, .shape = {4}});
    assert_int_equal(safetensors_end(&p.w, p.f), OK);
    assert_int_equal(table_walk(&d, put_values, &p), OK);
    fwrite(zeros, sizeof *zeros, 4, p.f);
    assert_int_equal(fclose(p.f), 0);
    return path;
}

static err_t convert(const char *out)
{
    static struct engine en;
    const struct convert_request q = {out, NULL, PRECISION_F32, 1000};
    const enum lpips_net linear = change.linear ? change.linear : LPIPS_ALEXNET;
    const char *backbone = write_part(LPIPS_ALEXNET, "features.", "alexnet.safetensors"),
               *lin = write_part(linear, "lin", "alex.safetensors");
    memset(&change, 0, sizeof change);
    assert_int_equal(engine_open(&en, 2), OK);
    err_t e = convert_lpips(&en, &q, backbone, lin);
    engine_close(&en);
    return e;
}

static err_t convert_numbers(const char *out, enum precision precision)
{
    static struct engine en;
    const char *config = tmpdir_text("alexnet.json", "{\"model\": {\"lpips\": \"alexnet\"}}");
    const struct convert_request q = {out, config, precision, 1000};
    assert_int_equal(engine_open(&en, 2), OK);
    err_t e = convert_hashed(&en, &q, 1);
    engine_close(&en);
    return e;
}

static void both_files_become_one(void **state)
{
    struct modelfile a, b;
    struct network n;
    (void)state;
    assert_int_equal(convert(tmpdir_path("a")), OK);
    assert_int_equal(convert_numbers(tmpdir_path("b"), PRECISION_F32), OK);
    assert_int_equal(modelfile_open(tmpdir_path("a"), &a), OK);
    assert_int_equal(modelfile_open(tmpdir_path("b"), &b), OK);
    assert_int_equal(a.model.dims.lpips, LPIPS_ALEXNET);
    assert_int_equal(a.head.size, b.head.size);
    assert_memory_equal((const char *)a.model.map + a.head.data,
                        (const char *)b.model.map + b.head.data, a.head.size);
    assert_int_equal(modelfile_verify(&a), OK);
    assert_non_null(strstr(a.model.source, "alexnet.safetensors sha256:"));
    assert_non_null(strstr(a.model.source, ", alex.safetensors sha256:"));
    modelfile_close(&a);
    modelfile_close(&b);
    assert_int_equal(network_open(tmpdir_path("a"), NULL, 0, &n), ERR_ARG);
    assert_non_null(strstr(err_text(), "holds weights of LPIPS, for hdrig eval --lpips"));
    assert_int_equal(convert_numbers(tmpdir_path("b"), PRECISION_S8), ERR_ARG);
    assert_non_null(strstr(err_text(), "fp32 only"));
}

static void refused(const char *sentence)
{
    const char *out = tmpdir_path("refused");
    err_t e = convert(out);
    if (e != ERR_FORMAT || !strstr(err_text(), sentence))
        fail_msg("%d (%s): %s", e, sentence, err_text());
    assert_false(file_exists(out));
}

static void what_does_not_fit_is_named(void **state)
{
    static const float odd[] = {NAN, INFINITY, -1048577};
    struct convert_request q = {tmpdir_path("alexnet.safetensors"), NULL, PRECISION_F32, 1000};
    (void)state;
    change.without = "features.6.bias";
    refused("alexnet.safetensors: tensors are missing (1): features.6.bias (for LPIPS of alexnet)");
    change.without = "lin3.model.1.weight";
    refused("alex.safetensors: tensors are missing (1): lin3.model.1.weight");
    change.without = "features.0.weight";
    refused("alexnet.safetensors: has no tensor features.0.weight of kernels of 3 or 11 px");
    change.linear = LPIPS_VGG16;
    refused("another shape (4): lin1.model.1.weight [1,128,1,1], not [1,192,1,1], ");
    for (int i = 0; i < 3; i++) {
        change.odd = i == 1 ? "lin4.model.1.weight" : "features.10.weight";
        change.value = odd[i];
        refused("weights are within");
    }
    change.odd = "lin4.model.1.weight";
    change.value = -1e-6f;
    refused("tensor lin4.model.1.weight: element 255 is -1e-06, linear weights of LPIPS are >= 0");
    assert_int_equal(convert_lpips(NULL, &q, q.out, "none"), ERR_ARG);
    assert_int_equal(convert_lpips(NULL, &q, "none", q.out), ERR_ARG);
    assert_non_null(strstr(err_text(), "would be replaced by what is made of it"));
    assert_int_equal(convert_lpips(NULL, &q, "none", "none"), ERR_IO);
}

static void configurations(void **state)
{
    static struct engine en;
    const struct convert_request q = {
        tmpdir_path("none"), tmpdir_text("odd.json", "{\"model\": {\"lpips\": \"resnet\"}}"),
        PRECISION_F32, 1000};
    (void)state;
    assert_int_equal(convert_hashed(&en, &q, 1), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "odd.json: lpips is not the name of a network"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(both_files_become_one),
        cmocka_unit_test(what_does_not_fit_is_named),
        cmocka_unit_test(configurations),
    };
    return cmocka_run_group_tests(tests, tmpdir_setup, tmpdir_teardown);
}
