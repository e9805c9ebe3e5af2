/* The stack machine of Python's pickle module (Lib/pickletools.py describes each opcode). Values
 * are numbered; the stack, the memo and containers hold these numbers. */
#include "drivers/format/pickle.h"

#include "core/base/bytes.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

enum { MARK = -1, NOTHING = -1, PROTOCOL_MAX = 5 };

struct machine {
    const char *what;
    struct bytes in;
    size_t n; // bytes of the pickle
    struct pickle *out;
    int *stack, *memo;
    int n_stack, stack_cap, n_memo, memo_cap;
    uint8_t op;
    bool done;
};

static err_t refuse_opcode(const struct machine *m, const char *why)
{
    return err_fail(ERR_FORMAT, "%s: %s, opcode 0x%02x near byte %zu of %zu", m->what, why, m->op,
                    m->n - m->in.left, m->n);
}

/* Room for n elements of `size` bytes in *array. */
static err_t grow_array(const struct machine *m, void *array, int *cap, int n, size_t size)
{
    void *p;
    memcpy(&p, array, sizeof p);
    if (n <= *cap)
        return OK;
    if (n > PICKLE_VALUES_MAX)
        return err_fail(ERR_LIMIT, "%s: more than %d values", m->what, PICKLE_VALUES_MAX);
    int want = 64;
    while (want < n)
        want *= 2;
    p = realloc(p, (size_t)want * size);
    if (!p)
        return err_fail(ERR_NOMEM, "%s: no memory for %d values", m->what, want);
    memcpy(array, &p, sizeof p);
    *cap = want;
    return OK;
}

/* ---- values, stack ---- */

static struct pickle_value *value_at(const struct machine *m, int v)
{
    return &m->out->values[v];
}

static err_t push_value(struct machine *m, int v)
{
    err_t e = grow_array(m, &m->stack, &m->stack_cap, m->n_stack + 1, sizeof *m->stack);
    if (!e)
        m->stack[m->n_stack++] = v;
    return e;
}

static err_t push_new(struct machine *m, struct pickle_value v)
{
    struct pickle *p = m->out;
    err_t e = grow_array(m, &p->values, &p->values_cap, p->n_values + 1, sizeof *p->values);
    if (e)
        return e;
    p->values[p->n_values] = v;
    return push_value(m, p->n_values++);
}

static struct pickle_value empty_value(enum pickle_kind kind)
{
    return (struct pickle_value){.kind = kind, .first = NOTHING, .last = NOTHING};
}

static err_t push_kind(struct machine *m, enum pickle_kind kind)
{
    return push_new(m, empty_value(kind));
}

static err_t push_int(struct machine *m, int64_t number)
{
    struct pickle_value v = empty_value(PICKLE_INT);
    v.number = number;
    return push_new(m, v);
}

static err_t push_text(struct machine *m, size_t n)
{
    struct pickle_value v = empty_value(PICKLE_TEXT);
    v.text = (const char *)bytes_take(&m->in, n);
    v.n_text = n;
    return m->in.bad ? refuse_opcode(m, "cut short") : push_new(m, v);
}

static err_t push_opaque(struct machine *m, size_t n)
{
    bytes_skip(&m->in, n, 1);
    return push_kind(m, PICKLE_OPAQUE);
}

static err_t pop_value(struct machine *m, int *out)
{
    *out = NOTHING;
    if (m->n_stack == 0 || m->stack[m->n_stack - 1] == MARK)
        return refuse_opcode(m, "stack is empty");
    *out = m->stack[--m->n_stack];
    return OK;
}

/* The top value and the one below it. */
static err_t pop_two(struct machine *m, int *top, int *below)
{
    err_t e = pop_value(m, top);
    return e ? e : pop_value(m, below);
}

static err_t append_item(struct machine *m, int container, int v)
{
    struct pickle *p = m->out;
    err_t e = grow_array(m, &p->items, &p->items_cap, p->n_items + 1, sizeof *p->items);
    if (e)
        return e;
    int item = p->n_items++;
    p->items[item] = (struct pickle_item){v, NOTHING};
    struct pickle_value *c = value_at(m, container);
    if (c->last == NOTHING)
        c->first = item;
    else
        p->items[c->last].next = item;
    c->last = item;
    c->count++;
    return OK;
}

