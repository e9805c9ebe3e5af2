/* Parts of many boards become one take of many cameras, or nothing. */
#include "firmware/store/joint.h"

#include "drivers/format/exposures.h"
#include "drivers/format/imageset.h"
#include "drivers/format/json.h"
#include "firmware/daemon/summary.h"
#include "firmware/store/raw_take.h"
#include "tests/unit/expect.h"
#include "tests/unit/small_rig.h"
#include "tests/unit/tmpdir.h"

#include <dirent.h>
#include <errno.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <unistd.h>

#include <cmocka.h>

enum { MEMBERS = 16 };

static const char *const names[MEMBERS] = {"b0", "b1", "b2",  "b3",  "b4",  "b5",  "b6",  "b7",
                                           "b8", "b9", "b10", "b11", "b12", "b13", "b14", "b15"};
static char folder[512]; // the conductor's store
static struct store_fs fs;
static int links;

static int no_sync(int fd)
{
    (void)fd;
    return 0;
}

static int counted_link(const char *from, const char *to)
{
    links++;
    return link(from, to);
}

static int no_link(const char *from, const char *to)
{
    (void)from;
    (void)to;
    errno = EOPNOTSUPP;
    return -1;
}

static int setup(void **state)
{
    (void)state;
    tmpdir_make();
    snprintf(folder, sizeof folder, "%s", tmpdir_path("store"));
    fs = store_fs_system;
    fs.sync = no_sync;
    fs.link = counted_link;
    links = 0;
    return 0;
}

static struct store *open_in(const char *path, int keep)
{
    struct store_config cfg = {.path = path, .merge = true, .keep = keep};
    struct store *s;
    expect_ok(store_open_on(&fs, &cfg, &s));
    return s;
}

/* Path in the conductor's store; one of four buffers in turn. */
static const char *in(const char *prefix, const char *id, const char *name)
{
    static char path[4][1024];
    static int turn;
    char *p = path[turn++ % 4];
    snprintf(p, sizeof path[0], "%s/%s%s%s%s", folder, prefix, id, *name ? "/" : "", name);
    return p;
}

/* Store a part in the board's own store; out: its folder. own: t */
static void store_part_of(struct take *t, char part[FILE_PATH_CAP])
{
    char id[STORE_ID_CAP], path[512];
    snprintf(path, sizeof path, "%s", tmpdir_path(t->rig.member));
    struct store *s = open_in(path, 0);
    expect_ok(store_commit(s, t, id));
    take_free(t);
    store_close(s);
    expect_ok(file_join(path, id, part));
}

static void stage(struct store *s, struct take *t, const char *id)
{
    char part[FILE_PATH_CAP], member[TAKE_MEMBER_CAP];
    snprintf(member, sizeof member, "%s", t->rig.member);
    store_part_of(t, part);
    expect_ok(small_rig_fetch(&fs, s, folder, id, member, part));
}

static void begin(struct store *s, char id[STORE_ID_CAP])
{
    expect_ok(store_reserve(s, id));
    expect_ok(joint_begin(s, id, "{\"ordered\": true}"));
}

static err_t join(struct store *s, const char *id, int n)
{
    const struct joint j = {.id = id, .n = n, .member = names, .trigger = {11, 22, 33}};
    return joint_commit(s, &j);
}

static int entries(const char *path)
{
    DIR *d = opendir(path);
    int n = -2;
    while (d && readdir(d))
        n++;
    if (d)
        closedir(d);
    return d ? n : -1;
}

static char *read_text(const char *path)
{
    struct file_map f;
    expect_ok(file_map(path, JSON_BYTES_MAX, &f));
    char *text = strndup((const char *)f.p, f.n);
    file_unmap(&f);
    assert_non_null(text);
    return text;
}

static struct raw_take *read_raw(const char *id)
{
    struct raw_take *t = malloc(sizeof *t);
    char *text = read_text(in("", id, MANIFEST_FILE));
    assert_non_null(t);
    expect_ok(raw_take_parse("m", text, strlen(text), t));
    free(text);
    return t;
}

static void flip(const char *path, long at)
{
    FILE *f = fopen(path, "r+");
    assert_non_null(f);
    fseek(f, at, SEEK_SET);
    int c = getc(f);
    fseek(f, at, SEEK_SET);
    putc(c ^ 1, f);
    assert_int_equal(fclose(f), 0);
}

