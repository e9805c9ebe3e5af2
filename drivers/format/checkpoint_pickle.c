#include "drivers/format/checkpoint_pickle.h"

#include <stdio.h>
#include <string.h>

enum { STATE_DEPTH = 4 };

struct adding {
    const struct checkpoint_pickle *job;
    const char *path;
    const struct pickle *p;
};

static err_t bad_tensor(const struct adding *a, const struct checkpoint_tensor *t, const char *why)
{
    return err_fail(ERR_FORMAT, "%s: tensor %s: %s", a->path, t->name, why);
}

static bool get_count(const struct pickle_value *v, uint64_t *out)
{
    if (!v || v->kind != PICKLE_INT || v->number < 0)
        return false;
    *out = (uint64_t)v->number;
    return true;
}

/* A tuple of at most CHECKPOINT_RANK_MAX counts. */
static bool get_counts(const struct pickle *p, const struct pickle_value *v, size_t *out, int *n)
{
    if (!v || v->kind != PICKLE_TUPLE || v->count > CHECKPOINT_RANK_MAX)
        return false;
    *n = v->count;
    for (int k = 0; k < v->count; k++) {
        uint64_t number;
        if (!get_count(pickle_item(p, v, k), &number))
            return false;
        out[k] = (size_t)number;
    }
    return true;
}

bool checkpoint_pickle_storage(const struct pickle *p, const struct pickle_value *v,
                               struct checkpoint_pickle_storage *out)
{
    const struct pickle_value *key = v && v->kind == PICKLE_STORAGE ? pickle_item(p, v, 2) : NULL,
                              *view = key ? pickle_item(p, v, 5) : NULL;
    if (!key || (view && view->kind != PICKLE_OPAQUE) || key->kind != PICKLE_TEXT ||
        key->n_text > CHECKPOINT_PICKLE_KEY_MAX)
        return false;
    out->kind = pickle_item(p, v, 1);
    out->key = key->text;
    out->n_key = key->n_text;
    return out->kind->kind == PICKLE_GLOBAL && get_count(pickle_item(p, v, 4), &out->count);
}

static void set_other(struct checkpoint_tensor *t, const struct pickle_value *kind)
{
    t->type = CHECKPOINT_OTHER;
    snprintf(t->kind, sizeof t->kind, "%.*s",
             (int)(kind->n_text < sizeof t->kind ? kind->n_text : sizeof t->kind), kind->text);
}

static void set_type(struct checkpoint_tensor *t, const struct pickle_value *kind)
{
    set_other(t, kind);
    if (kind->global == PICKLE_FLOAT_STORAGE)
        t->type = CHECKPOINT_F32;
    else if (kind->global == PICKLE_BFLOAT16_STORAGE)
        t->type = CHECKPOINT_BF16;
    else if (kind->global == PICKLE_HALF_STORAGE)
        t->type = CHECKPOINT_F16;
}

static err_t get_storage(const struct adding *a, const struct pickle_value *v,
                         struct checkpoint_tensor *t)
{
    struct checkpoint_pickle_storage s;
    uint64_t bytes = 0;
    if (!checkpoint_pickle_storage(a->p, v, &s))
        return bad_tensor(a, t, "has no storage, or one that is part of another");
    t->room = s.count;
    set_type(t, s.kind);
    err_t e = a->job->find(a->job->ctx, &s, t, &bytes);
    if (!e && t->type != CHECKPOINT_OTHER && t->room > bytes / checkpoint_tensors_bytes(t->type))
        e = err_fail(ERR_FORMAT, "%s: tensor %s: storage of %ju elements in %ju bytes", a->path,
                     t->name, (uintmax_t)t->room, (uintmax_t)bytes);
    return e;
}

/* Marks of a tensor: a dictionary, or nothing in older files. An unknown mark that is set makes the
 * tensor one of another kind. */
