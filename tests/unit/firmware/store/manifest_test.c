/* The manifest of a take, read back, as it was written and spoiled. */
#include "firmware/store/manifest.h"

#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "firmware/store/store.h"
#include "tests/unit/expect.h"
#include "tests/unit/small_take.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

/* Text of the manifest of a take that is stored.
 * own: free. */
static char *manifest_of(struct take *t)
{
    struct store_config cfg = {.path = tmpdir_path("store"), .merge = true};
    struct store *s;
    struct file_map f;
    char id[STORE_ID_CAP], name[64];
    expect_ok(store_open(&cfg, &s));
    expect_ok(store_commit(s, t, id));
    take_free(t);
    store_close(s);
    snprintf(name, sizeof name, "store/%s/manifest.json", id);
    expect_ok(file_map(tmpdir_path(name), 1 << 20, &f));
    char *text = strndup((const char *)f.p, f.n);
    file_unmap(&f);
    assert_non_null(text);
    return text;
}

/* What the device says it multiplies the pixels with. */
static void gains(void **state)
{
    (void)state;
    struct take *t = small_take(1, 2, CAMERA_GREY16);
    t->frame[1].gains_known = true;
    t->frame[1].digital_gain = 1.25;
    t->frame[1].red_gain = 2;
    t->frame[1].blue_gain = 1.5;
    char *text = manifest_of(t);
    assert_non_null(strstr(text, "\"digital_gain\": null"));
    assert_non_null(strstr(text, "\"digital_gain\": 1.25"));
    assert_non_null(strstr(text, "\"red_gain\": 2"));
    assert_non_null(strstr(text, "\"blue_gain\": 1.5"));
    free(text);
}

/* Where the device says that its lens stands. */
static void lens(void **state)
{
    (void)state;
    struct take *t = small_take(1, 3, CAMERA_GREY16);
    assert_int_equal(take_lens_moved(t), -1);
    t->frame[0].lens_known = t->frame[1].lens_known = true;
    t->frame[0].lens = 2.0;
    t->frame[1].lens = 2.0 + 0.9 * TAKE_LENS_STEP;
    assert_int_equal(take_lens_moved(t), -1);
    t->frame[1].lens = 2.0 + 1.1 * TAKE_LENS_STEP;
    assert_int_equal(take_lens_moved(t), 0);
    t->frame[1].camera = 1; // two lenses
    assert_int_equal(take_lens_moved(t), -1);
    t->frame[1].camera = 0;
    t->frame[1].lens = 2.5;
    char *text = manifest_of(t);
    struct cJSON *doc;
    expect_ok(json_parse("m", text, strlen(text), &doc));
    const struct cJSON *frame = json_first(json_member(doc, "frames"));
    static const double at[] = {2.0, 2.5};
    for (int i = 0; i < 3; i++, frame = json_next(frame)) {
        double v = NAN;
        assert_non_null(json_member(frame, "lens"));
        assert_int_equal(json_number(json_member(frame, "lens"), &v), i < 2);
        assert_true(i == 2 || v == at[i]);
    }
    json_free(doc);
    free(text);
}

/* The manifest with the first `from` replaced. own: free. */
static char *replaced(const char *text, const char *from, const char *to)
{
    const char *at = strstr(text, from);
    char *changed = malloc(strlen(text) + strlen(to) + 1);
    assert_non_null(at);
    assert_non_null(changed);
    sprintf(changed, "%.*s%s%s", (int)(at - text), text, to, at + strlen(from));
    return changed;
}

/* So changed it is refused. */
static void with(const char *text, const char *from, const char *to, const char *words)
{
    static struct manifest m;
    char *changed = replaced(text, from, to);
    expect_err(manifest_parse("m", changed, strlen(changed), &m), ERR_FORMAT, words);
    assert_true(m.n == 0 && !m.id[0]);
    free(changed);
}

