/* A real checkpoint of PyTorch (tests/data/ckpt/make.py) against the numbers it was made of, and
 * archives of every kind that PyTorch does not write. */
#include "drivers/format/checkpoint.h"

#include "core/base/bytes.h"
#include "core/base/half.h"
#include "core/net/hashed.h"
#include "drivers/format/file.h"
#include "drivers/format/netdims_infer.h"
#include "drivers/format/safetensors.h"

#include "tests/unit/core/net/tiny_net.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <unistd.h>
#include <zip.h>

#include <cmocka.h>

#define TINY "tests/data/ckpt/tiny.ckpt"

/* ---- the real one ---- */

static float to_bf16(float v)
{
    uint32_t u;
    memcpy(&u, &v, sizeof u);
    u = (u + 0x7fff + (u >> 16 & 1)) & 0xffff0000;
    memcpy(&v, &u, sizeof v);
    return v;
}

/* What make.py made of the hashed values of a tensor: see its function awkward. */
static void expect(const struct tensor_spec *t, float *v)
{
    const char *mean = "encoder.hdr_head.regression.mean_out.";
    size_t n = table_count(t);
    hashed_fill(t, 1, 0, n, v);
    for (size_t i = 0; i < n; i++) {
        if (strstr(t->name, ".aggregator."))
            v[i] = to_bf16(v[i]);
        if (strncmp(t->name, mean, strlen(mean)) == 0 && strstr(t->name, "t.0.weight"))
            v[i] = half_to_float(half_from_float(v[i]));
        if (strncmp(t->name, mean, strlen(mean)) == 0 &&
            (strstr(t->name, "t.1.bias") || strstr(t->name, "t.3.bias")))
            v[i] = 0.25f;
    }
}

static err_t compare(void *ctx, const struct tensor_spec *t)
{
    static float want[100000], got[100000];
    const struct checkpoint *c = ctx;
    const struct checkpoint_tensor *have = checkpoint_find(c, t->name);
    size_t n = table_count(t);
    assert_non_null(have);
    assert_int_equal(checkpoint_count(have), n);
    if (!t->used)
        return OK;
    expect(t, want);
    memset(got, 0x55, sizeof got);
    assert_int_equal(checkpoint_read(c, have, got), OK);
    for (size_t i = 0; i < n; i++)
        if (got[i] != want[i])
            fail_msg("%s: element %zu is %g, not %g", t->name, i, (double)got[i], (double)want[i]);
    assert_true(memcmp(&got[n], "\x55\x55\x55\x55", 4) == 0);
    return OK;
}

static void a_checkpoint_of_pytorch_is_read(void **state)
{
    (void)state;
    struct checkpoint c;
    float v[64];
    assert_int_equal(checkpoint_open(TINY, "encoder.", &c), OK);
    assert_int_equal(table_walk(&tiny_net, compare, &c), OK);
    const struct checkpoint_tensor *spare = checkpoint_find(&c, "encoder.other.spare"),
                                   *fc1 = checkpoint_find(
                                       &c, "encoder.camera_head.pose_branch.fc1.weight"),
                                   *count = checkpoint_find(&c, "encoder.losses.count");
    assert_true(spare->storage == fc1->storage && spare->offset == checkpoint_count(fc1));
    assert_int_equal(count->type, CHECKPOINT_OTHER);
    assert_int_equal(checkpoint_read(&c, count, v), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "encoder.losses.count is LongStorage; float32"));
    assert_null(checkpoint_find(&c, "encoder.optimizer"));
    assert_null(checkpoint_find(&c, ""));
    checkpoint_close(&c);
    assert_int_equal(checkpoint_open("tests/data/ckpt/none.ckpt", "encoder.", &c), ERR_IO);
    assert_int_equal(checkpoint_open("tests/data/ckpt", "encoder.", &c), ERR_FORMAT);
    assert_int_equal(mkfifo(tmpdir_path("fifo"), 0600), 0);
    assert_int_equal(checkpoint_open(tmpdir_path("fifo"), "encoder.", &c), ERR_FORMAT);
}

