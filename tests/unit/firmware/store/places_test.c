/* Takes of one session: what the disk says of it, whatever happens to takes and to the daemon. */
#include "firmware/store/places.h"

#include "drivers/format/file.h"
#include "firmware/store/manifest.h"
#include "firmware/store/store_fs.h"
#include "tests/unit/small_take.h"
#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <unistd.h>

#include <cmocka.h>

static char folder[512]; // folder of the store
static struct places p;

static int setup(void **state)
{
    (void)state;
    tmpdir_make();
    snprintf(folder, sizeof folder, "%s", tmpdir_path("store"));
    return 0;
}

static int no_sync(int fd)
{
    (void)fd;
    return 0;
}

static struct store *open_keep(int keep)
{
    struct store_config cfg = {.path = folder, .keep = keep};
    static struct store_fs fs;
    struct store *s;
    fs = store_fs_system;
    fs.sync = no_sync;
    assert_int_equal(store_open_on(&fs, &cfg, &s), OK);
    return s;
}

/* A take as the daemon makes it: of the open session. */
static void place(struct store *s, bool is_place, enum take_status status, char id[STORE_ID_CAP])
{
    struct take *t = small_take(1, 2, CAMERA_RGGB16);
    assert_int_equal(places_open(folder, &p), OK);
    t->status = status;
    t->is_place = is_place;
    memcpy(t->session, p.id, sizeof p.id);
    t->balance = p.balance;
    assert_int_equal(store_commit(s, t, id), OK);
    take_free(t);
}

static void one_session_after_the_other(void **state)
{
    char id[5][STORE_ID_CAP], aborted[STORE_ID_CAP], verify[1024];
    (void)state;
    struct store *s = open_keep(0);
    assert_int_equal(places_open(folder, &p), OK);
    assert_string_equal(p.id, "");
    for (int i = 0; i < 3; i++) {
        place(s, true, TAKE_COMPLETE, id[i]);
        place(s, true, TAKE_ABORTED, aborted);
        assert_int_equal(places_open(folder, &p), OK);
        assert_string_equal(p.id, id[0]);
        assert_int_equal(p.n, i + 1);
        for (int k = 0; k <= i; k++)
            assert_string_equal(p.take[k], id[k]);
    }
    assert_true(p.balance.red > 0.0f);
    store_close(s); // another daemon
    s = open_keep(0);
    assert_int_equal(places_end(folder, p.id), OK);
    assert_int_equal(places_open(folder, &p), OK);
    assert_string_equal(p.id, "");
    assert_int_equal(p.n, 0);
    place(s, true, TAKE_COMPLETE, id[3]);
    place(s, true, TAKE_COMPLETE, id[4]);
    assert_int_equal(places_open(folder, &p), OK);
    assert_string_equal(p.id, id[3]);
    assert_int_equal(p.n, 2);
    assert_int_equal(places_of(folder, id[0], &p), OK);
    assert_int_equal(p.n, 3);
    assert_string_equal(p.take[0], id[0]);
    assert_string_equal(p.take[2], id[2]);
    for (int i = 0; i < 5; i++) {
        snprintf(verify, sizeof verify, "%s/%s", folder, id[i]);
        assert_int_equal(store_verify(verify), OK);
    }
    store_close(s);
}

/* Every place gets the white balance of the first. */
static void one_white_balance(void **state)
{
    char id[STORE_ID_CAP];
    (void)state;
    struct store *s = open_keep(0);
    place(s, true, TAKE_COMPLETE, id);
    assert_int_equal(places_open(folder, &p), OK);
    assert_true(p.balance.red > 1.5f && p.balance.red < 2.5f);
    struct take *t = small_take(1, 2, CAMERA_RGGB16);
    t->is_place = true;
    memcpy(t->session, p.id, sizeof p.id);
    t->balance = (struct develop){1.25f, 0.75f};
    assert_int_equal(store_commit(s, t, id), OK);
    take_free(t);
    assert_int_equal(places_of(folder, p.id, &p), OK);
    assert_int_equal(p.n, 2);
    assert_true(p.balance.red > 1.5f); // the oldest's
    char path[1200];
    struct file_map m;
    snprintf(path, sizeof path, "%s/%s/manifest.json", folder, id);
    assert_int_equal(file_map(path, 1 << 24, &m), OK);
    static const char text[] = "\"white_red\": 1.25, \"white_blue\": 0.75";
    assert_non_null(memmem(m.p, m.n, text, strlen(text)));
    file_unmap(&m);
    store_close(s);
}