/* ---- takes that become one ---- */

/* A take of two boards, with two cameras and one. */
static void commit_two(struct store *s, char id[STORE_ID_CAP])
{
    begin(s, id);
    struct take *t = small_part(2, 3, CAMERA_RGGB16, id, "b0");
    strcpy(t->reason, "coverage: \"dark\"");
    strcpy(t->camera[0].uri, "v4l2:\"caf\xc3\xa9\"\n");
    t->rejected = 3;
    t->frames_used = 20;
    t->stagger = true;
    stage(s, t, id);
    t = small_part(1, 3, CAMERA_RGGB16, id, "b1");
    t->tolerance = 0.25;
    t->rejected = 4;
    t->frame[2].common_ns -= 5000000;
    t->camera[0].has_crf = true;
    crf_srgb(&t->camera[0].crf);
    stage(s, t, id);
    expect_ok(join(s, id, 2));
}

/* What downstream makes of it. */
static void two_boards(void **state)
{
    (void)state;
    char id[STORE_ID_CAP], ids[4][STORE_ID_CAP];
    struct store *s = open_in(folder, 0);
    struct summary sum;
    struct exposures x;
    commit_two(s, id);
    expect_ok(store_verify(in("", id, "")));
    assert_int_equal(links, 3 * 3 * 3 + 3);
    assert_int_equal(joint_pending(folder, ids, 4), 0);
    assert_int_equal(entries(folder), 2); // with the counter
    struct raw_take *raw = read_raw(id);
    assert_int_equal(raw->n_cameras, 3);
    assert_int_equal(raw->n, 9);
    assert_int_equal(raw->frame[8].camera, 2);
    assert_string_equal(raw->frame[8].picture, "images/train_02_02.png");
    assert_true(raw->how.red > 1.5f);
    free(raw);
    expect_ok(summary_read(folder, id, &sum));
    assert_true(sum.complete && sum.cameras == 3 && sum.frames == 9 && sum.n_images == 3);
    assert_string_equal(sum.image[0], "train_00_01.png"); // the middle exposure of each camera
    expect_ok(exposures_read(in("", id, "exposure.json"), &x));
    assert_int_equal(x.n, 9);
    exposures_free(&x);
    const struct imageset_request rq = {.images = in("", id, ""), .every_exposure = true};
    struct imageset set;
    expect_ok(imageset_list(&rq, &set));
    expect_ok(raw_take_attach(&set));
    assert_int_equal(set.capture.n, 9);
    assert_int_equal(set.n_notes, 0);
    assert_true(set.capture.shots[8].raw && set.capture.shots[8].linear);
    imageset_free(&set);
    store_close(s);
}

static const char *text_at(const struct cJSON *object, const char *key)
{
    const char *text = json_string(json_member(object, key));
    return text ? text : "(none)";
}

static double number_at(const struct cJSON *object, const char *key)
{
    double v = NAN;
    if (!json_number(json_member(object, key), &v))
        fail_msg("no number %s", key);
    return v;
}

/* Something moves before the camera of the second board. */
static void masks_are_numbered(void **state)
{
    (void)state;
    char id[STORE_ID_CAP];
    struct store *s = open_in(folder, 0);
    begin(s, id);
    stage(s, small_part(2, 2, CAMERA_GREY16, id, "b0"), id);
    struct take *t = small_part(1, 2, CAMERA_GREY16, id, "b1");
    for (int i = 0; i < SMALL_W * SMALL_H / 2; i++)
        t->frame[1].data[2 * i + 1] = 1; // code 256 to 511
    stage(s, t, id);
    expect_ok(join(s, id, 2));
    expect_ok(store_verify(in("", id, "")));
    assert_int_equal(entries(in("", id, "masks")), 1);
    assert_true(file_exists(in("", id, "masks/train_02_00.png")) ||
                file_exists(in("", id, "masks/train_02_01.png")));
    store_close(s);
}