static void every_cut_is_refused(void **state)
{
    (void)state;
    struct file_map m;
    struct checkpoint c;
    assert_int_equal(file_map(TINY, 1 << 24, &m), OK);
    for (size_t n = 0; n < m.n; n += n < 200 ? 1 : 40009) {
        const char *path = tmpdir_write("cut", m.p, n);
        assert_true(checkpoint_open(path, "encoder.", &c) == ERR_FORMAT);
        assert_true(c.tensors == NULL && c.parts == NULL);
    }
    file_unmap(&m);
}

static void damage_of_a_storage_is_found(void **state)
{
    (void)state;
    struct file_map m;
    struct checkpoint c;
    static float v[100000];
    assert_int_equal(file_map(TINY, 1 << 24, &m), OK);
    uint8_t *copy = malloc(m.n);
    memcpy(copy, m.p, m.n);
    struct tensor_spec t = {.name = "encoder.generate_tonemapper.enc.0.weight",
                            .rank = 4,
                            .shape = {4, 96, 14, 14},
                            .role = ROLE_CONV};
    hashed_fill(&t, 1, 0, 1000, v);
    uint8_t *at = memmem(copy, m.n, v, sizeof *v * 1000);
    assert_non_null(at);
    at[100] ^= 1;
    assert_int_equal(checkpoint_open(tmpdir_write("damaged", copy, m.n), "encoder.", &c), OK);
    assert_int_equal(checkpoint_read(&c, checkpoint_find(&c, t.name), v), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "CRC"));
    checkpoint_close(&c);
    free(copy);
    file_unmap(&m);
}

/* ---- made archives ---- */

static struct {
    const char *pickle;
    size_t n_pickle;
    const char *folder, *order, *second;
    int method;
    size_t storage; // bytes
    bool no_pickle, deflate_pickle;
} made;

static void add(zip_t *z, const char *name, const void *p, size_t n, int method)
{
    char path[300];
    snprintf(path, sizeof path, "%s/%s", made.folder, name);
    zip_source_t *source = zip_source_buffer(z, p, n, 0);
    zip_int64_t i = zip_file_add(z, path, source, ZIP_FL_OVERWRITE);
    assert_true(i >= 0);
    assert_int_equal(zip_set_file_compression(z, (zip_uint64_t)i, method, 0), 0);
}

