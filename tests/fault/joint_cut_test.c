/* The conductor's store when the disk fails, the process is killed or the power is cut while a
 * joint take is ordered, collected, committed and its part released: the joint take is whole, or
 * what it is made of is. */
#include "core/base/log.h"
#include "firmware/store/joint.h"
#include "tests/fault/alloc_fail.h"
#include "tests/fault/disk_model.h"
#include "tests/unit/small_rig.h"
#include "tests/unit/tmpdir.h"

#include <dirent.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/mman.h>
#include <sys/wait.h>

#include <cmocka.h>

enum { SEEDS = 6, MEMBERS = 2 };

static const char order[] = "{\"order\": [1, 2, 3]}";
static const char *const names[MEMBERS] = {"b0", "b1"}; // b0 is the conductor
static char *part_path;                                 // of b1, on its own disk; shared as well

/* What has returned, by the changes that the disk had seen then; shared with children. */
enum step { RESERVED, STORED, BEGUN, STAGED, JOINED, RELEASED, STEPS };
static struct marks {
    int done; // steps
    int changes[STEPS];
    char id[STORE_ID_CAP], part[STORE_ID_CAP];
} * marks;

static int cuts, joined, collected;
static bool lazy; // what is fetched is not synced

static const char *store_path(const char *root)
{
    static char path[600];
    snprintf(path, sizeof path, "%s/s", root);
    return path;
}

static err_t open_store(const struct store_fs *fs, const char *path, struct store **s)
{
    const struct store_config cfg = {.path = path};
    return store_open_on(fs, &cfg, s);
}

static int no_sync(int fd)
{
    (void)fd;
    return 0;
}

static struct store_fs quick_fs(void)
{
    struct store_fs fs = store_fs_system;
    fs.sync = no_sync;
    return fs;
}

static void step_done(enum step step)
{
    marks->changes[step] = disk.changes;
    marks->done = step + 1;
}

static err_t commit_part(struct store *s, const char *rig_take, const char *member,
                         char id[STORE_ID_CAP])
{
    struct take *t = small_part(1, 1, CAMERA_GREY16, rig_take, member);
    err_t e = store_commit(s, t, id);
    take_free(t);
    return e;
}

/* The other board stores its part; once, since the number is the first of an empty store. */
static void other_board(const char *rig_take)
{
    const struct store_fs fs = quick_fs();
    char id[STORE_ID_CAP];
    struct store *s;
    if (part_path[0])
        return;
    if (open_store(&fs, tmpdir_path("b1"), &s) != OK || commit_part(s, rig_take, "b1", id) != OK)
        abort();
    store_close(s);
    snprintf(part_path, FILE_PATH_CAP, "%s/%s", tmpdir_path("b1"), id);
}

/* What a conductor has to do that wants it durable. */
static err_t sync_staged(const struct store_fs *fs, const char *path, const char *member)
{
    static const char *const folders[] = {"", "images", "raw", "merged"};
    char dir[FILE_PATH_CAP], folder[FILE_PATH_CAP];
    err_t e = joint_part_path(path, marks->id, member, dir);
    for (int i = 0; i < 4 && !e; i++) {
        e = file_join(dir, folders[i], folder);
        if (!e)
            e = store_fs_sync_dir(fs, folder);
    }
    return e;
}

static err_t collect(const struct store_fs *fs, const char *path, struct store *s)
{
    struct store_fs fetch = *fs;
    char dir[FILE_PATH_CAP], staging[FILE_PATH_CAP];
    if (lazy)
        fetch.sync = no_sync;
    err_t e = small_rig_fetch(&fetch, s, path, marks->id, "b1", part_path);
    if (!e)
        e = joint_part_own(s, marks->id, "b0", marks->part);
    for (int i = 0; i < MEMBERS && !e; i++)
        e = sync_staged(fs, path, names[i]);
    if (!e)
        e = joint_part_path(path, marks->id, "b0", dir);
    if (!e)
        e = file_parent(dir, staging);
    return e ? e : store_fs_sync_dir(fs, staging);
}