/* A thumbnail of a board may be gone or damaged; the take has the others. */
static void thumbnails_are_numbered(void **state)
{
    (void)state;
    char id[STORE_ID_CAP], part[STORE_ID_CAP];
    struct store *s = open_in(folder, 0);
    begin(s, id);
    struct take *t = small_part(1, 2, CAMERA_GREY16, id, "b0");
    expect_ok(store_commit(s, t, part));
    take_free(t);
    assert_int_equal(unlink(in("", part, "thumbs/train_00_00.jpg")), 0);
    expect_ok(joint_part_own(s, id, "b0", part));
    stage(s, small_part(2, 2, CAMERA_MJPG, id, "b1"), id);
    flip(in(".rig-", id, "b1/thumbs/train_00_01.jpg"), 40);
    expect_ok(join(s, id, 2));
    expect_ok(store_verify(in("", id, "")));
    assert_int_equal(entries(in("", id, "thumbs")), 4);
    assert_true(file_exists(in("", id, "thumbs/train_00_01.jpg")));
    assert_false(file_exists(in("", id, "thumbs/train_01_01.jpg")));
    assert_true(file_exists(in("", id, "thumbs/train_02_01.jpg")));
    store_close(s);
}

static void says_everything(void **state)
{
    (void)state;
    char id[STORE_ID_CAP];
    struct store *s = open_in(folder, 0);
    struct cJSON *doc;
    bool yes;
    commit_two(s, id);
    expect_ok(json_read(in("", id, MANIFEST_FILE), &doc));
    assert_string_equal(text_at(doc, "id"), id);
    assert_string_equal(text_at(doc, "status"), "complete");
    assert_string_equal(text_at(doc, "reason"), "b0: coverage: \"dark\"");
    assert_true(fabs(number_at(doc, "skew_s") - 0.005001) < 1e-12);
    assert_true(number_at(doc, "tolerance_stops") == 0.25);
    assert_true(number_at(doc, "rejected") == 7);
    assert_true(number_at(doc, "frames_used") == 20);
    assert_true(json_truth(json_member(doc, "stagger"), &yes) && yes);
    assert_true(json_truth(json_member(doc, "metered"), &yes) && yes);
    assert_string_equal(text_at(json_member(doc, "trigger"), "boottime_ns"), "22");
    const struct cJSON *rig = json_member(doc, "rig");
    const struct cJSON *board = json_first(json_member(rig, "members"));
    assert_string_equal(text_at(rig, "take"), id);
    assert_string_equal(text_at(board, "name"), "b0");
    assert_string_equal(text_at(board, "within_ns"), "70005");
    assert_string_equal(text_at(board, "clock"), "exchange");
    assert_string_equal(text_at(json_next(board), "name"), "b1");
    const struct cJSON *c = json_first(json_member(doc, "cameras"));
    assert_string_equal(text_at(c, "uri"), "v4l2:\"caf\xc3\x83\xc2\xa9\"\n");
    assert_string_equal(text_at(c, "member"), "b0");
    c = json_next(json_next(c));
    assert_string_equal(text_at(c, "member"), "b1");
    assert_int_equal(json_count(json_member(json_member(c, "crf"), "log2x")), 3);
    const struct cJSON *f = json_first(json_member(doc, "frames"));
    for (int i = 0; i < 8; i++)
        f = json_next(f);
    assert_string_equal(text_at(f, "raw"), "raw/02_02.bin");
    assert_string_equal(text_at(f, "timestamp_ns"), "9007199254740993");
    assert_true(number_at(f, "sequence") == 4000000002.0);
    json_free(doc);
    store_close(s);
}

static void orders(void **state)
{
    (void)state;
    char id[2][STORE_ID_CAP], ids[4][STORE_ID_CAP], *text;
    struct store *s = open_in(folder, 0);
    begin(s, id[0]);
    begin(s, id[1]);
    assert_int_equal(joint_pending(folder, ids, 4), 2);
    assert_string_equal(ids[0], id[1]);
    assert_int_equal(joint_pending(folder, ids, 1), 1);
    expect_ok(joint_order(folder, id[0], &text));
    assert_string_equal(text, "{\"ordered\": true}");
    free(text);
    store_close(s);
    s = open_in(folder, 0); // leaves them alone
    assert_int_equal(joint_pending(folder, ids, 4), 2);
    expect_ok(joint_drop(s, id[1]));
    assert_int_equal(joint_pending(folder, ids, 4), 1);
    store_close(s);
}