static const char *write_zip(void)
{
    static const float values[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
    const char *path = tmpdir_path("made.ckpt");
    int code;
    unlink(path);
    zip_t *z = zip_open(path, ZIP_CREATE, &code);
    assert_non_null(z);
    if (!made.no_pickle)
        add(z, "data.pkl", made.pickle, made.n_pickle,
            made.deflate_pickle ? ZIP_CM_DEFLATE : ZIP_CM_STORE);
    else
        add(z, "data.txt", "x", 1, ZIP_CM_STORE);
    add(z, "data/0", values, made.storage, made.method);
    if (made.order)
        add(z, "byteorder", made.order, strlen(made.order), ZIP_CM_STORE);
    if (made.second) {
        made.folder = made.second;
        add(z, "data.pkl", made.pickle, made.n_pickle, ZIP_CM_STORE);
    }
    assert_int_equal(zip_close(z), 0);
    return path;
}

/* A tensor of a dictionary: its key, its storage, then counts. Octal, as digits follow. */
#define STORAGE(class, name, count) "U\007storagectorch\n" class "\nU" name "U\003cpu" count
#define TENSOR(key, storage, offset, shape, strides)                                               \
    "U\001" key "ctorch._utils\n_rebuild_tensor_v2\n((" storage "tQ" offset "(" shape "t(" strides \
    "t\x89}tR"
#define FLOATS STORAGE("FloatStorage", "\0010", "K\020")
#define DICT(members) "\x80\x02}(" members "u."
#define GOOD TENSOR("w", FLOATS, "K\004", "K\003K\002", "K\001K\003")

static err_t open_made(const char *pickle, size_t n, struct checkpoint *c)
{
    made.pickle = pickle;
    made.n_pickle = n;
    if (!made.folder)
        made.folder = "archive";
    if (!made.storage)
        made.storage = 64;
    err_t e = checkpoint_open(write_zip(), "encoder.", c);
    memset(&made, 0, sizeof made);
    return e;
}

#define OPEN(text, c) open_made(text, sizeof text - 1, c)

static void views_are_followed(void **state)
{
    (void)state;
    struct checkpoint c;
    float v[8];
    assert_int_equal(OPEN(DICT(GOOD), &c), OK);
    const struct checkpoint_tensor *t = checkpoint_find(&c, "encoder.w");
    assert_int_equal(checkpoint_read(&c, t, v), OK);
    const float want[6] = {4, 7, 5, 8, 6, 9};
    assert_memory_equal(v, want, sizeof want);
    checkpoint_close(&c);
    /* a number, and nothing at all */
    assert_int_equal(OPEN(DICT(TENSOR("w", FLOATS, "K\017", "", "")), &c), OK);
    assert_int_equal(checkpoint_read(&c, checkpoint_find(&c, "encoder.w"), v), OK);
    assert_true(v[0] == 15);
    checkpoint_close(&c);
    assert_int_equal(OPEN(DICT(TENSOR("w", FLOATS, "K\020", "K\000K\005", "K\005K\001")), &c), OK);
    assert_int_equal(checkpoint_read(&c, checkpoint_find(&c, "encoder.w"), v), OK);
    checkpoint_close(&c);
}

static void the_right_dictionary_counts(void **state)
{
    (void)state;
    struct checkpoint c;
#define HALVES STORAGE("HalfStorage", "\0010", "K\040")
    assert_int_equal(OPEN("\x80\x02}(" GOOD
                          "U\012state_dict}(U\017model.encoder.xK\001U\007model.yN" TENSOR(
                              "z", HALVES, "K\000", "K\002", "K\001") "uu.",
                          &c),
                     OK);
    assert_int_equal(c.n, 1);
    assert_string_equal(c.tensors[0].name, "encoder.z");
    assert_int_equal(c.tensors[0].type, CHECKPOINT_F16);
    checkpoint_close(&c);
    assert_int_equal(OPEN("\x80\x02}q\0(U\005modelh\0u.", &c), OK); // itself
    assert_int_equal(c.n, 0);
    checkpoint_close(&c);
    assert_int_equal(OPEN("\x80\x02}.", &c), OK);
    assert_int_equal(c.n, 0);
    assert_null(checkpoint_find(&c, "encoder.w"));
    checkpoint_close(&c);
}

static void refused(const char *pickle, size_t n, err_t code, const char *sentence)
{
    struct checkpoint c;
    err_t e = open_made(pickle, n, &c);
    if (e != code || !strstr(err_text(), sentence))
        fail_msg("%d, not %d (%s): %s", e, code, sentence, err_text());
    assert_true(c.parts == NULL && c.tensors == NULL);
}

#define REFUSED(text, sentence) refused(text, sizeof text - 1, ERR_FORMAT, sentence)
#define VIEW(offset, shape, strides) DICT(TENSOR("w", FLOATS, offset, shape, strides))
#define STORED(name, count) DICT(TENSOR("w", STORAGE("FloatStorage", name, count), "K\000", "", ""))

static void hostile_views_are_refused(void **state)
{
    (void)state;
    REFUSED(VIEW("K\020", "K\001", "K\001"), "beyond its storage");
    REFUSED(VIEW("K\021", "K\000", "K\001"), "beyond its storage");
    REFUSED(VIEW("K\000", "K\002K\011", "K\010K\001"), "beyond its storage");
    REFUSED(VIEW("K\000", "K\021", "K\001"), "beyond its storage");
    REFUSED(VIEW("K\000", "K\002", "\x8a\010\xff\xff\xff\xff\xff\xff\xff\177"), "beyond");
    REFUSED(VIEW("K\000", "\x8a\006\0\0\0\0\0\001\x8a\006\0\0\0\0\0\001", "K\000K\000"), "beyond");
    REFUSED(VIEW("J\xff\xff\xff\xff", "K\001", "K\001"), "no offset, shape");
    REFUSED(VIEW("K\000", "J\xff\xff\xff\xff", "K\001"), "no offset, shape");
    REFUSED(VIEW("K\000", "K\001", "J\xff\xff\xff\xff"), "no offset, shape");
    REFUSED(VIEW("K\000", "K\001", "K\001K\001"), "no offset, shape");
    REFUSED(VIEW("N", "K\001", "K\001"), "no offset, shape");
    REFUSED(VIEW("K\000", "K\1K\1K\1K\1K\1K\1K\1K\1K\1", "K\1K\1K\1K\1K\1K\1K\1K\1K\1"),
            "no offset, shape");
}

static void hostile_dictionaries_are_refused(void **state)
{
    (void)state;
    REFUSED("\x80\x02K\001.", "holds no dictionary");
    REFUSED(DICT(GOOD GOOD), "encoder.w is there twice");
    REFUSED(STORED("\0010", "K\021"), "storage of 17 elements in 64 bytes");
    REFUSED(STORED("\0010", "N"), "has no storage");
    REFUSED(STORED("\0017", "K\020"), "the archive has no archive/data/7");
    REFUSED(STORED("\020../../etc/passwd", "K\020"),
            "the archive has no archive/data/../../etc/passwd");
    REFUSED(DICT("U\001wctorch._utils\n_rebuild_tensor_v2\n)R"), "has no storage");
    REFUSED(DICT("U\001wctorch._utils\n_rebuild_tensor_v2\n(K\001K\002tR"), "has no storage");
    REFUSED(DICT("U\001\007ctorch._utils\n_rebuild_tensor_v2\n)R"), "character 0x07");
    REFUSED("\x80\x02}(Nu.", "key without value");
}

static void hostile_archives_are_refused(void **state)
{
    (void)state;
    struct checkpoint c;
    made.method = ZIP_CM_DEFLATE;
    REFUSED(DICT(GOOD), "archive/data/0 is compressed or encrypted");
    made.deflate_pickle = true;
    REFUSED(DICT(GOOD) "                                        ", "data.pkl is compressed");
    made.no_pickle = true;
    REFUSED(DICT(GOOD), "with 0 <folder>/data.pkl");
    made.second = "archive2";
    REFUSED(DICT(GOOD), "with 2 <folder>/data.pkl");
    made.folder = "a/b";
    REFUSED(DICT(GOOD), "with 0 <folder>/data.pkl");
    made.order = "big";
    REFUSED(DICT(GOOD), "byte order \"big\"");
    made.order = "little endian";
    REFUSED(DICT(GOOD), "byte order \"\"");
    made.order = "little";
    made.folder = "..";
    assert_int_equal(OPEN(DICT(GOOD), &c), OK); // a name is only a name
    checkpoint_close(&c);
    assert_int_equal(checkpoint_open(tmpdir_text("text", "no weights at all"), "encoder.", &c),
                     ERR_FORMAT);
    assert_int_equal(checkpoint_open(tmpdir_text("empty", ""), "encoder.", &c), ERR_FORMAT);
}

/* Sizes and places in the archive's directory that are not so. */
static void lies_of_the_directory_are_refused(void **state)
{
    (void)state;
    enum { PLACE = 42 };
    static const struct {
        size_t at, n; // in the entry of data/0
    } fields[] = {{20, 4}, {24, 4}, {PLACE, 4}, {10, 2}, {8, 2}, {28, 2}};
    struct file_map m;
    int refused_at_once = 0;
    struct checkpoint c;
    float v[16];
    assert_int_equal(OPEN(DICT(GOOD), &c), OK);
    checkpoint_close(&c);
    assert_int_equal(file_map(tmpdir_path("made.ckpt"), 1 << 20, &m), OK);
    uint8_t *copy = malloc(m.n);
    for (size_t k = 0; k < 6 * 4; k++) {
        static const uint8_t lies[4] = {0xff, 0x7f, 0x01, 0x00};
        memcpy(copy, m.p, m.n);
        uint8_t *entry = copy;
        for (uint8_t *at = copy; (at = memmem(at, m.n - (size_t)(at - copy), "PK\1\2", 4)); at++)
            if (memcmp(at + 46, "archive/data/0", 14) == 0)
                entry = at;
        assert_true(entry > copy);
        memset(entry + fields[k / 4].at, lies[k % 4], fields[k / 4].n);
        err_t e = checkpoint_open(tmpdir_write("lies.ckpt", copy, m.n), "encoder.", &c);
        refused_at_once += e != OK;
        e = e ? e : checkpoint_read(&c, checkpoint_find(&c, "encoder.w"), v);
        if (e == OK && fields[k / 4].at != PLACE) // another place holds other bytes
            assert_true(v[0] == 4 && v[5] == 9);
        checkpoint_close(&c);
    }
    assert_true(refused_at_once >= 12);
    free(copy);
    file_unmap(&m);
}

/* ---- safetensors ---- */

static const char *write_safetensors(const struct safetensors_tensor *t, int n, size_t data)
{
    struct safetensors_writer w;
    const char *path = tmpdir_path("a.safetensors");
    FILE *f = fopen(path, "wb");
    safetensors_begin(&w);
    for (int i = 0; i < n; i++)
        safetensors_put(&w, &t[i]);
    assert_int_equal(safetensors_end(&w, f), OK);
    for (size_t i = 0; i < data; i++)
        putc((int)(i & 1 ? 0x3c : i & 0xff), f); // halves from 1 on
    assert_int_equal(fclose(f), 0);
    return path;
}

static void safetensors_are_read(void **state)
{
    (void)state;
    const struct safetensors_tensor t[] = {
        {.name = "model.encoder.half", .type = "F16", .rank = 2, .shape = {2, 3}},
        {.name = "aggregator.brain", .type = "BF16", .rank = 1, .shape = {2}},
        {.name = "double", .type = "F64", .rank = 0},
        {.name = "none", .type = "F32", .rank = 2, .shape = {3, 0}},
    };
    struct checkpoint c;
    float v[8];
    assert_int_equal(checkpoint_open(write_safetensors(t, 4, 24), "encoder.", &c), OK);
    assert_int_equal(c.n, 4);
    assert_int_equal(checkpoint_read(&c, checkpoint_find(&c, "encoder.half"), v), OK);
    for (int i = 0; i < 6; i++)
        assert_true(v[i] == 1 + (float)(2 * i) / 1024);
    assert_int_equal(checkpoint_read(&c, checkpoint_find(&c, "encoder.aggregator.brain"), v), OK);
    const uint32_t bits[2] = {0x3c0c0000, 0x3c0e0000};
    assert_memory_equal(v, bits, sizeof bits);
    assert_int_equal(checkpoint_read(&c, checkpoint_find(&c, "encoder.double"), v), ERR_FORMAT);
    assert_int_equal(checkpoint_read(&c, checkpoint_find(&c, "encoder.none"), v), OK);
    checkpoint_close(&c);
    assert_int_equal(checkpoint_open(write_safetensors(t, 4, 23), "encoder.", &c), ERR_FORMAT);
    const struct safetensors_tensor same[] = {
        {.name = "model.x", .type = "F32", .rank = 1, .shape = {1}},
        {.name = "encoder.x", .type = "F32", .rank = 1, .shape = {1}},
    };
    assert_int_equal(checkpoint_open(write_safetensors(same, 2, 8), "encoder.", &c), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "encoder.x is there twice"));
}