/* A take that is no place of a session ends none, and begins none. */
static void beside_other_takes(void **state)
{
    char id[3][STORE_ID_CAP];
    (void)state;
    struct store *s = open_keep(0);
    place(s, true, TAKE_COMPLETE, id[0]);
    place(s, false, TAKE_COMPLETE, id[1]);
    assert_int_equal(places_open(folder, &p), OK);
    assert_string_equal(p.id, "");
    place(s, true, TAKE_COMPLETE, id[2]);
    assert_int_equal(places_open(folder, &p), OK);
    assert_string_equal(p.id, id[2]);
    assert_int_equal(p.n, 1);
    store_close(s);
}

/* The first place was a mistake, and its folder was removed; a take cannot be read. */
static void removed_by_hand(void **state)
{
    char id[3][STORE_ID_CAP], command[1200];
    (void)state;
    struct store *s = open_keep(0);
    for (int i = 0; i < 3; i++)
        place(s, true, TAKE_COMPLETE, id[i]);
    snprintf(command, sizeof command, "rm -r %s/%s; echo x >%s/%s/manifest.json", folder, id[0],
             folder, id[2]);
    assert_int_equal(system(command), 0);
    assert_int_equal(places_open(folder, &p), OK);
    assert_string_equal(p.id, id[0]);
    assert_int_equal(p.n, 1);
    assert_string_equal(p.take[0], id[1]);
    store_close(s);
}

/* store.keep leaves the places of the session that is open. */
static void keeps_the_session(void **state)
{
    char id[6][STORE_ID_CAP];
    (void)state;
    struct store *s = open_keep(2);
    for (int i = 0; i < 4; i++)
        place(s, true, TAKE_COMPLETE, id[i]);
    assert_int_equal(places_open(folder, &p), OK);
    assert_int_equal(p.n, 4);
    assert_int_equal(places_end(folder, p.id), OK);
    place(s, true, TAKE_COMPLETE, id[4]);
    place(s, true, TAKE_COMPLETE, id[5]);
    assert_int_equal(places_of(folder, id[0], &p), OK);
    assert_int_equal(p.n, 0);
    assert_int_equal(places_open(folder, &p), OK);
    assert_int_equal(p.n, 2);
    store_close(s);
}

/* A file of somebody else is neither read as the end of a session nor replaced. */
static void somebody_elses_file(void **state)
{
    char id[STORE_ID_CAP];
    (void)state;
    struct store *s = open_keep(0);
    place(s, true, TAKE_COMPLETE, id);
    tmpdir_text("store/session-ended", "my notes");
    assert_int_equal(places_end(folder, id), ERR_ARG);
    assert_non_null(strstr(err_text(), "was not written by hdrig"));
    assert_int_equal(places_open(folder, &p), OK);
    assert_string_equal(p.id, id);
    struct file_map m;
    assert_int_equal(file_map(tmpdir_path("store/session-ended"), 100, &m), OK);
    assert_int_equal(m.n, strlen("my notes"));
    file_unmap(&m);
    assert_int_equal(unlink(tmpdir_path("store/session-ended")), 0);
    tmpdir_text("store/.tmp-session-ended", "cut sho"); // a power cut
    store_close(s);
    s = open_keep(0);
    assert_false(file_exists(tmpdir_path("store/.tmp-session-ended")));
    assert_int_equal(places_end(folder, id), OK);
    assert_int_equal(places_end(folder, id), OK);
    store_close(s);
}

int main(void)
{
#define EACH(f) cmocka_unit_test_setup_teardown(f, setup, tmpdir_teardown)
    const struct CMUnitTest tests[] = {
        EACH(one_session_after_the_other), EACH(one_white_balance),
        EACH(beside_other_takes),          EACH(removed_by_hand),
        EACH(keeps_the_session),           EACH(somebody_elses_file)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