/* Stack entries above the last mark; the mark itself is removed by drop_to. */
static err_t find_mark(const struct machine *m, int *first)
{
    for (*first = m->n_stack; *first > 0; (*first)--)
        if (m->stack[*first - 1] == MARK)
            return OK;
    return refuse_opcode(m, "no mark");
}

/* ---- containers ---- */

/* A container of the entries from `first` on, which leave the stack. */
static err_t make_container(struct machine *m, enum pickle_kind kind, int first, int keep)
{
    err_t e = OK;
    int n = m->n_stack;
    if (kind == PICKLE_DICT && (n - first) % 2 != 0)
        return refuse_opcode(m, "key without value");
    e = push_kind(m, kind);
    if (e)
        return e;
    int made = m->stack[m->n_stack - 1];
    for (int i = first; i < n && !e; i++)
        e = append_item(m, made, m->stack[i]);
    m->n_stack = keep;
    return e ? e : push_value(m, made);
}

static err_t gather_mark(struct machine *m, enum pickle_kind kind)
{
    int first;
    err_t e = find_mark(m, &first);
    return e ? e : make_container(m, kind, first, first - 1);
}

static err_t gather_top(struct machine *m, int n)
{
    if (n > m->n_stack)
        return refuse_opcode(m, "stack is empty");
    for (int i = m->n_stack - n; i < m->n_stack; i++)
        if (m->stack[i] == MARK)
            return refuse_opcode(m, "stack is empty");
    return make_container(m, PICKLE_TUPLE, m->n_stack - n, m->n_stack - n);
}

/* Move the entries from `first` on into the container below them; `below`: entries to drop too. */
static err_t extend_container(struct machine *m, int first, int below, enum pickle_kind kind)
{
    int at = first - below - 1;
    if (at < 0 || first > m->n_stack || m->stack[at] == MARK)
        return refuse_opcode(m, "no container");
    int container = m->stack[at];
    enum pickle_kind is = value_at(m, container)->kind;
    if (is != kind && is != PICKLE_OPAQUE)
        return refuse_opcode(m, "items for what holds none");
    if (kind == PICKLE_DICT && (m->n_stack - first) % 2 != 0)
        return refuse_opcode(m, "key without value");
    err_t e = OK;
    for (int i = first; i < m->n_stack && !e; i++) {
        if (m->stack[i] == MARK)
            e = refuse_opcode(m, "stack is empty");
        else if (is == kind)
            e = append_item(m, container, m->stack[i]);
    }
    m->n_stack = at + 1;
    return e;
}

static err_t extend_mark(struct machine *m, enum pickle_kind kind)
{
    int first;
    err_t e = find_mark(m, &first);
    return e ? e : extend_container(m, first, 1, kind);
}

/* ---- globals and calls ---- */

static bool has_prefix(struct bytes text, const char *with)
{
    size_t n = strlen(with);
    return text.left >= n && memcmp(text.p, with, n) == 0;
}

static err_t push_global(struct machine *m, struct bytes module, struct bytes name)
{
    static const struct {
        const char *module, *name;
        enum pickle_global global;
    } known[] = {
        {"collections", "OrderedDict", PICKLE_ORDERED_DICT},
        {"torch._utils", "_rebuild_tensor_v2", PICKLE_REBUILD_TENSOR},
        {"torch._utils", "_rebuild_tensor", PICKLE_REBUILD_TENSOR}, // before 0.4
        {"torch._utils", "_rebuild_parameter", PICKLE_REBUILD_PARAMETER},
        {"torch._utils", "_rebuild_parameter_with_state", PICKLE_REBUILD_PARAMETER},
        {"torch.nn.parameter", "Parameter", PICKLE_REBUILD_PARAMETER}, // before 0.4
        {"torch._tensor", "_rebuild_from_type_v2", PICKLE_REBUILD_FROM_TYPE},
        {"torch", "Tensor", PICKLE_TENSOR_CLASS},
        {"torch", "FloatTensor", PICKLE_TENSOR_CLASS}, // before 0.2
        {"torch", "HalfTensor", PICKLE_TENSOR_CLASS},
        {"torch", "FloatStorage", PICKLE_FLOAT_STORAGE},
        {"torch", "BFloat16Storage", PICKLE_BFLOAT16_STORAGE},
        {"torch", "HalfStorage", PICKLE_HALF_STORAGE},
    };
    static const char torch[] = "torch.", rebuild[] = "_rebuild_";
    struct pickle_value v = empty_value(PICKLE_GLOBAL);
    v.text = (const char *)name.p;
    v.n_text = name.left;
    if (has_prefix(module, torch) && has_prefix(name, rebuild))
        v.global = PICKLE_REBUILD_OTHER;
    for (size_t k = 0; k < sizeof known / sizeof known[0]; k++)
        if (strlen(known[k].module) == module.left && strlen(known[k].name) == name.left &&
            memcmp(known[k].module, module.p, module.left) == 0 &&
            memcmp(known[k].name, name.p, name.left) == 0)
            v.global = known[k].global;
    return push_new(m, v);
}