/* Cameras are told apart by their sizes, pictures by what is in them. */
static void sixteen_boards(void **state)
{
    (void)state;
    char id[STORE_ID_CAP];
    struct store *s = open_in(folder, 0);
    begin(s, id);
    for (int i = MEMBERS - 1; i >= 0; i--)
        stage(s,
              small_part(1 + i % 2, 1 + i % 3, i % 4 == 1 ? CAMERA_MJPG : CAMERA_GREY16, id,
                         names[i]),
              id);
    expect_ok(join(s, id, MEMBERS));
    expect_ok(store_verify(in("", id, "")));
    struct raw_take *raw = read_raw(id);
    assert_int_equal(raw->n_cameras, 24);
    for (int i = 0, c = 0; i < MEMBERS; c += 1 + i % 2, i++)
        for (int k = 0; k <= i % 2; k++)
            assert_int_equal(raw->camera[c + k].format, i % 4 == 1 ? CAMERA_MJPG : CAMERA_GREY16);
    int n = 0;
    for (int i = 0; i < MEMBERS; i++)
        n += (1 + i % 2) * (1 + i % 3);
    assert_int_equal(raw->n, n);
    for (int i = 1; i < n; i++)
        assert_true(strcmp(raw->frame[i - 1].picture, raw->frame[i].picture) < 0);
    free(raw);
    store_close(s);
}

/* 128 cameras of 9 exposures: a manifest of that size can be read, and such a take removed. */
static void the_largest_rig(void **state)
{
    (void)state;
    char id[STORE_ID_CAP], part[8][FILE_PATH_CAP];
    struct store *s = open_in(folder, 1);
    struct stat st;
    begin(s, id);
    for (int i = 0; i < 8; i++) {
        struct take *t = small_part(16, 9, CAMERA_MJPG, id, names[i]);
        for (int c = 0; c < 16; c++) {
            t->camera[c].has_crf = true;
            crf_srgb(&t->camera[c].crf);
            t->meter[c].n = METER_EXPOSURES_MAX;
        }
        for (int k = 0; k < t->n; k++)
            t->frame[k].evidence.ratio = 1.23456789f;
        store_part_of(t, part[i]);
        expect_ok(small_rig_fetch(&fs, s, folder, id, names[i], part[i]));
    }
    expect_ok(join(s, id, 8));
    expect_ok(store_verify(in("", id, "")));
    struct raw_take *raw = read_raw(id);
    assert_int_equal(raw->n_cameras, 128);
    assert_int_equal(raw->n, 1152);
    free(raw);
    assert_int_equal(stat(in("", id, MANIFEST_FILE), &st), 0);
    printf("manifest of 128 cameras: %jd bytes\n", (intmax_t)st.st_size);
    begin(s, id);
    for (int i = 0; i < 9; i++)
        stage(s, small_part(i == 8 ? 1 : 16, 1, CAMERA_MJPG, id, names[i]), id);
    expect_err(join(s, id, 9), ERR_LIMIT, "129 cameras up to board b8, at most 128");
    expect_ok(join(s, id, 8));
    assert_int_equal(entries(folder), 2); // store.keep is 1: nothing is left of the first
    store_close(s);
}

static void missing_boards(void **state)
{
    (void)state;
    static const char *const gone[] = {"b7", "left-arm"};
    char id[STORE_ID_CAP];
    struct store *s = open_in(folder, 0);
    struct cJSON *doc;
    begin(s, id);
    stage(s, small_part(1, 2, CAMERA_GREY16, id, "b0"), id);
    struct joint j = {.id = id, .n = 1, .member = names, .n_missing = 2, .missing = gone};
    expect_ok(joint_commit(s, &j));
    expect_ok(json_read(in("", id, MANIFEST_FILE), &doc));
    const struct cJSON *list = json_member(json_member(doc, "rig"), "missing");
    assert_int_equal(json_count(list), 2);
    assert_string_equal(json_string(json_next(json_first(list))), "left-arm");
    assert_string_equal(json_string(json_member(doc, "reason")), "missing boards: b7, left-arm");
    json_free(doc);
    expect_ok(store_verify(in("", id, "")));
    store_close(s);
}