static err_t join(struct store *s)
{
    const struct joint j = {.id = marks->id, .n = MEMBERS, .member = names};
    return joint_commit(s, &j);
}

static err_t one_press(const char *path, struct store *s)
{
    err_t e = store_reserve(s, marks->id);
    if (e)
        return e;
    step_done(RESERVED);
    other_board(marks->id);
    e = commit_part(s, marks->id, "b0", marks->part);
    if (e)
        return e;
    step_done(STORED);
    e = joint_begin(s, marks->id, order);
    if (e)
        return e;
    step_done(BEGUN);
    e = collect(&disk_fs, path, s);
    if (e)
        return e;
    step_done(STAGED);
    e = join(s);
    if (e)
        return e;
    step_done(JOINED);
    e = store_release(s, marks->id);
    if (!e)
        step_done(RELEASED);
    return e;
}

static void life(const char *root)
{
    const char *path = store_path(root);
    struct store *s;
    marks->done = 0;
    if (open_store(&disk_fs, path, &s) != OK)
        return;
    if (one_press(path, s) != OK)
        disk.fail_at = -1;
    store_close(s);
}

/* ---- what must hold ---- */

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

static bool verified(const char *store, const char *id)
{
    char path[FILE_PATH_CAP];
    if (file_join(store, id, path) != OK || !file_is_dir(path))
        return false;
    if (store_verify(path) != OK)
        fail_msg("%s", err_text());
    return true;
}

static void order_is_whole(const char *path)
{
    char *text;
    if (joint_order(path, marks->id, &text) != OK)
        fail_msg("%s", err_text());
    assert_string_equal(text, order);
    free(text);
}

/* The conductor goes on: what was staged durably is enough, else it collects again. */
static void finish(const struct store_fs *fs, const char *path, struct store *s, int done)
{
    struct store_part part;
    if (join(s) == OK) {
        collected++;
        return;
    }
    if (done > STAGED && !lazy)
        fail_msg("what was staged is not whole: %s", err_text());
    if (joint_drop(s, marks->id) != OK || joint_begin(s, marks->id, order) != OK)
        fail_msg("%s", err_text());
    assert_int_equal(store_parts(path, &part, 1), 1);
    snprintf(marks->part, sizeof marks->part, "%s", part.id);
    if (collect(fs, path, s) != OK || join(s) != OK)
        fail_msg("%s", err_text());
}

/* What is found after a cut, when so many steps had returned. */
static void recovers(const char *root, int done)
{
    const struct store_fs fs = quick_fs();
    const char *path = store_path(root);
    struct store *s;
    struct store_part parts[4];
    char ids[4][STORE_ID_CAP], id[STORE_ID_CAP];
    bool is_aborted;
    if (open_store(&fs, path, &s) != OK)
        fail_msg("%s", err_text());
    assert_int_equal(hidden(path, ".tmp-"), 0);
    assert_int_equal(hidden(path, "damaged-"), 0);
    bool exists = marks->id[0] && verified(path, marks->id);
    int staged = joint_pending(path, ids, 4), held = store_parts(path, parts, 4);
    joined += exists;
    assert_int_equal(hidden(path, ".rig-"), staged);
    assert_true(exists || done <= JOINED);
    assert_true(staged == 0 || !exists);
    assert_true(staged == 1 || exists || done <= BEGUN);
    assert_true(held == 1 || exists || done <= STORED);
    assert_true(held == 0 || done <= RELEASED);
    if (held)
        assert_true(verified(path, parts[0].id));
    if (staged) {
        assert_string_equal(ids[0], marks->id);
        order_is_whole(path);
        finish(&fs, path, s, done);
        assert_true(verified(path, marks->id));
        assert_int_equal(hidden(path, ".rig-"), 0);
    }
    if (store_reserve(s, id) != OK)
        fail_msg("%s", err_text());
    if (done > RESERVED)
        assert_true(store_number(id, &is_aborted) > store_number(marks->id, &is_aborted));
    store_close(s);
    cuts++;
}