/* The rest of the line. */
static struct bytes take_line(struct machine *m)
{
    const uint8_t *end = m->in.left > 0 ? memchr(m->in.p, '\n', m->in.left) : NULL;
    size_t n = end ? (size_t)(end - m->in.p) : m->in.left;
    struct bytes line = bytes_of(m->in.p, n);
    bytes_skip(&m->in, n + 1, 1);
    return line;
}

static err_t global_of_lines(struct machine *m)
{
    struct bytes module = take_line(m), name = take_line(m);
    return m->in.bad ? refuse_opcode(m, "cut short") : push_global(m, module, name);
}

static err_t global_of_stack(struct machine *m)
{
    int name, module;
    err_t e = pop_two(m, &name, &module);
    if (e)
        return e;
    const struct pickle_value *a = value_at(m, module), *b = value_at(m, name);
    if (a->kind != PICKLE_TEXT || b->kind != PICKLE_TEXT)
        return refuse_opcode(m, "a name that is no text");
    return push_global(m, bytes_of(a->text, a->n_text), bytes_of(b->text, b->n_text));
}

/* A tensor made by a function of PyTorch that is not supported. */
static err_t push_foreign(struct machine *m, const struct pickle_value *by)
{
    struct pickle_value v = empty_value(PICKLE_FOREIGN);
    v.global = by->global;
    v.text = by->text;
    v.n_text = by->n_text;
    return push_new(m, v);
}

static err_t push_tensor(struct machine *m, struct pickle_value args)
{
    args.kind = PICKLE_TENSOR;
    return push_new(m, args);
}

/* Arguments: function, class, the function's arguments, attributes. */
static err_t from_type(struct machine *m, const struct pickle_value *args)
{
    const struct pickle_value *function = pickle_item(m->out, args, 0),
                              *class = pickle_item(m->out, args, 1),
                              *inner = pickle_item(m->out, args, 2);
    if (!inner || function->kind != PICKLE_GLOBAL || class->kind != PICKLE_GLOBAL ||
        inner->kind != PICKLE_TUPLE)
        return push_kind(m, PICKLE_OPAQUE);
    if (class->global != PICKLE_TENSOR_CLASS)
        return push_foreign(m, class);
    return function->global == PICKLE_REBUILD_TENSOR ? push_tensor(m, *inner)
                                                     : push_foreign(m, function);
}

/* OrderedDict([[key, value], ...]), as Python 2 writes it; of no list (NULL) empty. */
static err_t push_ordered(struct machine *m, const struct pickle_value *list)
{
    int i = list ? list->first : NOTHING;
    err_t e = push_kind(m, PICKLE_DICT);
    const int made = m->out->n_values - 1;
    for (; i != NOTHING && !e; i = m->out->items[i].next) {
        const struct pickle_value *pair = value_at(m, m->out->items[i].value);
        const int key = pair->first;
        if (pair->count != 2)
            return refuse_opcode(m, "key without value");
        e = append_item(m, made, m->out->items[key].value);
        if (!e)
            e = append_item(m, made, m->out->items[m->out->items[key].next].value);
    }
    return e;
}