static void white_balances(void **state)
{
    (void)state;
    static const float red[][3] = {{2, 2.01f, 1}, {2, 2.05f, 1}};
    char id[STORE_ID_CAP];
    struct store *s = open_in(folder, 0);
    for (int i = 0; i < 2; i++) {
        begin(s, id);
        stage(s, small_part(1, 1, CAMERA_GREY16, id, "b0"), id); // has none
        for (int k = 0; k < 2; k++) {
            struct take *t = small_part(1, 1, CAMERA_RGGB16, id, names[1 + k]);
            t->balance = (struct develop){red[i][k], 1.5f};
            stage(s, t, id);
        }
        expect_ok(join(s, id, 3));
        char *text = read_text(in("", id, MANIFEST_FILE));
        assert_non_null(strstr(text, "\"white_red\": 2, \"white_blue\": 1.5"));
        assert_int_equal(strstr(text, "white balance differs between boards") != NULL, i);
        free(text);
    }
    store_close(s);
}

static void copies_without_links(void **state)
{
    (void)state;
    char id[STORE_ID_CAP];
    struct stat st;
    fs.link = no_link;
    struct store *s = open_in(folder, 0);
    begin(s, id);
    for (int i = 0; i < 2; i++)
        stage(s, small_part(1, 2, CAMERA_RGGB16, id, names[i]), id);
    expect_ok(join(s, id, 2));
    expect_ok(store_verify(in("", id, "")));
    assert_int_equal(stat(in("", id, "raw/01_01.bin"), &st), 0);
    assert_int_equal(st.st_nlink, 1);
    store_close(s);
}

/* The conductor is a member, too: its part comes without the network. */
static void own_part(void **state)
{
    (void)state;
    char id[STORE_ID_CAP], part[STORE_ID_CAP];
    struct store_part parts[4];
    struct store *s = open_in(folder, 0);
    begin(s, id);
    struct take *t = small_part(1, 2, CAMERA_GREY16, id, "b0");
    expect_ok(store_commit(s, t, part));
    take_free(t);
    stage(s, small_part(1, 2, CAMERA_GREY16, id, "b1"), id);
    expect_ok(joint_part_own(s, id, "b0", part));
    expect_ok(joint_part_own(s, id, "b0", part)); // again, after a restart
    assert_int_equal(store_parts(folder, parts, 4), 1);
    expect_ok(join(s, id, 2));
    expect_ok(store_release(s, id));
    assert_int_equal(store_parts(folder, parts, 4), 0);
    expect_ok(store_verify(in("", id, "")));
    assert_int_equal(entries(folder), 2);
    store_close(s);
}

/* ---- takes that do not ---- */

/* One board's part is spoiled; nothing comes of it, and the staging folder stays. */
static void refused(struct store *s, const char *id, err_t code, const char *words)
{
    char ids[4][STORE_ID_CAP];
    int n = entries(folder), staged = entries(in(".rig-", id, "b1/images"));
    expect_err(join(s, id, 2), code, words);
    assert_int_equal(entries(folder), n);
    assert_int_equal(entries(in(".rig-", id, "b1/images")), staged);
    assert_int_equal(joint_pending(folder, ids, 4), 1);
    assert_int_equal(store_list(s, ids, 4), 0);
}

static void spoiled_parts(void **state)
{
    (void)state;
    char id[STORE_ID_CAP];
    struct store *s = open_in(folder, 0);
    begin(s, id);
    stage(s, small_part(1, 2, CAMERA_GREY16, id, "b0"), id);
    refused(s, id, ERR_IO, "b1/manifest.json: cannot be read");
    stage(s, small_part(2, 2, CAMERA_GREY16, id, "b1"), id);
    flip(in(".rig-", id, "b1/raw/01_01.bin"), 700);
    refused(s, id, ERR_FORMAT, "b1/raw/01_01.bin: its SHA-256 differs");
    assert_int_equal(truncate(in(".rig-", id, "b1/raw/01_01.bin"), 7), 0);
    refused(s, id, ERR_FORMAT, "b1/raw/01_01.bin: the file has 7 bytes");
    assert_int_equal(unlink(in(".rig-", id, "b1/raw/01_01.bin")), 0);
    refused(s, id, ERR_FORMAT, "b1/raw/01_01.bin: is missing");
    assert_int_equal(symlink("/etc/passwd", in(".rig-", id, "b1/raw/01_01.bin")), 0);
    refused(s, id, ERR_IO, "b1/raw/01_01.bin");
    assert_int_equal(unlink(in(".rig-", id, "b1/raw/01_01.bin")), 0);
    assert_int_equal(mkdir(in(".rig-", id, "b1/raw/01_01.bin"), 0777), 0);
    refused(s, id, ERR_IO, "not a regular file");
    expect_ok(joint_drop(s, id));
    expect_ok(joint_drop(s, id));
    assert_int_equal(entries(folder), 1);
    store_close(s);
}