static void remove_root(const char *root)
{
    nftw(root, tmpdir_forget, 8, FTW_DEPTH | FTW_PHYS);
}

static void power_cut(const char *root, struct disk_cut cut)
{
    const struct marks was = *marks;
    int done = 0;
    while (done < marks->done && marks->changes[done] <= cut.changes)
        done++;
    disk_put(&cut, 0, root);
    recovers(root, done);
    remove_root(root);
    *marks = was;
}

/* ---- the tests ---- */

static void power_cut_at_any_change(void **state)
{
    (void)state;
    char live[512];
    snprintf(live, sizeof live, "%s", tmpdir_path("live"));
    for (int i = 0; i < 2; i++) {
        assert_int_equal(mkdir(live, 0777), 0);
        lazy = i == 1;
        disk_reset(live, true);
        life(live);
        assert_int_equal(marks->done, STEPS);
        cuts = joined = collected = 0;
        for (int k = 0; k <= disk.changes; k++)
            for (uint64_t seed = 0; seed < SEEDS; seed++)
                power_cut(tmpdir_path("after"), (struct disk_cut){k, seed});
        printf("%d power cuts after %d changes: %d with the take, %d with all parts\n", cuts,
               disk.changes, joined, collected);
        assert_true(cuts > 500 && joined > 100 && collected > 20);
        remove_root(live);
    }
}

static void killed_at_any_call(void **state)
{
    (void)state;
    const char *live = tmpdir_path("live");
    cuts = joined = collected = 0;
    for (int k = 0;; k++) {
        int status;
        assert_int_equal(mkdir(live, 0777), 0);
        disk_reset(live, true);
        disk.kill_at = k;
        memset(marks, 0, sizeof *marks);
        pid_t pid = fork();
        if (pid == 0) {
            life(live);
            _exit(0);
        }
        assert_int_equal(waitpid(pid, &status, 0), pid);
        if (WIFSIGNALED(status))
            recovers(live, marks->done);
        remove_root(live);
        if (WIFEXITED(status))
            break;
    }
    printf("%d kills: %d with the take, %d with all parts\n", cuts, joined, collected);
    assert_true(cuts > 200 && joined > 30 && collected > 30);
}

/* A call of joint_commit fails: nothing of the take is left. The conductor tries again, what is
 * missing is fetched again, and the power is cut. Returns false if the call was not reached. */
static bool fails_and_goes_on(const char *root, int k, int why)
{
    char live[512];
    const char *path = store_path(root);
    const struct joint j = {.id = marks->id, .n = MEMBERS, .member = names};
    struct store *s;
    snprintf(live, sizeof live, "%s", root);
    assert_int_equal(mkdir(live, 0777), 0);
    disk_reset(live, true);
    assert_int_equal(open_store(&disk_fs, path, &s), OK);
    assert_int_equal(store_reserve(s, marks->id), OK);
    other_board(marks->id);
    assert_int_equal(commit_part(s, marks->id, "b0", marks->part), OK);
    assert_int_equal(joint_begin(s, marks->id, order), OK);
    assert_int_equal(collect(&disk_fs, path, s), OK);
    disk.calls = 0;
    disk.fail_at = k;
    disk.why = why;
    err_t e = joint_commit(s, &j);
    const bool reached = disk.failed;
    disk.fail_at = -1;
    if (e) {
        assert_true(reached && *err_text());
        assert_int_equal(hidden(path, ".tmp-"), 0);
        assert_false(verified(path, marks->id));
        order_is_whole(path);
        if (joint_commit(s, &j) != OK) { // a file that could not be synced
            assert_int_equal(joint_drop(s, marks->id), OK);
            assert_int_equal(joint_begin(s, marks->id, order), OK);
            assert_int_equal(collect(&disk_fs, path, s), OK);
            assert_int_equal(joint_commit(s, &j), OK);
        }
    }
    marks->done = 0;
    for (int i = 0; i <= JOINED; i++)
        step_done(i);
    store_close(s);
    for (uint64_t seed = 1; seed < 4; seed++)
        power_cut(tmpdir_path("after"), (struct disk_cut){disk.changes, seed});
    remove_root(live);
    return reached;
}