/* ---- what PyTorch saves ---- */

/* make.py's function kinds: the wrappers' names are gone, values are as PyTorch reads them, and
 * what is not read says what it is. */
static void kinds_of_tensors(void **state)
{
    static const char *const plain[] = {"aggregator.plain",  "aggregator.parameter",
                                        "aggregator.buffer", "aggregator.tagged",
                                        "negative",          "half_negative"};
    static const char *const others[][2] = {{"conjugate", "ComplexFloatStorage"},
                                            {"quantised", "_rebuild_qtensor"},
                                            {"sparse", "_rebuild_sparse_tensor"},
                                            {"byte", "_rebuild_tensor_v3"},
                                            {"subclass", "Own"},
                                            {"nowhere", "_rebuild_meta_tensor_no_storage"},
                                            {"long", "LongStorage"}};
    struct checkpoint c;
    char name[64];
    (void)state;
    assert_int_equal(checkpoint_open("tests/data/ckpt/kinds.pt", "encoder.", &c), OK);
    assert_int_equal(c.n, 13);
    for (int i = 0; i < 6; i++) {
        float v[3];
        snprintf(name, sizeof name, "encoder.%s", plain[i]);
        const struct checkpoint_tensor *t = checkpoint_find(&c, name);
        if (!t)
            fail_msg("no %s", name);
        assert_true(t->rank == 1 && t->shape[0] == 3);
        assert_int_equal(checkpoint_read(&c, t, v), OK);
        if (v[0] != 1 || v[1] != 2 || v[2] != -3)
            fail_msg("%s: %g %g %g", name, (double)v[0], (double)v[1], (double)v[2]);
    }
    for (int i = 0; i < 7; i++) {
        float v[4];
        snprintf(name, sizeof name, "encoder.%s", others[i][0]);
        const struct checkpoint_tensor *t = checkpoint_find(&c, name);
        assert_non_null(t);
        assert_int_equal(t->type, CHECKPOINT_OTHER);
        assert_string_equal(t->kind, others[i][1]);
        assert_int_equal(checkpoint_read(&c, t, v), ERR_FORMAT);
        snprintf(name, sizeof name, " is %s; float32, bfloat16", others[i][1]);
        assert_non_null(strstr(err_text(), name));
    }
    checkpoint_close(&c);
    assert_int_equal(checkpoint_open("tests/data/ckpt/object.pt", "encoder.", &c), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "\"model\" holds an object of Python"));
}