static void get_marks(const struct pickle *p, const struct pickle_value *dict,
                      struct checkpoint_tensor *t)
{
    if (!dict || dict->kind != PICKLE_DICT)
        return;
    for (int i = dict->first; i >= 0; i = p->items[p->items[i].next].next) {
        const struct pickle_value *k = &p->values[p->items[i].value],
                                  *v = &p->values[p->items[p->items[i].next].value];
        const bool holds = v->kind != PICKLE_INT || v->number != 0;
        if (k->kind != PICKLE_TEXT || !holds)
            continue;
        if (k->n_text == 3 && memcmp(k->text, "neg", 3) == 0)
            t->negative = true;
        else if (t->type != CHECKPOINT_OTHER)
            set_other(t, k);
    }
}

static err_t add_tensor(const struct adding *a, const struct pickle_value *v,
                        struct checkpoint_tensor *t)
{
    int n_strides;
    size_t spread;
    if (v->kind == PICKLE_FOREIGN) {
        set_other(t, v);
        return OK;
    }
    err_t e = get_storage(a, pickle_item(a->p, v, 0), t);
    if (e)
        return e;
    if (!get_count(pickle_item(a->p, v, 1), &t->offset) ||
        !get_counts(a->p, pickle_item(a->p, v, 2), t->shape, &t->rank) ||
        !get_counts(a->p, pickle_item(a->p, v, 3), t->stride, &n_strides) || n_strides != t->rank)
        return bad_tensor(a, t, "has no offset, shape and strides");
    if (!checkpoint_tensors_spread(t, &spread) || t->offset > t->room ||
        spread > t->room - t->offset)
        return bad_tensor(a, t, "reaches beyond its storage");
    get_marks(a->p, pickle_item(a->p, v, 6), t);
    return OK;
}

/* The tensors among the members of a dictionary. */
static err_t add_tensors(const struct adding *a, const struct pickle_value *dict)
{
    const struct pickle *p = a->p;
    struct checkpoint *c = a->job->c;
    err_t e = checkpoint_tensors_room(c, dict->count / 2);
    for (int i = dict->first; i >= 0 && !e; i = p->items[p->items[i].next].next) {
        const struct pickle_value *k = &p->values[p->items[i].value],
                                  *v = &p->values[p->items[p->items[i].next].value];
        if (k->kind != PICKLE_TEXT || (v->kind != PICKLE_TENSOR && v->kind != PICKLE_FOREIGN))
            continue;
        struct checkpoint_tensor *t = checkpoint_tensors_next(c);
        e = checkpoint_tensors_name(c, a->path, bytes_of(k->text, k->n_text), t->name);
        if (!e)
            e = add_tensor(a, v, t);
        c->n++;
    }
    return e;
}

/* The dictionary that counts; *top is the outermost value. */
static err_t find_state(const struct adding *a, const struct pickle_value **top)
{
    static const char *const keys[] = {"state_dict", "model_state_dict", "model", "module"};
    for (int depth = 0; depth < STATE_DEPTH; depth++) {
        const struct pickle_value *inner = NULL;
        const char *key = NULL;
        for (int k = 0; k < 4 && !inner; k++) {
            key = keys[k];
            inner = pickle_get(a->p, *top, key);
            if (inner && inner->kind != PICKLE_DICT && inner->kind != PICKLE_OPAQUE)
                inner = NULL;
        }
        if (!inner)
            break;
        if (inner->kind == PICKLE_OPAQUE)
            return err_fail(
                ERR_FORMAT,
                "%s: \"%s\" holds an object of Python, not a dictionary of tensors; save "
                "its state_dict() instead",
                a->path, key);
        *top = inner;
    }
    if ((*top)->kind == PICKLE_DICT)
        return OK;
    return err_fail(ERR_FORMAT,
                    "%s: holds no dictionary of tensors; save the model's state_dict() instead",
                    a->path);
}

err_t checkpoint_pickle_add(const struct checkpoint_pickle *j, const struct pickle *p)
{
    const struct adding a = {j, j->c->parts[j->c->n_parts - 1].path, p};
    const struct pickle_value *top = &p->values[p->root];
    err_t e = find_state(&a, &top);
    return e ? e : add_tensors(&a, top);
}
