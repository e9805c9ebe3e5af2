/* Pickles by hand: what PyTorch writes is understood, what it does not is refused or opaque. */
#include "drivers/format/pickle.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* A string of exact length, so that reads beyond it are seen by ASan. */
#define PARSE(text, out) parse(text, sizeof text - 1, out)

static err_t parse(const char *text, size_t n, struct pickle *out)
{
    static char *exact;
    free(exact);
    exact = malloc(n + 1);
    memcpy(exact + 1, text, n);
    err_t e = pickle_parse("f", exact + 1, n, out);
    if (e)
        assert_true(out->values == NULL && out->items == NULL);
    return e;
}

static const struct pickle_value *root(const struct pickle *p)
{
    return &p->values[p->root];
}

static void numbers_and_texts(void **state)
{
    (void)state;
    static const struct {
        const char *text;
        size_t n;
        int64_t number;
    } ints[] = {
        {"K\xff.", 3, 255},
        {"M\xff\xfe.", 4, 0xfeff},
        {"J\xfe\xff\xff\xff.", 6, -2},
        {"\x8a\x00.", 3, 0},
        {"\x8a\x01\xff.", 4, -1},
        {"\x8a\x02\xff\x00.", 5, 255},
        {"\x8a\x08\x01\x00\x00\x00\x00\x00\x00\x80.", 11, INT64_MIN + 1},
        {"\x8b\x01\x00\x00\x00\x80.", 7, -128},
        {"\x88.", 2, 1},
        {"\x89.", 2, 0},
    };
    struct pickle p;
    for (size_t k = 0; k < sizeof ints / sizeof ints[0]; k++) {
        assert_int_equal(parse(ints[k].text, ints[k].n, &p), OK);
        assert_int_equal(root(&p)->kind, PICKLE_INT);
        assert_true(root(&p)->number == ints[k].number);
        pickle_free(&p);
    }
    assert_int_equal(PARSE("\x8a\x09\1\1\1\1\1\1\1\1\1.", &p), OK);
    assert_int_equal(root(&p)->kind, PICKLE_OPAQUE);
    pickle_free(&p);
    assert_int_equal(PARSE("\x80\x02X\x03\x00\x00\x00"
                           "abc.",
                           &p),
                     OK);
    assert_true(root(&p)->kind == PICKLE_TEXT && root(&p)->n_text == 3);
    assert_memory_equal(root(&p)->text, "abc", 3);
    pickle_free(&p);
}

static void containers_keep_order_and_may_hold_themselves(void **state)
{
    (void)state;
    struct pickle p;
    /* d = {"a": (1, 2), "l": [3], "a": d} */
    assert_int_equal(PARSE("\x80\x02}q\x00(U\x01"
                           "aK\x01K\x02\x86U\x01l]K\x03"
                           "aU\x01"
                           "ah\x00u.",
                           &p),
                     OK);
    const struct pickle_value *d = root(&p);
    assert_int_equal(d->kind, PICKLE_DICT);
    assert_int_equal(d->count, 6);
    assert_int_equal(pickle_item(&p, d, 1)->kind, PICKLE_TUPLE);
    assert_int_equal(pickle_item(&p, pickle_item(&p, d, 1), 1)->number, 2);
    assert_null(pickle_item(&p, pickle_item(&p, d, 1), 2));
    assert_int_equal(pickle_item(&p, pickle_get(&p, d, "l"), 0)->number, 3);
    assert_ptr_equal(pickle_get(&p, d, "a"), d);
    assert_null(pickle_get(&p, d, "b"));
    assert_null(pickle_get(&p, pickle_item(&p, d, 0), "a"));
    pickle_free(&p);
}

#define TENSOR_ARGS                                                                                \
    "((U\x07storagectorch\nFloatStorage\nU\x01"                                                    \
    "0U\x03"                                                                                       \
    "cpuK\x04tQK\x00K\x02K\x02\x86K\x02K\x01"                                                      \
    "\x86\x89}t"

