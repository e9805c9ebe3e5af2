/* The store when the disk fails, the process is killed or the power is cut: every take that can be
 * seen is whole, those that were there stay, and numbers are not used again. */
#include "core/base/log.h"
#include "firmware/store/store.h"
#include "tests/fault/alloc_fail.h"
#include "tests/fault/disk_model.h"
#include "tests/unit/small_take.h"
#include "tests/unit/tmpdir.h"

#include <dirent.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/mman.h>
#include <sys/wait.h>

#include <cmocka.h>

enum { KEEP = 2, MARKS = 8, SEEDS = 6, SEEN = 16, CUTS_LEAST = 500 };

/* Takes for which store_commit has returned; shared with children. */
struct marks {
    int n;
    int changes[MARKS], calls[MARKS]; // the disk had seen by then
    char id[MARKS][STORE_ID_CAP];
};

static struct marks *marks;
static int cuts, left_something;

static const char *store_path(const char *root)
{
    static char path[600];
    snprintf(path, sizeof path, "%s/a/s", root);
    return path;
}

static err_t open_store(const struct store_fs *fs, const char *root, struct store **s)
{
    const struct store_config cfg = {.path = store_path(root), .merge = true, .keep = KEEP};
    return store_open_on(fs, &cfg, s);
}

static err_t commit(struct store *s, int exposures, char id[STORE_ID_CAP])
{
    struct take *t = small_take(1, exposures, CAMERA_GREY16);
    if (!t)
        return err_fail(ERR_NOMEM, "no take");
    err_t e = store_commit(s, t, id);
    take_free(t);
    return e;
}

static void commit_and_mark(struct store *s, int exposures)
{
    char id[STORE_ID_CAP];
    if (commit(s, exposures, id) != OK)
        return;
    memcpy(marks->id[marks->n], id, STORE_ID_CAP);
    marks->changes[marks->n] = disk.changes;
    marks->calls[marks->n] = disk.calls;
    marks->n++;
}

/* Some takes, the oldest of which are removed, by two runs of a daemon. */
static void daily_life(const char *root)
{
    static const int exposures[] = {1, 2, 1, 1};
    struct store *s;
    marks->n = 0;
    for (int run = 0; run < 2; run++) {
        if (open_store(&disk_fs, root, &s) != OK) {
            disk.dead_at = -1;
            continue;
        }
        for (int i = 0; i < 2; i++)
            commit_and_mark(s, exposures[2 * run + i]);
        store_close(s);
        disk.dead_at = -1;
    }
}

/* ---- what must hold ---- */

static uint64_t number(const char *id)
{
    return strtoull(strrchr(id, '-') + 1, NULL, 10);
}

static int hidden(const char *path, const char *prefix)
{
    DIR *d = opendir(path);
    int n = 0;
    for (struct dirent *entry; d && (entry = readdir(d));)
        n += strncmp(entry->d_name, prefix, strlen(prefix)) == 0;
    if (d)
        closedir(d);
    return n;
}

static bool listed(char (*ids)[STORE_ID_CAP], int n, const char *id)
{
    for (int i = 0; i < n; i++)
        if (strcmp(ids[i], id) == 0)
            return true;
    return false;
}

static int whole_takes(struct store *s, const char *root, char (*ids)[STORE_ID_CAP])
{
    char path[700];
    int n = store_list(s, ids, SEEN);
    for (int i = 0; i < n; i++) {
        snprintf(path, sizeof path, "%s/%s", store_path(root), ids[i]);
        if (store_verify(path) != OK)
            fail_msg("%s", err_text());
    }
    return n;
}

static int no_sync(int fd)
{
    (void)fd;
    return 0;
}

/* What is found in `root` after a cut, when so many takes had been committed. */
static void recovers(const char *root, int committed)
{
    struct store_fs fs = store_fs_system;
    struct store *s;
    char ids[SEEN][STORE_ID_CAP], id[STORE_ID_CAP];
    fs.sync = no_sync;
    left_something += hidden(store_path(root), ".tmp-") > 0;
    if (open_store(&fs, root, &s) != OK)
        fail_msg("%s", err_text());
    assert_int_equal(hidden(store_path(root), ".tmp-"), 0);
    assert_int_equal(hidden(store_path(root), "damaged-"), 0);
    int n = whole_takes(s, root, ids);
    assert_true(n >= (committed < KEEP ? committed : KEEP));
    for (int i = committed - 1; i >= 0 && i > committed - KEEP; i--)
        if (!listed(ids, n, marks->id[i]))
            fail_msg("%s is lost", marks->id[i]);
    if (commit(s, 1, id) != OK)
        fail_msg("%s", err_text());
    for (int i = 0; i < committed + n; i++)
        if (number(id) <= number(i < n ? ids[i] : marks->id[i - n]))
            fail_msg("number of %s is used again", id);
    store_close(s);
    cuts++;
}

