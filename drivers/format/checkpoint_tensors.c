#include "drivers/format/checkpoint_tensors.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Parts of names from data parallelism, torch.compile, activation checkpoints and sharding. */
static const char *const wrappers[] = {"module.", "_orig_mod.", "_checkpoint_wrapped_module.",
                                       "_fsdp_wrapped_module."};

enum {
    N_WRAPPERS = sizeof wrappers / sizeof *wrappers,
    OWN_MAX = CHECKPOINT_NAME_CAP - 1 - CHECKPOINT_OWNER_MAX // of a name in the file
};

static size_t prefix_bytes(const char *s, size_t n, const char *with)
{
    size_t m = strlen(with);
    return n >= m && memcmp(s, with, m) == 0 ? m : 0;
}

/* Bytes of a wrapper at the start of a part of a name, or of "model." at that of the name. */
static size_t wrapper_at(const char *text, size_t n, bool first)
{
    size_t found = first ? prefix_bytes(text, n, "model.") : 0;
    for (int i = 0; i < N_WRAPPERS && !found; i++)
        found = prefix_bytes(text, n, wrappers[i]);
    return found;
}

err_t checkpoint_tensors_name(const struct checkpoint *c, const char *what, struct bytes text,
                              char out[CHECKPOINT_NAME_CAP])
{
    const char *p = (const char *)text.p;
    const size_t n = text.left, owner = strlen(c->owner);
    size_t to = 0;
    if (n > OWN_MAX)
        return err_fail(ERR_FORMAT, "%s: tensor %.*s...: name of %zu bytes, at most %d are read",
                        what, 64, p, n, OWN_MAX);
    for (size_t i = 0; i < n; i++)
        if (text.p[i] < 0x20)
            return err_fail(ERR_FORMAT, "%s: a tensor name holds the character 0x%02x", what,
                            (unsigned)text.p[i]);
    for (size_t i = 0, part; i < n; i += part) {
        part = wrapper_at(p + i, n - i, to == 0 && owner > 0);
        if (part)
            continue;
        if (to == 0 && !prefix_bytes(p + i, n - i, c->owner))
            to = (size_t)snprintf(out, CHECKPOINT_NAME_CAP, "%s", c->owner);
        const char *dot = memchr(p + i, '.', n - i);
        part = dot ? (size_t)(dot - p) + 1 - i : n - i;
        memcpy(out + to, p + i, part);
        to += part;
    }
    out[to] = 0;
    return OK;
}

err_t checkpoint_tensors_room(struct checkpoint *c, int n)
{
    const size_t all = (size_t)c->n + (size_t)n;
    void *p = realloc(c->tensors, (all + 1) * sizeof *c->tensors);
    if (!p)
        return err_fail(ERR_NOMEM, "%s: no memory for %zu tensors", c->parts[c->n_parts - 1].path,
                        all);
    c->tensors = p;
    return OK;
}

struct checkpoint_tensor *checkpoint_tensors_next(struct checkpoint *c)
{
    c->tensors[c->n] = (struct checkpoint_tensor){.part = c->n_parts - 1};
    return &c->tensors[c->n];
}

bool checkpoint_tensors_spread(const struct checkpoint_tensor *t, size_t *out)
{
    size_t count = 1, step;
    bool good = true;
    *out = 1;
    for (int k = 0; k < t->rank; k++) {
        good &= bytes_mul(count, t->shape[k], &count);
        if (t->shape[k] == 0) {
            *out = 0;
            return true;
        }
        good &= bytes_mul(t->shape[k] - 1, t->stride[k], &step) && bytes_add(*out, step, out);
    }
    return good && count <= SIZE_MAX / sizeof(float);
}

size_t checkpoint_tensors_bytes(enum checkpoint_type type)
{
    return type == CHECKPOINT_F32 ? 4 : 2;
}