static void parts_of_others(void **state)
{
    (void)state;
    char id[STORE_ID_CAP], part[FILE_PATH_CAP];
    struct manifest *m = malloc(sizeof *m);
    struct store *s = open_in(folder, 0);
    begin(s, id);
    store_part_of(small_part(1, 1, CAMERA_GREY16, "0123abcd-000009", "b0"), part);
    expect_err(small_rig_fetch(&fs, s, folder, id, "b0", part), ERR_FORMAT,
               "a part of take 0123abcd-000009, not of ");
    store_part_of(small_part(1, 1, CAMERA_GREY16, id, "b2"), part);
    expect_err(small_rig_fetch(&fs, s, folder, id, "b1", part), ERR_FORMAT,
               "the part of b2, not of b1");
    struct take *t = small_part(1, 1, CAMERA_GREY16, id, "b3");
    t->status = TAKE_ABORTED;
    store_part_of(t, part);
    expect_err(small_rig_fetch(&fs, s, folder, id, "b3", part), ERR_FORMAT, "an aborted take");
    t = small_part(1, 1, CAMERA_GREY16, id, "b4");
    t->rig = (struct take_rig){.member = "b4"}; // names the folder
    store_part_of(t, part);
    expect_err(small_rig_fetch(&fs, s, folder, id, "b4", part), ERR_FORMAT, "not a part of");
    expect_err(joint_part_files(folder, id, "b5", m), ERR_IO, "b5/manifest.json");
    expect_err(joint_part_files(folder, id, "../b5", m), ERR_ARG, "not the name of a board");
    expect_err(joint_part_files(folder, "../x", "b5", m), ERR_ARG, "not the id of a take");
    free(m);
    store_close(s);
}

/* Replace the first `from` in the manifest of b1, join, and put the manifest back. */
static void with(struct store *s, const char *id, const char *from, const char *to,
                 const char *words)
{
    const char *path = in(".rig-", id, "b1/manifest.json");
    char *text = read_text(path), *at = strstr(text, from);
    FILE *f = fopen(path, "w");
    assert_non_null(f);
    if (!at)
        fail_msg("no %s", from);
    fprintf(f, "%.*s%s%s", (int)(at - text), text, to, at + strlen(from));
    assert_int_equal(fclose(f), 0);
    refused(s, id, ERR_FORMAT, words);
    f = fopen(in(".rig-", id, "b1/manifest.json"), "w");
    assert_non_null(f);
    fputs(text, f);
    assert_int_equal(fclose(f), 0);
    free(text);
}