/* A mark that nobody knows yet. */
static void marks_are_not_passed_over(void **state)
{
    struct checkpoint c;
    (void)state;
#define MARKED(mark)                                                                               \
    DICT("U\001wctorch._utils\n_rebuild_tensor_v2\n((" FLOATS "tQK\000(t(t\x89}}" mark "stR")
    assert_int_equal(OPEN(MARKED("U\003neg\x88"), &c), OK);
    assert_true(c.tensors[0].negative && c.tensors[0].type == CHECKPOINT_F32);
    checkpoint_close(&c);
    assert_int_equal(OPEN(MARKED("U\003neg\x89"), &c), OK);
    assert_true(!c.tensors[0].negative && c.tensors[0].type == CHECKPOINT_F32);
    checkpoint_close(&c);
    assert_int_equal(OPEN(MARKED("U\003new\x88"), &c), OK);
    assert_int_equal(c.tensors[0].type, CHECKPOINT_OTHER);
    assert_string_equal(c.tensors[0].kind, "new");
    checkpoint_close(&c);
}

/* ---- several files ---- */

/* w of an archive (4, 5, .. at its end) and two of a .safetensors file. */
static void write_shards(void)
{
    const struct safetensors_tensor t[] = {
        {.name = "model.b", .type = "F16", .rank = 1, .shape = {2}},
        {.name = "model.c", .type = "F16", .rank = 1, .shape = {2}},
    };
    struct checkpoint c;
    const char *path = write_safetensors(t, 2, 8);
    char to[FILE_PATH_CAP];
    snprintf(to, sizeof to, "%s", tmpdir_path("2.safetensors"));
    assert_int_equal(rename(path, to), 0);
    assert_int_equal(OPEN(DICT(GOOD), &c), OK);
    checkpoint_close(&c);
    snprintf(to, sizeof to, "%s", tmpdir_path("1.bin"));
    assert_int_equal(rename(tmpdir_path("made.ckpt"), to), 0);
}