static void tensors_are_recognised(void **state)
{
    (void)state;
    struct pickle p;
    assert_int_equal(PARSE("\x80\x02"
                           "ctorch._utils\n_rebuild_tensor_v2\n" TENSOR_ARGS "R.",
                           &p),
                     OK);
    const struct pickle_value *t = root(&p), *s = pickle_item(&p, t, 0);
    assert_int_equal(t->kind, PICKLE_TENSOR);
    assert_int_equal(s->kind, PICKLE_STORAGE);
    assert_int_equal(pickle_item(&p, s, 1)->global, PICKLE_FLOAT_STORAGE);
    assert_int_equal(pickle_item(&p, pickle_item(&p, t, 3), 0)->number, 2);
    pickle_free(&p);
    assert_int_equal(PARSE("\x80\x02"
                           "ctorch._utils\n_rebuild_parameter\n"
                           "ctorch._utils\n_rebuild_tensor_v2\n" TENSOR_ARGS "R\x88}\x87R.",
                           &p),
                     OK);
    assert_int_equal(root(&p)->kind, PICKLE_TENSOR);
    pickle_free(&p);
    /* with attributes: of a parameter, of a tensor */
    assert_int_equal(PARSE("\x80\x02"
                           "ctorch._utils\n_rebuild_parameter_with_state\n("
                           "ctorch._utils\n_rebuild_tensor_v2\n" TENSOR_ARGS "R\x88}}tR.",
                           &p),
                     OK);
    assert_int_equal(root(&p)->kind, PICKLE_TENSOR);
    pickle_free(&p);
#define FROM_TYPE(function, class, args)                                                           \
    "\x80\x02"                                                                                     \
    "ctorch._tensor\n_rebuild_from_type_v2\n(c" function "c" class args "}tR."
    assert_int_equal(
        PARSE(FROM_TYPE("torch._utils\n_rebuild_tensor_v2\n", "torch\nTensor\n", TENSOR_ARGS), &p),
        OK);
    assert_int_equal(root(&p)->kind, PICKLE_TENSOR);
    assert_int_equal(pickle_item(&p, root(&p), 0)->kind, PICKLE_STORAGE);
    pickle_free(&p);
    /* protocol 4: names from the stack, frames, memoize */
    assert_int_equal(PARSE("\x80\x04\x95\x20\0\0\0\0\0\0\0\x8c\x0b"
                           "collections\x94\x8c\x0b"
                           "OrderedDict\x93)R\x94.\0\0",
                           &p),
                     OK);
    assert_int_equal(root(&p)->kind, PICKLE_DICT);
    pickle_free(&p);
}

/* Tensors that are made in other ways carry what says so. */
static void foreign_tensors_are_told(void **state)
{
    static const struct {
        const char *text;
        size_t n;
        const char *by;
        enum pickle_kind kind;
    } cases[] = {
#define CASE(text, by, kind) {text, sizeof text - 1, by, kind}
        CASE("\x80\x02"
             "ctorch._utils\n_rebuild_qtensor\n)R.",
             "_rebuild_qtensor", PICKLE_FOREIGN),
        CASE(FROM_TYPE("torch._utils\n_rebuild_tensor_v2\n", "__main__\nOwn\n", TENSOR_ARGS), "Own",
             PICKLE_FOREIGN),
        CASE(FROM_TYPE("torch._utils\n_rebuild_qtensor\n", "torch\nTensor\n", ")"),
             "_rebuild_qtensor", PICKLE_FOREIGN),
        CASE(FROM_TYPE("os\nsystem\n", "torch\nTensor\n", ")"), "system", PICKLE_FOREIGN),
        CASE(FROM_TYPE("os\nsystem\n", "torch\nTensor\n", "K\1"), "", PICKLE_OPAQUE),
        CASE("\x80\x02"
             "ctorch._tensor\n_rebuild_from_type_v2\n)R.",
             "", PICKLE_OPAQUE),
        CASE("\x80\x02"
             "cmine\n_rebuild_\n)R.",
             "", PICKLE_OPAQUE),
    };
    (void)state;
    for (size_t k = 0; k < sizeof cases / sizeof cases[0]; k++) {
        struct pickle p;
        assert_int_equal(parse(cases[k].text, cases[k].n, &p), OK);
        assert_int_equal(root(&p)->kind, cases[k].kind);
        assert_int_equal(root(&p)->n_text, strlen(cases[k].by));
        if (*cases[k].by)
            assert_memory_equal(root(&p)->text, cases[k].by, strlen(cases[k].by));
        pickle_free(&p);
    }
}

static void nothing_is_called(void **state)
{
    (void)state;
    struct pickle p;
    static const char *const harmless[] = {
        "\x80\x02"
        "cos\nsystem\nU\x04"
        "true\x85R.",
        "\x80\x02"
        "cbuiltins\neval\nU\x01"
        "1\x85R.",
        "\x80\x02"
        "ctorch._utils\n_import_dotted_name\n)R.",
        "\x80\x02"
        "ctorch\nLongStorage\n.",
        "\x80\x02"
        "cposix\nsystem\n)\x81}b.",
        "\x80\x02"
        "ca\nb\n)\x81(U\x01xK\x01u.",
        "\x80\x02"
        "ca\nb\n)\x81K\x01"
        "a.",
        "\x80\x02(K\x01K\x02\x91.",
        "\x80\x02U\x01iQ.",
    };
    for (size_t k = 0; k < sizeof harmless / sizeof harmless[0]; k++) {
        assert_int_equal(parse(harmless[k], strlen(harmless[k]), &p), OK);
        assert_int_equal(root(&p)->kind, k == 3 ? PICKLE_GLOBAL : PICKLE_OPAQUE);
        assert_int_equal(root(&p)->global, PICKLE_UNKNOWN);
        pickle_free(&p);
    }
}