static void hostile_parts(void **state)
{
    (void)state;
    char id[STORE_ID_CAP], deep[64] = "";
    struct store *s = open_in(folder, 0);
    begin(s, id);
    stage(s, small_part(1, 2, CAMERA_GREY16, id, "b0"), id);
    stage(s, small_part(2, 2, CAMERA_GREY16, id, "b1"), id);
    with(s, id, "\"member\": \"b1\"", "\"member\": \"-1\"", "a member's name and a clock");
    with(s, id, "\"member\": \"b1\"", "\"member\": \"b1\", \"x\": 1", "\"x\" is not known");
    with(s, id, "\"exchange\"", "\"sundial\"", "a clock, exchange or kernel");
    with(s, id, "\"rig\": {", "\"rig\": 7, \"x\": {", "\"x\" is not known");
    with(s, id, "\"rig\"", "\"session\": \"x\", \"rig\"", "session is not an id");
    with(s, id, "\"common_ns\": \"", "\"common_ns\": \"x", "no time on the common clock");
    with(s, id, "\"common_ns\": \"", "\"common_ns\": \"99999", "no time on the common clock");
    with(s, id, "\"common_ns\": \"", "\"commen_ns\": \"", "no time on the common clock");
    with(s, id, "\"within_ns\": \"", "\"within_ns\": \"-", "no time on the common clock");
    with(s, id, "\"camera\": 1", "\"camera\": 2", "one of 2 cameras");
    with(s, id, "\"camera\": 1", "\"camera\": 0", "not in order");
    with(s, id, "\"camera\": 1", "\"camera\": -1", "one of 2 cameras");
    with(s, id, "\"camera\": 1", "\"camera\": 1, \"camera\": 63", "different keys");
    with(s, id, "\"index\": 1", "\"index\": 9", "an index below 9");
    with(s, id, "\"index\": 1", "\"index\": 0", "not in order");
    with(s, id, "\"exposure_s\": ", "\"exposure_s\": -", "an index below 9 and an exposure");
    with(s, id, "\"exposure_s\": ", "\"exposure_s\": 1e400, \"x\": ", "and an exposure");
    with(s, id, "\"raw\": \"raw/00_00", "\"raw\": \"raw/00_01", "names of others");
    with(s, id, "\"raw\": \"raw/00_00", "\"raw\": \"raw/../x", "names no file");
    with(s, id, "images/train_00_00.png", "images/train_63_00.png", "names of others");
    with(s, id, "\"name\": \"raw/00_00.bin\"", "\"name\": \"raw/63_00.bin\"", "is not listed");
    with(s, id, "\"name\": \"merged/00.exr\"", "\"name\": \"merged/07.exr\"", "lists 15 files");
    with(s, id, "\"name\": \"exposure.json\"", "\"name\": \"order.json\"", "lists 15 files");
    with(s, id, "\"name\": \"merged/00.exr\"", "\"name\": \"images/x.png\"", "lists 15 files");
    with(s, id, "\"uri\"", "\"member\": \"b0\", \"uri\"", "is of a joint take");
    with(s, id, "\"uri\"", "\"uri\": 1, \"uri\"", "different keys");
    with(s, id, "\"pixels\": \"grey16\"", "\"pixels\": \"film\"", "needs pixels");
    with(s, id, "\"status\": \"complete\"", "\"status\": \"aborted\"", "an aborted take");
    for (int i = 0; i < 20; i++)
        strcat(deep, "[");
    for (int i = 0; i < 20; i++)
        strcat(deep, "]");
    char more[96];
    snprintf(more, sizeof more, "\"x\": %s, \"uri\"", deep);
    with(s, id, "\"uri\"", more, "is no object of");
    expect_ok(join(s, id, 2)); // it was all of that
    store_close(s);
}

static void arguments(void **state)
{
    (void)state;
    static const char *const bad[] = {"b0", "b0", "../x", "-b", "B", ""};
    char id[STORE_ID_CAP], other[STORE_ID_CAP], *text = calloc(1, JOINT_ORDER_MAX + 2);
    struct store *s = open_in(folder, 0);
    struct joint j = {.id = "x", .n = 2, .member = bad};
    begin(s, id);
    expect_err(joint_begin(s, id, "again"), ERR_IO, "cannot be used as the new name");
    expect_err(joint_begin(s, "aborted-0123abcd-000001", ""), ERR_ARG, "not the id");
    memset(text, 'x', JOINT_ORDER_MAX + 1);
    expect_err(joint_begin(s, id, text), ERR_ARG, "has 65537 bytes, at most 65536");
    text[JOINT_ORDER_MAX] = 0;
    expect_ok(store_reserve(s, other));
    expect_ok(joint_begin(s, other, text));
    free(text);
    expect_ok(joint_order(folder, other, &text));
    assert_int_equal(strlen(text), JOINT_ORDER_MAX);
    free(text);
    expect_ok(joint_drop(s, other));
    expect_err(joint_order(folder, other, &text), ERR_IO, "order.json");
    expect_err(joint_commit(s, &j), ERR_ARG, "board b0 is named twice");
    j.n = 1;
    expect_err(joint_commit(s, &j), ERR_ARG, "\"x\" is not the id of a take");
    for (int i = 2; i < 6; i++) {
        j.member = bad + i;
        expect_err(joint_commit(s, &j), ERR_ARG, "is not the name of a board");
    }
    j = (struct joint){.id = id, .n = 0, .member = names};
    expect_err(joint_commit(s, &j), ERR_ARG, "0 boards");
    stage(s, small_part(1, 1, CAMERA_GREY16, id, "b0"), id);
    flip(in(".rig-", id, "boot_id"), 0);
    expect_err(join(s, id, 1), ERR_FORMAT, "not the boot id of take");
    flip(in(".rig-", id, "boot_id"), 0);
    expect_ok(join(s, id, 1));
    expect_ok(joint_begin(s, id, ""));
    expect_err(join(s, id, 1), ERR_IO, "the take is there already");
    store_close(s);
    assert_int_equal(entries(folder), 3);
    s = open_in(folder, 0); // which removes what is left of a take that exists
    assert_int_equal(entries(folder), 2);
    store_close(s);
}