static err_t open_map(const char *map, struct checkpoint *c)
{
    char text[512];
    snprintf(text, sizeof text, "{\"metadata\": {\"total_size\": 1}, \"weight_map\": %s}\n", map);
    return checkpoint_open(tmpdir_text("model.safetensors.index.json", text), "encoder.", c);
}

static void map_refused(const char *map, err_t code, const char *sentence)
{
    struct checkpoint c;
    err_t e = open_map(map, &c);
    if (e != code || !strstr(err_text(), sentence))
        fail_msg("%d, not %d (%s): %s", e, code, sentence, err_text());
    assert_true(c.parts == NULL && c.tensors == NULL);
}

static void an_index_joins_files(void **state)
{
    struct checkpoint c;
    float v[6];
    (void)state;
    write_shards();
    assert_int_equal(open_map("{\"module.model.b\": \"2.safetensors\", \"w\": \"1.bin\"}", &c), OK);
    assert_int_equal(c.n_parts, 2);
    assert_int_equal(c.n, 3); // c, too
    assert_non_null(strstr(c.parts[0].path, "/1.bin"));
    assert_int_equal(checkpoint_read(&c, checkpoint_find(&c, "encoder.w"), v), OK);
    assert_true(v[0] == 4 && v[1] == 7);
    assert_int_equal(checkpoint_read(&c, checkpoint_find(&c, "encoder.c"), v), OK);
    assert_true(v[0] == 1 + 4.0f / 1024 && v[1] == 1 + 6.0f / 1024);
    checkpoint_close(&c);
    map_refused("[]", ERR_FORMAT, "no object \"weight_map\"");
    map_refused("{}", ERR_FORMAT, "no object \"weight_map\"");
    map_refused("{\"w\": 1}", ERR_FORMAT, "\"w\" of \"weight_map\" names no file");
    map_refused("{\"w\": \"../1.bin\"}", ERR_FORMAT, "slashes");
    map_refused("{\"w\": \"/etc/passwd\"}", ERR_FORMAT, "slashes");
    map_refused("{\"w\": \"3.bin\"}", ERR_IO, "/3.bin: No such file");
    map_refused("{\"w\": \"2.safetensors\"}", ERR_FORMAT, "tensor encoder.w is not in ");
    map_refused("{\"w\": \"2.safetensors\", \"b\": \"1.bin\"}", ERR_FORMAT, " is not in ");
    map_refused("{\"w\": \"model.safetensors.index.json\"}", ERR_FORMAT,
                "neither a PyTorch file nor safetensors");
    assert_int_equal(checkpoint_open(tmpdir_text("bare.json", "{\"w\": 1}       "), "encoder.", &c),
                     ERR_FORMAT);
    assert_non_null(strstr(err_text(), "no index of weights"));
    assert_int_equal(checkpoint_open(tmpdir_text("cut.json", "{\"weight_map\": "), "encoder.", &c),
                     ERR_FORMAT);
}