static const struct {
    const char *text;
    size_t n;
    const char *sentence;
    err_t code;
} wrong[] = {
#define W(text, sentence)                                                                          \
    {                                                                                              \
        text, sizeof text - 1, sentence, ERR_FORMAT                                                \
    }
    W("", "cut short"),
    W("K", "cut short"),
    W("K\x01", "cut short"),
    W("X\x10\0\0\0abc.", "cut short"),
    W("X\xff\xff\xff\xff.", "cut short"),
    W("\x8d\xff\xff\xff\xff\xff\xff\xff\xff.", "cut short"),
    W("\x8e\xff\xff\xff\xff\xff\xff\xff\xff.", "cut short"),
    W("\x8a\xff\x01.", "cut short"),
    W("\x8b\xff\xff\xff\xff.", "cut short"),
    W("cos\nsystem", "cut short"),
    W("\x80\x06N.", "unknown protocol"),
    W("\x95\xff\xff\xff\xff\xff\xff\xff\xffN.", "frame beyond the end"),
    W("\x95\x03\0\0\0\0\0\0\0N.", "frame beyond the end"),
    W(".", "stack is empty"),
    W("(.", "stack is empty"),
    W("NN.", "values left over"),
    W("0.", "stack is empty"),
    W("1.", "no mark"),
    W("t.", "no mark"),
    W("2.", "stack is empty"),
    W("\x86.", "stack is empty"),
    W("N(\x85.", "stack is empty"),
    W("(K\x01"
      "d.",
      "key without value"),
    W("}(K\x01u.", "key without value"),
    W("}K\x01s.", "no container"),
    W("(K\x01K\x02s.", "no container"),
    W("a.", "no container"),
    W("K\x01K\x02"
      "a.",
      "items for what holds none"),
    W("](K\x01K\x02u.", "items for what holds none"),
    W(")K\x02"
      "a.",
      "items for what holds none"),
    W("]("
      "a.",
      "stack is empty"),
    W("h\x00.", "memo that was never written"),
    W("Nq\x05h\x04.", "memo that was never written"),
    W("j\xff\xff\xff\xff.", "memo that was never written"),
    W("q\x00.", "stack is empty"),
    W("(q\x00.", "stack is empty"),
    W("NN\x93.", "a name that is no text"),
    W("NNR.", "arguments that are no tuple"),
    W("R.", "stack is empty"),
    W("b.", "stack is empty"),
    W("\x81.", "stack is empty"),
    W("Q.", "stack is empty"),
    W("I1\n.", "not an opcode of data"),
    W("P1\n.", "not an opcode of data"),
    W("\x82\x01.", "not an opcode of data"),
    W("(ios\nsystem\n.", "not an opcode of data"),
    W("(o.", "not an opcode of data"),
    W("\x97.", "not an opcode of data"),
    {"Nr\xff\xff\xff\x7f.", 7, "memo 2147483647, at most", ERR_LIMIT},
    {"Nr\x00\x00\x10\x00.", 7, "memo 1048576, at most", ERR_LIMIT},
};

static void malformed_pickles_are_refused(void **state)
{
    (void)state;
    struct pickle p;
    for (size_t k = 0; k < sizeof wrong / sizeof wrong[0]; k++) {
        err_t e = parse(wrong[k].text, wrong[k].n, &p);
        if (e != wrong[k].code || !strstr(err_text(), wrong[k].sentence))
            fail_msg("%zu: %d, not %d (%s): %s", k, e, wrong[k].code, wrong[k].sentence,
                     err_text());
    }
}

static void numbers_of_values_are_bounded(void **state)
{
    (void)state;
    struct pickle p;
    size_t n = PICKLE_VALUES_MAX + 2;
    char *many = malloc(n + 16);
    memset(many, 'N', n); // values
    assert_int_equal(pickle_parse("f", many, n, &p), ERR_LIMIT);
    memset(many, '(', n); // stack
    assert_int_equal(pickle_parse("f", many, n, &p), ERR_LIMIT);
    memset(many, '2', n); // the same value on the stack
    many[0] = 'N';
    assert_int_equal(pickle_parse("f", many, n, &p), ERR_LIMIT);
    many[0] = ']'; // items without values: a list appended to itself
    for (size_t i = 1; i + 1 < n; i += 2)
        many[i] = '2', many[i + 1] = 'a';
    assert_int_equal(pickle_parse("f", many, n, &p), ERR_FORMAT); // ends before the bound
    free(many);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(numbers_and_texts),
        cmocka_unit_test(containers_keep_order_and_may_hold_themselves),
        cmocka_unit_test(tensors_are_recognised),
        cmocka_unit_test(foreign_tensors_are_told),
        cmocka_unit_test(nothing_is_called),
        cmocka_unit_test(malformed_pickles_are_refused),
        cmocka_unit_test(numbers_of_values_are_bounded),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