/* The call of what lies below its arguments. */
static err_t op_reduce(struct machine *m)
{
    int args, function;
    err_t e = pop_two(m, &args, &function);
    if (e)
        return e;
    const struct pickle_value given = *value_at(m, args), called = *value_at(m, function);
    if (given.kind != PICKLE_TUPLE)
        return refuse_opcode(m, "arguments that are no tuple");
    if (called.kind != PICKLE_GLOBAL)
        return push_kind(m, PICKLE_OPAQUE);
    const struct pickle_value *first = pickle_item(m->out, &given, 0);
    if (called.global == PICKLE_ORDERED_DICT && (!first || first->kind == PICKLE_LIST))
        return push_ordered(m, first);
    if (called.global == PICKLE_REBUILD_PARAMETER && given.count > 0)
        return push_value(m, m->out->items[given.first].value);
    if (called.global == PICKLE_REBUILD_TENSOR)
        return push_tensor(m, given);
    if (called.global == PICKLE_REBUILD_FROM_TYPE)
        return from_type(m, &given);
    if (called.global == PICKLE_REBUILD_OTHER)
        return push_foreign(m, &called);
    return push_kind(m, PICKLE_OPAQUE);
}

/* An object of a class, with its arguments: before 0.4 also a parameter of its tensor. What gets
 * its contents from op_build is foreign until then. */
static err_t new_object(struct machine *m)
{
    int args, class;
    err_t e = pop_two(m, &args, &class);
    if (e)
        return e;
    const struct pickle_value *given = value_at(m, args), of = *value_at(m, class);
    const bool known = of.kind == PICKLE_GLOBAL &&
                       (of.global == PICKLE_REBUILD_PARAMETER || of.global == PICKLE_TENSOR_CLASS);
    if (known && given->count == 0)
        return push_foreign(m, &of);
    if (known && of.global == PICKLE_REBUILD_PARAMETER)
        return push_value(m, m->out->items[given->first].value);
    return push_kind(m, PICKLE_OPAQUE);
}

static err_t new_object_ex(struct machine *m)
{
    int gone;
    err_t e = OK;
    for (int i = 0; i < 3 && !e; i++)
        e = pop_value(m, &gone);
    return e ? e : push_kind(m, PICKLE_OPAQUE);
}

/* The attributes of an object do not matter, except those of which PyTorch made tensors (storage,
 * offset, shape, strides) and parameters (tensor, gradient, hooks, two marks) at first. */
static err_t op_build(struct machine *m)
{
    int state, object;
    err_t e = pop_two(m, &state, &object);
    if (e)
        return e;
    const struct pickle_value given = *value_at(m, state);
    struct pickle_value *v = value_at(m, object);
    const bool blank = v->kind == PICKLE_FOREIGN && given.kind == PICKLE_TUPLE;
    if (blank && v->global == PICKLE_TENSOR_CLASS && given.count == 4) {
        *v = given;
        v->kind = PICKLE_TENSOR;
    } else if (blank && v->global == PICKLE_REBUILD_PARAMETER && given.count == 5) {
        *v = *value_at(m, m->out->items[given.first].value);
    }
    return push_value(m, object);
}

static err_t load_persistent(struct machine *m)
{
    int id;
    err_t e = pop_value(m, &id);
    if (e)
        return e;
    struct pickle_value storage = *value_at(m, id);
    if (storage.kind != PICKLE_TUPLE)
        return push_kind(m, PICKLE_OPAQUE);
    storage.kind = PICKLE_STORAGE;
    return push_new(m, storage);
}

/* ---- memo ---- */

static err_t memo_put(struct machine *m, uint32_t at)
{
    if (m->n_stack == 0 || m->stack[m->n_stack - 1] == MARK)
        return refuse_opcode(m, "stack is empty");
    if (at >= PICKLE_VALUES_MAX)
        return err_fail(ERR_LIMIT, "%s: memo %u, at most %d are read", m->what, at,
                        PICKLE_VALUES_MAX);
    err_t e = grow_array(m, &m->memo, &m->memo_cap, (int)at + 1, sizeof *m->memo);
    if (e)
        return e;
    while (m->n_memo <= (int)at)
        m->memo[m->n_memo++] = NOTHING;
    m->memo[at] = m->stack[m->n_stack - 1];
    return OK;
}

