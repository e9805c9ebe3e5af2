/* Files of PyTorch's older container: one that PyTorch wrote (tests/data/ckpt/make.py), and made
 * ones with the pickles of its first versions and with lies. */
#include "core/base/bytes.h"
#include "drivers/format/checkpoint.h"
#include "drivers/format/file.h"

#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#define OLD "tests/data/ckpt/old.pt"

static void holds(const struct checkpoint *c, const char *name, const float *want, size_t n)
{
    float got[8];
    const struct checkpoint_tensor *t = checkpoint_find(c, name);
    if (!t)
        fail_msg("no %s", name);
    assert_int_equal(checkpoint_count(t), n);
    assert_int_equal(checkpoint_read(c, t, got), OK);
    assert_memory_equal(got, want, n * sizeof *want);
}

static void a_file_of_pytorch_is_read(void **state)
{
    static const float weight[] = {0, 1, 2, 3, 4, 5}, bias[] = {6, 8, 10, 7, 9, 11},
                       half[] = {1, -2.5f}, brain[] = {0.5f, 3}, lin[] = {0.25f, 0.125f};
    struct checkpoint c;
    (void)state;
    assert_int_equal(checkpoint_open(OLD, "", &c), OK);
    assert_int_equal(c.n, 8);
    holds(&c, "features.0.weight", weight, 6);
    holds(&c, "features.0.bias", bias, 6);
    holds(&c, "half", half, 2);
    holds(&c, "brain", brain, 2);
    holds(&c, "lin0.model.1.weight", lin, 2);
    assert_string_equal(checkpoint_find(&c, "wave")->kind, "ComplexFloatStorage");
    assert_string_equal(checkpoint_find(&c, "mask")->kind, "BoolStorage");
    checkpoint_close(&c);
    assert_int_equal(checkpoint_open(OLD, "encoder.", &c), OK);
    holds(&c, "encoder.lin0.model.1.weight", lin, 2);
    checkpoint_close(&c);
}

static void every_cut_is_refused(void **state)
{
    struct file_map m;
    struct checkpoint c;
    (void)state;
    assert_int_equal(file_map(OLD, 1 << 24, &m), OK);
    for (size_t n = 0; n < m.n; n++) {
        assert_int_equal(checkpoint_open(tmpdir_write("cut", m.p, n), "", &c), ERR_FORMAT);
        assert_true(c.tensors == NULL && c.parts == NULL);
    }
    file_unmap(&m);
}

/* ---- made files ---- */

struct text {
    const char *p;
    size_t n;
};

#define TEXT(s) ((struct text){s, sizeof s - 1})
#define MAGIC "\x80\2\x8a\nl\xfc\234F\xf9 j\xa8P\031."
#define PROTOCOL "\x80\2M\xe9\3."
#define MACHINE(little) "\x80\2}U\015little_endian" little "s."
#define START MAGIC PROTOCOL MACHINE("\x88")
#define KEYS "\x80\2]U\0010a."
#define COUNT(low) low "\0\0\0\0\0\0\0"
#define STORAGE(class, count) "(U\007storagectorch\n" class "\nU\0010U\006cuda:0" count "NtQ"
#define FLOATS STORAGE("FloatStorage", "K\4")
#define STATE(storage) storage "K\1K\3\x85K\1\x85"
#define TENSOR "ctorch._utils\n_rebuild_tensor\n(" STATE(FLOATS) "tR"

static err_t open_old(struct text start, struct text object, struct text end, struct checkpoint *c)
{
    static const float values[4] = {1, 2, 3, 4};
    uint8_t all[1024], *at = all;
    const struct text parts[] = {start, object, end, {(const char *)values, sizeof values}};
    for (int i = 0; i < 4; i++) {
        memcpy(at, parts[i].p, parts[i].n);
        at += parts[i].n;
    }
    return checkpoint_open(tmpdir_write("made.pth", all, (size_t)(at - all)), "", c);
}

/* What Python 2 and PyTorch before 0.4 wrote. */
static void first_versions_are_read(void **state)
{
    static const struct text forms[] = {
        TEXT("\x80\2}U\1w" TENSOR "s."),
        TEXT("\x80\2"
             "ccollections\nOrderedDict\n](](U\1w" TENSOR "ee\x85R."),
        TEXT("\x80\2}U\1wctorch.nn.parameter\nParameter\n" TENSOR "\x85R(\x88\x89Ntbs."),
        TEXT("\x80\2}U\1wctorch.nn.parameter\nParameter\n" TENSOR "\x85\x81(\x88\x89Ntbs."),
        TEXT("\x80\2}U\1wctorch.nn.parameter\nParameter\n)\x81(" TENSOR "NN\x88\x89tbs."),
        TEXT("\x80\2}U\1wctorch\nFloatTensor\n)\x81(" STATE(FLOATS) "tbs."),
    };
    static const float want[] = {2, 3, 4};
    struct checkpoint c;
    (void)state;
    for (size_t i = 0; i < sizeof forms / sizeof forms[0]; i++) {
        if (open_old(TEXT(START), forms[i], TEXT(KEYS COUNT("\4")), &c) != OK)
            fail_msg("form %zu: %s", i, err_text());
        assert_int_equal(c.n, 1);
        holds(&c, "w", want, 3);
        checkpoint_close(&c);
    }
}

