/* make_tensors CHECKPOINT FILE - the tensors of a checkpoint as a .safetensors file, all F32. The
 * last one, in the order of names, belongs to the network. */
#include "drivers/format/checkpoint.h"
#include "drivers/format/file.h"
#include "drivers/format/safetensors.h"

#include <stdlib.h>
#include <string.h>

static bool is_wanted(const struct checkpoint_tensor *t)
{
    return t->type != CHECKPOINT_OTHER && strncmp(t->name, "encoder.other", 13) != 0;
}

static err_t put_data(const struct checkpoint *c, const struct checkpoint_tensor *t, FILE *f)
{
    size_t n = checkpoint_count(t);
    float *v = malloc((n + 1) * sizeof *v);
    err_t e = v ? checkpoint_read(c, t, v) : err_fail(ERR_NOMEM, "no memory");
    if (!e)
        fwrite(v, sizeof *v, n, f);
    free(v);
    return e;
}

static err_t put_all(const struct checkpoint *c, FILE *f)
{
    struct safetensors_writer w;
    safetensors_begin(&w);
    for (int i = 0; i < c->n; i++) {
        struct safetensors_tensor t = {.name = c->tensors[i].name, .type = "F32"};
        t.rank = c->tensors[i].rank;
        memcpy(t.shape, c->tensors[i].shape, sizeof t.shape);
        if (is_wanted(&c->tensors[i]))
            safetensors_put(&w, &t);
    }
    err_t e = safetensors_end(&w, f);
    for (int i = 0; i < c->n && !e; i++)
        if (is_wanted(&c->tensors[i]))
            e = put_data(c, &c->tensors[i], f);
    return e;
}

int main(int argc, char **argv)
{
    struct checkpoint c;
    FILE *f = NULL;
    if (argc != 3) {
        fputs("usage: make_tensors CHECKPOINT FILE\n", stderr);
        return 2;
    }
    err_t e = checkpoint_open(argv[1], "encoder.", &c);
    if (!e)
        e = file_create(argv[2], &f);
    if (!e)
        e = put_all(&c, f);
    checkpoint_close(&c);
    if (!e)
        e = file_finish(f, argv[2]);
    if (e)
        fprintf(stderr, "make_tensors: %s\n", err_text());
    return e ? 1 : 0;
}