static void hostile_manifests(void **state)
{
    (void)state;
    static struct manifest m;
    char *text = manifest_of(small_take(1, 1, CAMERA_GREY16));
    expect_ok(manifest_parse("m", text, strlen(text), &m));
    assert_int_equal(m.n, 4);
    assert_string_equal(m.file[0].name, "raw/00_00.bin");
    with(text, "hdrig-take", "hdrig", "not a manifest of version 1");
    with(text, "\"version\": 1", "\"version\": 2", "not a manifest of version 1");
    with(text, "\"version\": 1", "\"version\": 1, \"version\": 1", "\"version\" is there twice");
    with(text, "\"version\"", "\"more\"", "\"more\" is not known");
    with(text, "\"stagger\": false, ", "", "has no key \"stagger\"");
    with(text, "complete", "finished", "status is neither");
    with(text, "\"counter\": 1", "\"counter\": -1", "counter is malformed");
    with(text, "\"counter\": 1", "\"counter\": 1.5", "counter is malformed");
    with(text, "\"counter\": 1", "\"counter\": 1e17", "counter is malformed");
    with(text, "\"boot_id\": \"", "\"boot_id\": \"g", "counter is malformed");
    with(text, "\"boot_id\": \"", "\"boot_id\": \"0123456789", "counter is malformed");
    with(text, "\"raw/00_00.bin\", \"bytes\"", "\"raw/../x\", \"bytes\"", "slashes");
    with(text, "\"raw/00_00.bin\", \"bytes\"", "\"raw/..\", \"bytes\"", "is a folder");
    with(text, "\"raw/00_00.bin\", \"bytes\"", "\"/etc/passwd\", \"bytes\"", "slashes");
    with(text, "\"raw/00_00.bin\", \"bytes\"", "\"\", \"bytes\"", "a name of 0 bytes");
    with(text, "\"raw/00_00.bin\", \"bytes\"", "\"raw/\", \"bytes\"", "a name of 0 bytes");
    with(text, "\"raw/00_00.bin\", \"bytes\"", "\"raw/.x\", \"bytes\"", "lists a file \"raw/.x\"");
    with(text, "\"raw/00_00.bin\", \"bytes\"", "\"thumbs/../x\", \"bytes\"", "slashes");
    with(text, "\"raw/00_00.bin\", \"bytes\"", "\"manifest.json\", \"bytes\"", "lists a file");
    with(text, "\"raw/00_00.bin\", \"bytes\"", "\"exposure.json\", \"bytes\"", "listed twice");
    with(text, "\"bytes\": 1024", "\"bytes\": \"1024\"", "a size and a SHA-256");
    with(text, "\"sha256\": \"", "\"sha256\": \"0", "SHA-256 of 64 digits");
    with(text, "\"sha256\": \"", "\"sha256\": \"\", \"x\": \"", "\"x\" is not known");
    with(text, "\"files\": [", "\"files\": [1, ", "is not an object");
    with(text, "\"files\": [", "\"files\": [[], ", "is not an object");
    with(text, "{", "[{", "not JSON");
    expect_err(manifest_parse("m", "[]", 2, &m), ERR_FORMAT, "not an object");
    char many[32 * 1024] = "\"files\": [";
    for (int i = 0; i <= MANIFEST_FILES_MAX; i++)
        strcat(many, "{}, ");
    with(text, "\"files\": [", many, "not a list of at most 4737");
    for (size_t n = 0; n + 2 < strlen(text); n++) // cut short anywhere
        if (manifest_parse("m", text, n, &m) != ERR_FORMAT)
            fail_msg("%zu of %zu bytes are a manifest", n, strlen(text));
    free(text);
}

/* Of a board's part, and of a joint take. */
static void rigs(void **state)
{
    (void)state;
    static struct manifest m;
    char take[MANIFEST_ID_CAP], member[TAKE_MEMBER_CAP];
    char *text = manifest_of(small_take(1, 1, CAMERA_GREY16));
    assert_null(strstr(text, "\"rig\""));
    assert_null(strstr(text, "common_ns"));
    assert_false(manifest_part(text, strlen(text), take, member));
    free(text);
    struct take *t = small_take(1, 1, CAMERA_GREY16);
    t->rig = (struct take_rig){"0123abcd-000042", "left-arm", "kernel"};
    t->frame[0].common_ns = 1767323045000000001;
    t->frame[0].within_ns = 250000;
    text = manifest_of(t);
    const size_t n = strlen(text);
    expect_ok(manifest_parse("m", text, n, &m));
    assert_true(m.complete && m.members == 0);
    assert_string_equal(m.rig_take, "0123abcd-000042");
    assert_string_equal(m.rig_member, "left-arm");
    assert_non_null(strstr(text, "\"common_ns\": \"1767323045000000001\""));
    assert_non_null(strstr(text, "\"within_ns\": \"250000\""));
    assert_true(manifest_part(text, MANIFEST_HEAD, take, member));
    assert_string_equal(take, "0123abcd-000042");
    assert_string_equal(member, "left-arm");
    for (size_t k = 0; k < 200; k++) // cut short anywhere
        assert_false(manifest_part(text, k, take, member) && strcmp(member, "left-arm") != 0);
    static const char rig[] =
        "{\"take\": \"0123abcd-000042\", \"member\": \"left-arm\", \"clock\": \"kernel\"}";
    with(text, rig, "[]", "rig is not an object");
    with(text, rig, "{}", "has no key \"take\"");
    with(text, "\"left-arm\"", "\"Left\"", "rig needs the id of a take, a member's name");
    with(text, "\"left-arm\"", "\"\"", "rig needs the id of a take, a member's name");
    with(text, "\"left-arm\"", "\"0123456789012345678901234567890x\"", "a member's name");
    with(text, "\"0123abcd-000042\"", "\"../x\"", "rig needs the id of a take");
    with(text, rig, "{\"take\": \"0123abcd-000042\", \"members\": [], \"missing\": []}",
         "it is another take than its rig says");
    const char *id = strstr(text, "\"id\": \"") + 6;
    char joint[512];
    static const char *const lists[][2] = {
        {"[], \"missing\": []", "lists of 1 to 128 members"},
        {"[{}], \"missing\": []", "has no key \"name\""},
        {"[7], \"missing\": []", "is not an object"},
        {"7, \"missing\": []", "lists of 1 to 128 members"},
        {"[{\"name\": \"\", \"part\": 0, \"boot_id\": 0, \"cameras\": 0, \"clock\": 0, "
         "\"within_ns\": 0}], \"missing\": []",
         "a member of the rig has no name"},
        {"[{\"name\": \"b\", \"part\": 0, \"boot_id\": 0, \"cameras\": 0, \"clock\": 0, "
         "\"within_ns\": 0}], \"missing\": [\"-\"]",
         "a missing member of the rig has no name"}};
    for (size_t i = 0; i < sizeof lists / sizeof lists[0]; i++) {
        snprintf(joint, sizeof joint, "{\"take\": %.*s, \"members\": %s}", (int)strcspn(id, ","),
                 id, lists[i][0]);
        with(text, rig, joint, lists[i][1]);
    }
    free(text);
}