static err_t memo_get(struct machine *m, uint32_t at)
{
    if (at >= (uint32_t)m->n_memo || m->memo[at] == NOTHING)
        return refuse_opcode(m, "a memo that was never written");
    return push_value(m, m->memo[at]);
}

/* ---- opcodes ---- */

enum { UNKNOWN_OP = 1 }; // beside err_t, whose errors are negative

/* An integer of n bytes, two's complement. */
static err_t push_long(struct machine *m, size_t n)
{
    uint64_t v = 0;
    const uint8_t *p = bytes_take(&m->in, n);
    if (!p && n > 0)
        return refuse_opcode(m, "cut short");
    if (n > 8)
        return push_kind(m, PICKLE_OPAQUE);
    for (size_t i = 0; i < n; i++)
        v |= (uint64_t)p[i] << (8 * i);
    if (n > 0 && n < 8 && p[n - 1] & 0x80)
        v |= UINT64_MAX << (8 * n);
    return push_int(m, (int64_t)v);
}

static int run_constant(struct machine *m)
{
    switch (m->op) {
    case 'K': // BININT1
        return push_int(m, bytes_u8(&m->in));
    case 'M': // BININT2
        return push_int(m, bytes_u16(&m->in));
    case 'J': // BININT
        return push_int(m, (int32_t)bytes_u32(&m->in));
    case 0x8a: // LONG1
        return push_long(m, bytes_u8(&m->in));
    case 0x8b: // LONG4
        return push_long(m, bytes_u32(&m->in));
    case 0x88: // NEWTRUE
        return push_int(m, 1);
    case 0x89: // NEWFALSE
        return push_int(m, 0);
    case 'N': // NONE
        return push_opaque(m, 0);
    case 'G': // BINFLOAT
        return push_opaque(m, 8);
    case 'X': // BINUNICODE
    case 'T': // BINSTRING
        return push_text(m, bytes_u32(&m->in));
    case 0x8c: // SHORT_BINUNICODE
    case 'U':  // SHORT_BINSTRING
        return push_text(m, bytes_u8(&m->in));
    case 0x8d: // BINUNICODE8
        return push_text(m, bytes_u64(&m->in));
    case 'C': // SHORT_BINBYTES
        return push_opaque(m, bytes_u8(&m->in));
    case 'B': // BINBYTES
        return push_opaque(m, bytes_u32(&m->in));
    case 0x8e: // BINBYTES8
    case 0x96: // BYTEARRAY8
        return push_opaque(m, bytes_u64(&m->in));
    default:
        return UNKNOWN_OP;
    }
}

static int run_container(struct machine *m)
{
    switch (m->op) {
    case '}': // EMPTY_DICT
        return push_kind(m, PICKLE_DICT);
    case ']': // EMPTY_LIST
        return push_kind(m, PICKLE_LIST);
    case ')': // EMPTY_TUPLE
        return push_kind(m, PICKLE_TUPLE);
    case 0x8f: // EMPTY_SET
        return push_kind(m, PICKLE_OPAQUE);
    case '(': // MARK
        return push_value(m, MARK);
    case 't': // TUPLE
        return gather_mark(m, PICKLE_TUPLE);
    case 'l': // LIST
        return gather_mark(m, PICKLE_LIST);
    case 'd': // DICT
        return gather_mark(m, PICKLE_DICT);
    case 0x91: // FROZENSET
        return gather_mark(m, PICKLE_OPAQUE);
    case 0x85: // TUPLE1
    case 0x86: // TUPLE2
    case 0x87: // TUPLE3
        return gather_top(m, m->op - 0x84);
    case 'a': // APPEND
        return extend_container(m, m->n_stack - 1, 0, PICKLE_LIST);
    case 's': // SETITEM
        return extend_container(m, m->n_stack - 2, 0, PICKLE_DICT);
    case 'e': // APPENDS
        return extend_mark(m, PICKLE_LIST);
    case 'u': // SETITEMS
        return extend_mark(m, PICKLE_DICT);
    case 0x90: // ADDITEMS
        return extend_mark(m, PICKLE_OPAQUE);
    default:
        return UNKNOWN_OP;
    }
}