static void refused(struct text start, struct text object, struct text end, const char *sentence)
{
    struct checkpoint c;
    err_t e = open_old(start, object, end, &c);
    if (e != ERR_FORMAT || !strstr(err_text(), sentence))
        fail_msg("%d (%s): %s", e, sentence, err_text());
    assert_true(c.parts == NULL && c.tensors == NULL);
}

static void lies_are_refused(void **state)
{
#define OBJECT(member) TEXT("\x80\2}" member ".")
#define OF(storage) OBJECT("U\1wctorch._utils\n_rebuild_tensor\n(" STATE(storage) "tRs")
    const struct text good = OF(FLOATS), end = TEXT(KEYS COUNT("\4"));
    (void)state;
    refused(TEXT("\x80\2\x8a\nl\xfc\234F\xf9 j\xa8P\032."), good, end, "magic number is wrong");
    refused(TEXT("\x80\2K\1."), good, end, "magic number is wrong");
    refused(TEXT(MAGIC "\x80\2M\xe8\3."), good, end, "protocol 1001");
    refused(TEXT(MAGIC PROTOCOL MACHINE("\x89")), good, end, "little-endian machine");
    refused(TEXT(MAGIC PROTOCOL "\x80\2}."), good, end, "little-endian machine");
    refused(TEXT(START), OBJECT(""), end, "whose type is not known");
    refused(TEXT(START), OF(STORAGE("OwnStorage", "K\4")), end, "whose type is not known");
    refused(TEXT(START), OF(STORAGE("FloatStorage", "K\5")), end, "5 elements in 16 bytes");
    refused(TEXT(START), OF(STORAGE("FloatStorage", "K\3")), end, "beyond its storage");
    refused(TEXT(START), OF(STORAGE("FloatStorage", "N")), end, "whose type is not known");
    refused(TEXT(START), OF("(U\007storagectorch\nFloatStorage\nU\0010U\3cpuK\4(U\0011K\1K\3ttQ"),
            end, "whose type is not known");
    refused(TEXT(START), OF("(U\007storagectorch\nFloatStorage\nU\0010U\3cpuK\4(U\0011K\1K\3ttQ"),
            TEXT("\x80\2]."), "tensor w: has no storage, or one that is part of another");
    refused(TEXT(START), good, TEXT("\x80\2]."), "tensor w: the file has no storage 0");
    refused(TEXT(START), good, TEXT("\x80\2U\0010."), "no list of storages");
    refused(TEXT(START), good, TEXT("\x80\2]K\0a."), "whose type is not known");
    refused(TEXT(START), good, TEXT("\x80\2]U\0011a." COUNT("\4")), "whose type is not known");
    refused(TEXT(START), good, TEXT(KEYS COUNT("\5")), "cut short: storage 0 of 5 elements");
    refused(TEXT(START), good, TEXT(KEYS "\1\0\0\0\0\0\0\x40"), "of 4611686018427387905 elements");
    refused(TEXT(START), good, TEXT(KEYS "\xff\xff\xff\xff\xff\xff\xff\xff"), "cut short");
    refused(TEXT(START),
            OBJECT("U\1wctorch._utils\n_rebuild_tensor\n(" STATE(
                FLOATS) "tRs"
                        "U\1vctorch._utils\n_rebuild_tensor\n(" STATE(
                            STORAGE("HalfStorage", "K\4")) "tRs"),
            end, "storage 0 has two types");
    refused(TEXT(START), TEXT("\x80\2ccollections\nOrderedDict\n](K\1e\x85R."), end,
            "key without value");
    refused(TEXT(START), TEXT("\x80\2K\1."), TEXT("\x80\2]."), "holds no dictionary");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_file_of_pytorch_is_read),
        cmocka_unit_test(every_cut_is_refused),
        cmocka_unit_test(first_versions_are_read),
        cmocka_unit_test(lies_are_refused),
    };
    return cmocka_run_group_tests(tests, tmpdir_setup, tmpdir_teardown);
}