static void files_of_an_index_are_bounded(void **state)
{
    static char map[32 * 300];
    struct checkpoint c;
    size_t n = 0;
    (void)state;
    for (int i = 0; i < CHECKPOINT_PARTS_MAX + 1; i++)
        n += (size_t)snprintf(map + n, sizeof map - n, "%s\"t%d\": \"f%d\"",
                              i ? ", " : "{\"weight_map\": {", i, i);
    snprintf(map + n, sizeof map - n, "}}");
    assert_int_equal(checkpoint_open(tmpdir_text("many.json", map), "encoder.", &c), ERR_LIMIT);
    assert_non_null(strstr(err_text(), "more than 256 files"));
}

/* ---- dimensions ---- */

struct listing {
    struct checkpoint c;
    const char *without;
};

static err_t list(void *ctx, const struct tensor_spec *t)
{
    struct listing *l = ctx;
    struct checkpoint_tensor *to = &l->c.tensors[l->c.n];
    if (l->without && strncmp(t->name, l->without, strlen(l->without)) == 0)
        return OK;
    *to = (struct checkpoint_tensor){.rank = t->rank};
    snprintf(to->name, sizeof to->name, "%s", t->name);
    for (int k = 0; k < t->rank; k++)
        to->shape[k] = (size_t)t->shape[k];
    l->c.n++;
    return OK;
}