static err_t drop_mark(struct machine *m)
{
    int first;
    err_t e = find_mark(m, &first);
    if (!e)
        m->n_stack = first - 1;
    return e;
}

static err_t check_end(struct machine *m)
{
    err_t e = pop_value(m, &m->out->root);
    if (!e && m->n_stack != 0)
        e = refuse_opcode(m, "values left over");
    m->done = true;
    return e;
}

static int run_other(struct machine *m)
{
    uint64_t n;
    int v;
    switch (m->op) {
    case 0x80: // PROTO
        return bytes_u8(&m->in) > PROTOCOL_MAX ? refuse_opcode(m, "unknown protocol") : OK;
    case 0x95: // FRAME
        n = bytes_u64(&m->in);
        return n > m->in.left ? refuse_opcode(m, "frame beyond the end") : OK;
    case 'q': // BINPUT
        return memo_put(m, bytes_u8(&m->in));
    case 'r': // LONG_BINPUT
        return memo_put(m, bytes_u32(&m->in));
    case 0x94: // MEMOIZE
        return memo_put(m, (uint32_t)m->n_memo);
    case 'h': // BINGET
        return memo_get(m, bytes_u8(&m->in));
    case 'j': // LONG_BINGET
        return memo_get(m, bytes_u32(&m->in));
    case 'c': // GLOBAL
        return global_of_lines(m);
    case 0x93: // STACK_GLOBAL
        return global_of_stack(m);
    case 'R': // REDUCE
        return op_reduce(m);
    case 0x81: // NEWOBJ
        return new_object(m);
    case 0x92: // NEWOBJ_EX
        return new_object_ex(m);
    case 'b': // BUILD
        return op_build(m);
    case '0': // POP
        return pop_value(m, &v);
    case '1': // POP_MARK
        return drop_mark(m);
    case '2': // DUP
        return m->n_stack == 0 ? refuse_opcode(m, "stack is empty")
                               : push_value(m, m->stack[m->n_stack - 1]);
    case 'Q': // BINPERSID
        return load_persistent(m);
    case '.': // STOP
        return check_end(m);
    default:
        return UNKNOWN_OP;
    }
}

static err_t run_opcode(struct machine *m)
{
    m->op = bytes_u8(&m->in);
    if (m->in.bad)
        return refuse_opcode(m, "cut short");
    int e = run_constant(m);
    if (e == UNKNOWN_OP)
        e = run_container(m);
    if (e == UNKNOWN_OP)
        e = run_other(m);
    if (e == UNKNOWN_OP)
        return refuse_opcode(m, "not an opcode of data");
    return e == OK && m->in.bad ? refuse_opcode(m, "cut short") : (err_t)e;
}

err_t pickle_parse(const char *what, const void *p, size_t n, struct pickle *out)
{
    struct machine m = {.what = what, .in = bytes_of(p, n), .n = n, .out = out};
    memset(out, 0, sizeof *out);
    err_t e = OK;
    while (!m.done && !e)
        e = run_opcode(&m);
    free(m.stack);
    free(m.memo);
    out->bytes = n - m.in.left;
    if (e)
        pickle_free(out);
    return e;
}

void pickle_free(struct pickle *p)
{
    free(p->values);
    free(p->items);
    memset(p, 0, sizeof *p);
}

const struct pickle_value *pickle_item(const struct pickle *p, const struct pickle_value *v, int i)
{
    int item = v->first;
    if (i >= v->count)
        return NULL;
    while (i-- > 0)
        item = p->items[item].next;
    return &p->values[p->items[item].value];
}

const struct pickle_value *pickle_get(const struct pickle *p, const struct pickle_value *dict,
                                      const char *key)
{
    const struct pickle_value *found = NULL;
    if (dict->kind != PICKLE_DICT)
        return NULL;
    for (int i = dict->first; i != NOTHING; i = p->items[p->items[i].next].next) {
        const struct pickle_value *k = &p->values[p->items[i].value];
        if (k->kind == PICKLE_TEXT && k->n_text == strlen(key) && !memcmp(k->text, key, k->n_text))
            found = &p->values[p->items[p->items[i].next].value];
    }
    return found;
}
