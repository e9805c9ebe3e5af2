/* A conductor puts joint takes together while its writer stores takes and parts of its own. */
#include "firmware/store/joint.h"
#include "firmware/store/store_fs.h"
#include "tests/unit/expect.h"
#include "tests/unit/small_rig.h"
#include "tests/unit/tmpdir.h"

#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

enum { PRESSES = 8, KEEP = 3 };

static struct store *store;
static char folder[512];
static char rig[PRESSES][STORE_ID_CAP]; // takes of the rig, reserved before

static int no_sync(int fd)
{
    (void)fd;
    return 0;
}

/* Parts, and takes of its own. Returns the first error's sentence. */
static void *writer(void *failed)
{
    char id[STORE_ID_CAP];
    for (int i = 0; i < 2 * PRESSES; i++) {
        struct take *t = i % 2 ? small_take(1, 1, CAMERA_GREY16)
                               : small_part(1, 1, CAMERA_GREY16, rig[i / 2], "b0");
        if (store_commit(store, t, id) != OK)
            snprintf(failed, 256, "%s", err_text());
        take_free(t);
    }
    return NULL;
}

static bool find_part(const char *take, char id[STORE_ID_CAP])
{
    struct store_part parts[PRESSES];
    int n = store_parts(folder, parts, PRESSES);
    for (int i = 0; i < n; i++)
        if (strcmp(parts[i].rig_take, take) == 0) {
            memcpy(id, parts[i].id, STORE_ID_CAP);
            return true;
        }
    return false;
}

static err_t press(int i)
{
    static const char *const members[] = {"b0"};
    const struct joint j = {.id = rig[i], .n = 1, .member = members};
    char part[STORE_ID_CAP], unused[STORE_ID_CAP];
    err_t e = joint_begin(store, rig[i], "{}");
    while (!e && !find_part(rig[i], part))
        ;
    if (!e)
        e = joint_part_own(store, rig[i], "b0", part);
    if (!e)
        e = store_reserve(store, unused);
    if (!e)
        e = joint_commit(store, &j);
    return e ? e : store_release(store, rig[i]);
}

static void writer_and_conductor(void **state)
{
    (void)state;
    struct store_config cfg = {.path = folder, .keep = KEEP};
    struct store_fs fs = store_fs_system;
    char failed[256] = "", ids[4 * PRESSES][STORE_ID_CAP], path[FILE_PATH_CAP];
    struct store_part part;
    pthread_t thread;
    fs.sync = no_sync;
    snprintf(folder, sizeof folder, "%s", tmpdir_path("store"));
    expect_ok(store_open_on(&fs, &cfg, &store));
    for (int i = 0; i < PRESSES; i++)
        expect_ok(store_reserve(store, rig[i]));
    assert_int_equal(pthread_create(&thread, NULL, writer, failed), 0);
    for (int i = 0; i < PRESSES; i++)
        expect_ok(press(i));
    pthread_join(thread, NULL);
    assert_string_equal(failed, "");
    assert_int_equal(store_parts(folder, &part, 1), 0);
    int n = store_list(store, ids, 4 * PRESSES);
    assert_int_equal(n, KEEP);
    for (int i = 0; i < n; i++) {
        expect_ok(file_join(folder, ids[i], path));
        expect_ok(store_verify(path));
    }
    store_close(store);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(writer_and_conductor, tmpdir_setup, tmpdir_teardown)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
