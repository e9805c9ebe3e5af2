/* hdrig convert: weights of a network for this program. */
#include "firmware/base/engine.h"
#include "firmware/cmd/cmd.h"
#include "firmware/recon/convert.h"

#include "drivers/format/modelfile.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

struct options {
    const char *in, *precision, *hashed, *lpips;
    struct convert_request q;
};

static err_t read_seed(const char *text, uint64_t *out)
{
    char *end;
    errno = 0;
    *out = strtoull(text, &end, 10);
    if (errno || end == text || *end || *text == '-')
        return err_fail(ERR_ARG, "--hashed: \"%.32s\" is not a whole number below 2^64", text);
    return OK;
}

static err_t check_options(const struct options *o)
{
    if (!o->q.out || !o->in == !o->hashed)
        return err_fail(ERR_ARG, "--out and either a file or --hashed are needed");
    if (o->hashed && !o->q.config)
        return err_fail(ERR_ARG, "--hashed needs --config");
    if (o->lpips && (o->hashed || o->q.config || o->q.precision != PRECISION_F32))
        return err_fail(ERR_ARG, "--lpips goes with neither --hashed nor --config, and fp32 only");
    return OK;
}

static err_t convert_weights(struct engine *en, const struct options *o, uint64_t seed)
{
    if (o->lpips)
        return convert_lpips(en, &o->q, o->in, o->lpips);
    return o->hashed ? convert_hashed(en, &o->q, seed) : convert_file(en, &o->q, o->in);
}

int cmd_convert_run(int argc, char **argv)
{
    static struct engine engine;
    struct options o = {.precision = "fp32"};
    struct config cfg;
    uint64_t seed = 0;
    int code;
    const struct cmd_option options[] = {
        {"out", "FILE", "weights file to write", NULL, &o.q.out, NULL},
        {"lpips", "FILE", "linear layers of LPIPS, for torchvision's vgg16 or alexnet", NULL,
         &o.lpips, NULL},
        {"precision", "P", "of products: fp32, bf16 or int8; fp32", NULL, &o.precision, NULL},
        {"hashed", "SEED", "make weights of numbers, for tests", NULL, &o.hashed, NULL},
        {"config", "C", "dimensions: full, mini or FILE.json", NULL, &o.q.config, NULL},
        CMD_THREADS,
        CMD_MEMORY,
    };
    const struct cmd_usage usage = {
        .name = "convert",
        .synopsis = "FILE --out FILE ",
        .what =
            "Weights of InstantHDR, AnySplat or VGGT (PyTorch's .ckpt, .pt or .bin, .safetensors,\n"
            "or the .index.json of several such files) become a weights file of this program; "
            "with\n"
            "--lpips, torchvision's vgg16-397923af.pth and the package lpips' "
            "weights/v0.1/vgg.pth, or\n"
            "alexnet and alex.pth, become one for hdrig eval --lpips.",
        .options = options,
        .n_options = sizeof options / sizeof options[0],
    };
    if (argc > 1 && argv[1][0] != '-') { // the file comes before the options
        o.in = *++argv;
        *argv = argv[-1];
        argc--;
    }
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    err_t e =
        modelfile_parse_precision(o.precision, &o.q.precision)
            ? check_options(&o)
            : err_fail(ERR_ARG, "--precision: \"%.32s\" is none of fp32, bf16, int8", o.precision);
    if (!e && o.hashed)
        e = read_seed(o.hashed, &seed);
    if (e)
        return cmd_misuse(&usage, err_text());
    o.q.max_mb = config_memory_mb(&cfg);
    e = engine_open(&engine, cfg.threads);
    if (!e)
        e = convert_weights(&engine, &o, seed);
    engine_close(&engine);
    return cmd_finish(usage.name, e);
}