static void picture_names(void **state)
{
    static const char *const bad[] = {
        "train_00_00",    "train_1_.png",     "train_128_00.png", "train_-1_00.png",
        "train_00_9.png", "train_00_000.png", "test_00_00.png",   ""};
    (void)state;
    for (int camera = 0; camera < 128; camera += 9)
        for (int index = 0; index < 9; index++) {
            char name[MANIFEST_NAME_CAP];
            int back[2];
            snprintf(name, sizeof name, "train_%02d_%02d.png", camera, index);
            assert_true(manifest_picture_is(name, &back[0], &back[1]));
            assert_true(back[0] == camera && back[1] == index);
        }
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        int camera, index;
        if (manifest_picture_is(bad[i], &camera, &index))
            fail_msg("%s is a picture's name", bad[i]);
    }
}

/* JSON of a joint take's rig. own: free. */
static char *rig_of(const char *id, int members, int missing)
{
    char *text;
    size_t n;
    FILE *f = open_memstream(&text, &n);
    assert_non_null(f);
    fprintf(f, "{\"take\": \"%s\", \"members\": [", id);
    for (int i = 0; i < members; i++)
        fprintf(f,
                "%s{\"name\": \"b%d\", \"part\": \"p\", \"boot_id\": \"b\", \"cameras\": 1, "
                "\"clock\": \"kernel\", \"within_ns\": \"1\"}",
                i ? ", " : "", i);
    fputs("], \"missing\": [", f);
    for (int i = 0; i < missing; i++)
        fprintf(f, "%s\"gone-%d\"", i ? ", " : "", i);
    fputs("]}", f);
    assert_int_equal(fclose(f), 0);
    return text;
}

static void large_rigs(void **state)
{
    static const int sizes[][2] = {{100, 0}, {128, 0}, {1, 128}, {129, 0}, {1, 129}};
    static struct manifest m;
    (void)state;
    struct take *t = small_take(1, 1, CAMERA_GREY16);
    t->rig = (struct take_rig){"0123abcd-000042", "left-arm", "kernel"};
    char *text = manifest_of(t), id[MANIFEST_ID_CAP];
    expect_ok(manifest_parse("m", text, strlen(text), &m));
    memcpy(id, m.id, sizeof id);
    for (int i = 0; i < 5; i++) {
        static const char part[] =
            "{\"take\": \"0123abcd-000042\", \"member\": \"left-arm\", \"clock\": \"kernel\"}";
        char *rig = rig_of(id, sizes[i][0], sizes[i][1]);
        char *joint = replaced(text, part, rig);
        if (i < 3) {
            expect_ok(manifest_parse("m", joint, strlen(joint), &m));
            assert_int_equal(m.members, sizes[i][0]);
        } else {
            with(text, part, rig, "its rig needs lists of 1 to 128 members and missing ones");
        }
        free(joint);
        free(rig);
    }
    free(text);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(picture_names),
        cmocka_unit_test_setup_teardown(large_rigs, tmpdir_setup, tmpdir_teardown),
        cmocka_unit_test_setup_teardown(rigs, tmpdir_setup, tmpdir_teardown),
        cmocka_unit_test_setup_teardown(gains, tmpdir_setup, tmpdir_teardown),
        cmocka_unit_test_setup_teardown(lens, tmpdir_setup, tmpdir_teardown),
        cmocka_unit_test_setup_teardown(hostile_manifests, tmpdir_setup, tmpdir_teardown)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