/* ---- parts on their board ---- */

static void parts_are_held(void **state)
{
    (void)state;
    char id[STORE_ID_CAP], ids[16][STORE_ID_CAP], rig[STORE_ID_CAP];
    struct store_part parts[8];
    struct store *s = open_in(folder, 2);
    for (int i = 0; i < 9; i++) {
        snprintf(rig, sizeof rig, "0123abcd-%06d", 1 + i / 3);
        struct take *t = i % 3 == 2 ? small_take(1, 1, CAMERA_GREY16)
                                    : small_part(1, 1, CAMERA_GREY16, rig, "b0");
        t->status = i % 3 == 1 ? TAKE_ABORTED : TAKE_COMPLETE;
        expect_ok(store_commit(s, t, id));
        take_free(t);
    }
    assert_int_equal(store_list(s, ids, 16), 3 + 2 + 2);
    assert_int_equal(store_parts(folder, parts, 8), 3);
    assert_string_equal(parts[0].rig_take, "0123abcd-000003");
    assert_string_equal(parts[2].rig_take, "0123abcd-000001");
    assert_string_equal(parts[2].rig_member, "b0");
    assert_int_equal(store_parts(folder, parts, 1), 1);
    assert_string_equal(parts[0].rig_take, "0123abcd-000003");
    expect_ok(store_release(s, "0123abcd-000002"));
    expect_ok(store_release(s, "0123abcd-000002"));
    expect_ok(store_release(s, "x"));
    assert_int_equal(store_parts(folder, parts, 8), 2);
    FILE *f = fopen(in("", parts[1].id, "notes.txt"), "w");
    assert_non_null(f);
    fclose(f);
    expect_err(store_release(s, parts[1].rig_take), ERR_FORMAT, "notes.txt: is not in");
    assert_int_equal(store_parts(folder, parts, 8), 2);
    assert_int_equal(store_list(s, ids, 16), 2 + 2 + 2);
    struct take *t = small_part(1, 1, CAMERA_GREY16, "0123abcd-000001", "b0");
    strcpy(t->rig.clock, "sundial");
    expect_err(store_commit(s, t, id), ERR_ARG, "with the clock \"sundial\"");
    strcpy(t->rig.clock, "kernel");
    strcpy(t->rig.member, "../b0");
    expect_err(store_commit(s, t, id), ERR_ARG, "by \"../b0\"");
    take_free(t);
    store_close(s);
}

static void numbers_are_reserved(void **state)
{
    (void)state;
    char id[3][STORE_ID_CAP];
    bool is_aborted;
    struct store *s = open_in(folder, 0);
    expect_ok(store_reserve(s, id[0]));
    assert_true(store_number(id[0], &is_aborted) == 1 && !is_aborted);
    store_close(s);
    s = open_in(folder, 0);
    expect_ok(store_reserve(s, id[1]));
    assert_true(store_number(id[1], &is_aborted) == 2);
    expect_ok(joint_begin(s, id[1], ""));
    store_close(s);
    char counter[600];
    snprintf(counter, sizeof counter, "%s/counter", folder);
    assert_int_equal(unlink(counter), 0);
    s = open_in(folder, 0); // what is staged has its number
    expect_ok(store_reserve(s, id[2]));
    assert_true(store_number(id[2], &is_aborted) == 3);
    store_close(s);
}

int main(void)
{
#define EACH(f) cmocka_unit_test_setup_teardown(f, setup, tmpdir_teardown)
    const struct CMUnitTest tests[] = {EACH(orders),
                                       EACH(two_boards),
                                       EACH(says_everything),
                                       EACH(masks_are_numbered),
                                       EACH(thumbnails_are_numbered),
                                       EACH(sixteen_boards),
                                       EACH(the_largest_rig),
                                       EACH(missing_boards),
                                       EACH(white_balances),
                                       EACH(copies_without_links),
                                       EACH(own_part),
                                       EACH(spoiled_parts),
                                       EACH(parts_of_others),
                                       EACH(hostile_parts),
                                       EACH(arguments),
                                       EACH(parts_are_held),
                                       EACH(numbers_are_reserved)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