static void remove_root(const char *root)
{
    nftw(root, tmpdir_forget, 8, FTW_DEPTH | FTW_PHYS);
}

static void power_cut(const char *root, struct disk_cut cut)
{
    int committed = 0;
    while (committed < marks->n && marks->changes[committed] <= cut.changes)
        committed++;
    disk_put(&cut, 0, root);
    recovers(root, committed);
    remove_root(root);
}

/* ---- the tests ---- */

static void power_cut_at_any_change(void **state)
{
    (void)state;
    const char *live = tmpdir_mkdir("live"), *after = tmpdir_path("after");
    disk_reset(live, true);
    daily_life(live);
    assert_int_equal(marks->n, 4);
    cuts = left_something = 0;
    for (int k = 0; k <= disk.changes; k++)
        for (uint64_t seed = 0; seed < SEEDS; seed++)
            power_cut(after, (struct disk_cut){k, seed});
    printf("%d power cuts after %d changes, %d left something to clean\n", cuts, disk.changes,
           left_something);
    assert_true(cuts > CUTS_LEAST && left_something > cuts / 4);
}

/* A call that fails, then a cut. */
static void power_cut_after_failure(void **state)
{
    (void)state;
    const char *live = tmpdir_path("live"), *after = tmpdir_path("after");
    int failures = 0;
    cuts = 0;
    for (int fail_at = 0;; fail_at++) {
        assert_int_equal(mkdir(live, 0777), 0);
        disk_reset(live, true);
        disk.fail_at = fail_at;
        disk.why = EIO;
        daily_life(live);
        for (uint64_t seed = 0; seed < 2 && disk.failed; seed++) {
            int from = disk.changes * 3 / 8;
            power_cut(after, (struct disk_cut){disk.changes - (int)seed * from / 2, 2 * seed});
        }
        failures += disk.failed;
        remove_root(live);
        if (!disk.failed)
            break;
    }
    printf("%d power cuts after %d failures\n", cuts, failures);
    assert_true(failures > 200);
}

/* The sync that makes a take durable fails, it is taken back, the process dies on the way, the next
 * one cleans up, and the power is cut. */
static void power_cut_after_taking_back(void **state)
{
    (void)state;
    enum { DEATHS = 6, AFTER = 30 };
    const char *live = tmpdir_path("live"), *after = tmpdir_path("after");
    int calls[2] = {0};
    cuts = 0;
    for (int i = -1; i < 2 * DEATHS; i++) {
        assert_int_equal(mkdir(live, 0777), 0);
        disk_reset(live, true);
        disk.why = EIO;
        if (i >= 0)
            disk.fail_at = calls[i / DEATHS];
        if (i % DEATHS > 0)
            disk.dead_at = disk.fail_at + i % DEATHS;
        daily_life(live);
        for (int n = 0; n < 2 && i < 0; n++) // a commit ends with the store's sync and close
            calls[n] = marks->calls[n] - 2;
        int from = i < 0 ? disk.changes : disk.failed_change;
        for (int k = from; k < disk.changes && k < from + AFTER; k++)
            for (uint64_t seed = 2; seed < 5; seed++)
                power_cut(after, (struct disk_cut){k, seed});
        remove_root(live);
    }
    printf("%d power cuts after taking back\n", cuts);
    assert_true(cuts > CUTS_LEAST);
}

static void killed_at_any_call(void **state)
{
    (void)state;
    const char *live = tmpdir_path("live");
    cuts = 0;
    for (int k = 0;; k++) {
        int status;
        assert_int_equal(mkdir(live, 0777), 0);
        disk_reset(live, true);
        disk.kill_at = k;
        pid_t pid = fork();
        if (pid == 0) {
            daily_life(live);
            _exit(0);
        }
        assert_int_equal(waitpid(pid, &status, 0), pid);
        if (WIFSIGNALED(status))
            recovers(live, marks->n);
        remove_root(live);
        if (WIFEXITED(status))
            break;
    }
    printf("%d kills\n", cuts);
    assert_true(cuts > 200);
}