static int by_name(const void *a, const void *b)
{
    return strcmp(((const struct checkpoint_tensor *)a)->name,
                  ((const struct checkpoint_tensor *)b)->name);
}

/* Dimensions inferred from the names and shapes of a network, some left out. */
static err_t infer(const struct net_dims *d, const char *without, struct net_dims *out)
{
    struct listing l = {.without = without, .c = {.what = "f"}};
    l.c.tensors = calloc(1600, sizeof *l.c.tensors);
    assert_int_equal(table_walk(d, list, &l), OK);
    qsort(l.c.tensors, (size_t)l.c.n, sizeof *l.c.tensors, by_name);
    err_t e = netdims_infer_run(&l.c, out);
    checkpoint_close(&l.c);
    return e;
}

static void dimensions_follow_from_shapes(void **state)
{
    (void)state;
    struct net_dims d, splat = table_full, vggt = table_full, complete = table_full;
    assert_int_equal(infer(&table_full, NULL, &d), OK);
    assert_memory_equal(&d, &table_full, sizeof d);
    splat.appearance = false;
    assert_int_equal(infer(&splat, NULL, &d), OK);
    assert_memory_equal(&d, &splat, sizeof d);
    vggt.appearance = vggt.gauss = false;
    vggt.gs_feat = vggt.hdr = 0;
    memset(vggt.gs_oc, 0, sizeof vggt.gs_oc);
    vggt.size = 518;
    assert_int_equal(infer(&vggt, NULL, &d), OK);
    assert_memory_equal(&d, &vggt, sizeof d);
    complete.complete = true;
    assert_int_equal(infer(&complete, NULL, &d), OK);
    assert_memory_equal(&d, &complete, sizeof d);
    assert_int_equal(infer(&table_mini, NULL, &d), ERR_UNSUPPORTED);
    assert_non_null(strstr(err_text(), "6 frame blocks"));
    assert_int_equal(infer(&table_full, "encoder.aggregator.camera_token", &d), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "has no encoder.aggregator.camera_token"));
    assert_int_equal(infer(&table_full, "encoder.depth_head.projects.2", &d), ERR_FORMAT);
    assert_int_equal(infer(&table_full, "encoder.aggregator.frame_blocks.9.", &d), ERR_UNSUPPORTED);
    assert_int_equal(infer(&table_full, "encoder.camera_head.trunk.0", &d), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "f: dimension cam_depth is 0"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_checkpoint_of_pytorch_is_read),
        cmocka_unit_test(every_cut_is_refused),
        cmocka_unit_test(damage_of_a_storage_is_found),
        cmocka_unit_test(views_are_followed),
        cmocka_unit_test(the_right_dictionary_counts),
        cmocka_unit_test(hostile_views_are_refused),
        cmocka_unit_test(hostile_dictionaries_are_refused),
        cmocka_unit_test(hostile_archives_are_refused),
        cmocka_unit_test(lies_of_the_directory_are_refused),
        cmocka_unit_test(safetensors_are_read),
        cmocka_unit_test(kinds_of_tensors),
        cmocka_unit_test(marks_are_not_passed_over),
        cmocka_unit_test(an_index_joins_files),
        cmocka_unit_test(files_of_an_index_are_bounded),
        cmocka_unit_test(dimensions_follow_from_shapes),
    };
    tmpdir_make();
    int failures = cmocka_run_group_tests(tests, NULL, NULL);
    tmpdir_remove();
    return failures;
}