static void every_call_fails(void **state)
{
    (void)state;
    static const int kinds[] = {EIO, ENOSPC};
    int failures = 0;
    cuts = 0;
    lazy = true;
    for (int i = 0; i < 2; i++)
        for (int k = 0; fails_and_goes_on(tmpdir_path("live"), k, kinds[i]); k++)
            failures++;
    printf("%d failures, %d power cuts after them\n", failures, cuts);
    assert_true(failures > 100);
}

/* The staging folder stays, for the next run. */
static int rename_but_staging(const char *from, const char *to, unsigned flags)
{
    if (!strstr(to, ".tmp-rig-"))
        return renameat2(AT_FDCWD, from, AT_FDCWD, to, flags);
    errno = EIO;
    return -1;
}

static err_t open_and_join(void *ctx)
{
    const char *path = tmpdir_path("memory");
    char take[FILE_PATH_CAP];
    struct store *s;
    err_t e = open_store(ctx, path, &s);
    if (e)
        return e;
    e = join(s);
    store_close(s);
    snprintf(take, sizeof take, "%s/%s", path, marks->id);
    for (int i = 0; i < 2 && !e; i++) // one of both has the memory that it needs
        nftw(take, tmpdir_forget, 8, FTW_DEPTH | FTW_PHYS);
    return e;
}

static void every_allocation_fails(void **state)
{
    (void)state;
    struct store_fs fs = quick_fs();
    const char *path = tmpdir_path("memory");
    struct store *s;
    assert_int_equal(open_store(&fs, path, &s), OK);
    assert_int_equal(store_reserve(s, marks->id), OK);
    other_board(marks->id);
    assert_int_equal(commit_part(s, marks->id, "b0", marks->part), OK);
    assert_int_equal(joint_begin(s, marks->id, order), OK);
    assert_int_equal(collect(&fs, path, s), OK);
    store_close(s);
    fs.rename = rename_but_staging;
    int refused = alloc_fail_sweep(open_and_join, &fs);
    printf("%d allocations\n", refused);
    assert_true(refused > 20);
    fs.rename = store_fs_system.rename;
    assert_int_equal(open_store(&fs, path, &s), OK);
    assert_int_equal(hidden(path, ".tmp-"), 0);
    assert_int_equal(join(s), OK);
    assert_true(verified(path, marks->id));
    store_close(s);
}

static int setup(void **state)
{
    (void)state;
    snprintf(tmpdir_root, sizeof tmpdir_root, "/dev/shm/hdrig-test-XXXXXX");
    if (!mkdtemp(tmpdir_root)) // in memory it is a matter of seconds
        tmpdir_make();
    memset(marks, 0, sizeof *marks);
    part_path[0] = 0;
    lazy = false;
    return 0;
}

int main(void)
{
#define EACH(f) cmocka_unit_test_setup_teardown(f, setup, tmpdir_teardown)
    const struct CMUnitTest tests[] = {EACH(power_cut_at_any_change), EACH(killed_at_any_call),
                                       EACH(every_call_fails), EACH(every_allocation_fails)};
    const int flags = MAP_SHARED | MAP_ANONYMOUS;
    log_set_level(LOG_ERROR);
    marks = mmap(NULL, sizeof *marks, PROT_READ | PROT_WRITE, flags, -1, 0);
    part_path = mmap(NULL, FILE_PATH_CAP, PROT_READ | PROT_WRITE, flags, -1, 0);
    return cmocka_run_group_tests(tests, NULL, NULL);
}