/* One commit fails at its call k; returns false if it did not get there. */
static bool fails_at(struct store *s, const char *root, int k, int why, bool for_good)
{
    char ids[SEEN][STORE_ID_CAP], now[SEEN][STORE_ID_CAP], id[STORE_ID_CAP];
    int n = store_list(s, ids, SEEN);
    disk.calls = 0;
    disk.fail_at = k;
    disk.why = why;
    disk.for_good = for_good;
    disk.failed = false;
    err_t e = commit(s, 2, id);
    bool reached = disk.failed;
    disk.fail_at = -1;
    disk.failed = disk.for_good = false;
    int left = whole_takes(s, root, now);
    if (!e) {
        assert_true(listed(now, left, id));
    } else {
        assert_true(reached);
        if (e != (why == ENOSPC || why == EDQUOT ? ERR_LIMIT : ERR_IO) && e != ERR_IO)
            fail_msg("error %d: %s", e, err_text());
        assert_true(*err_text());
        bool stuck = for_good && left == n + 1; // it is visible and cannot be taken back
        assert_true(left == n || stuck);
        for (int i = 0; i < n; i++)
            assert_string_equal(now[i + stuck], ids[i]);
        if (!for_good && hidden(store_path(root), ".tmp-") > 1) // one may be the counter
            fail_msg("something stays after call %d, %s", k, strerror(why));
    }
    return reached;
}

/* The same; the next run of the daemon finds nothing wrong. */
static bool works_again(const char *root, int k, int why, bool for_good)
{
    static uint64_t last;
    char id[STORE_ID_CAP];
    struct store *s;
    disk_reset(root, false);
    assert_int_equal(open_store(&disk_fs, root, &s), OK);
    assert_int_equal(hidden(store_path(root), ".tmp-"), 0);
    bool reached = fails_at(s, root, k, why, for_good);
    assert_int_equal(commit(s, 1, id), OK);
    assert_true(number(id) > last);
    last = number(id);
    store_close(s);
    return reached;
}

static void every_call_fails(void **state)
{
    (void)state;
    static const struct {
        int why;
        bool for_good;
    } kinds[] = {{ENOSPC, false}, {EDQUOT, false}, {EIO, false},
                 {EROFS, false},  {ENOSPC, true},  {EROFS, true}};
    const char *live = tmpdir_mkdir("live");
    char id[STORE_ID_CAP];
    struct store *s;
    int failures = 0;
    disk_reset(live, false);
    assert_int_equal(open_store(&disk_fs, live, &s), OK);
    for (int n = 0; n < KEEP; n++)
        assert_int_equal(commit(s, 1, id), OK);
    store_close(s);
    for (size_t i = 0; i < sizeof kinds / sizeof kinds[0]; i++)
        for (int k = 0; works_again(live, k, kinds[i].why, kinds[i].for_good); k++)
            failures++;
    printf("%d failures\n", failures);
    assert_true(failures > 500);
}

static err_t open_and_commit(void *ctx)
{
    struct store *s;
    char id[STORE_ID_CAP];
    err_t e = open_store(ctx, tmpdir_path("memory"), &s);
    if (e)
        return e;
    e = commit(s, 2, id);
    store_close(s);
    return e;
}

static void every_allocation_fails(void **state)
{
    (void)state;
    struct store_fs fs = store_fs_system;
    struct store *s;
    char ids[SEEN][STORE_ID_CAP];
    const char *root = tmpdir_mkdir("memory");
    fs.sync = no_sync;
    int refused = alloc_fail_sweep(open_and_commit, &fs);
    printf("%d allocations\n", refused);
    assert_true(refused > 20);
    assert_int_equal(open_store(&fs, root, &s), OK);
    assert_int_equal(whole_takes(s, root, ids), KEEP);
    assert_int_equal(hidden(store_path(root), ".tmp-"), 0);
    store_close(s);
}

static int setup(void **state)
{
    (void)state;
    snprintf(tmpdir_root, sizeof tmpdir_root, "/dev/shm/hdrig-test-XXXXXX");
    if (!mkdtemp(tmpdir_root)) // in memory it is a matter of seconds
        tmpdir_make();
    return 0;
}

int main(void)
{
#define EACH(f) cmocka_unit_test_setup_teardown(f, setup, tmpdir_teardown)
    const struct CMUnitTest tests[] = {EACH(power_cut_at_any_change),
                                       EACH(power_cut_after_failure),
                                       EACH(power_cut_after_taking_back),
                                       EACH(killed_at_any_call),
                                       EACH(every_call_fails),
                                       EACH(every_allocation_fails)};
    log_set_level(LOG_ERROR);
    marks = mmap(NULL, sizeof *marks, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    return cmocka_run_group_tests(tests, NULL, NULL);
}
