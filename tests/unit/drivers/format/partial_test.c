/* Files that appear when they are complete, and what processes that died left of theirs. */
#include "drivers/format/filelist.h"
#include "drivers/format/origin.h"
#include "drivers/format/partial.h"
#include "tests/unit/tmpdir.h"

#include <dirent.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmocka.h>

static struct partial p;

static int teardown(void **state)
{
    (void)state;
    partial_close(&p);
    tmpdir_remove();
    return 0;
}

static int entries(void)
{
    DIR *d = opendir(tmpdir_root);
    int n = -2; // . and ..
    while (readdir(d))
        n++;
    closedir(d);
    return n;
}

static void put(const char *path, const char *text)
{
    char at[FILE_PATH_CAP];
    assert_int_equal(partial_path(&p, path, at), OK);
    FILE *f = fopen(at, "w");
    assert_non_null(f);
    assert_true(fputs(text, f) >= 0);
    assert_int_equal(fclose(f), 0);
}

static void assert_holds(const char *name, const char *text)
{
    char got[64] = "";
    FILE *f = fopen(tmpdir_path(name), "r");
    assert_non_null(f);
    assert_non_null(fgets(got, sizeof got, f));
    fclose(f);
    assert_string_equal(got, text);
}

static const char former[] = "{\n  \"generator\": \"" ORIGIN_GENERATOR "\"}\n";

static void appears_when_shown(void **state)
{
    (void)state;
    const char *a = tmpdir_text("a.x", former), *b = tmpdir_path("b.x");
    assert_int_equal(partial_open(a, &p), OK);
    put(a, "new");
    put(b, "beside");
    put(tmpdir_path("c.x"), "never");
    assert_holds("a.x", "{\n");
    assert_false(file_exists(b));
    assert_int_equal(partial_show(&p, b), OK);
    assert_int_equal(partial_show(&p, a), OK);
    assert_int_equal(partial_show(&p, tmpdir_path("d.x")), ERR_IO);
    partial_close(&p);
    assert_holds("a.x", "new");
    assert_holds("b.x", "beside");
    assert_int_equal(entries(), 2);
    partial_close(&p);
}

/* What was not written by us stays, also if it came while we wrote. */
static void keeps_somebody_elses_file(void **state)
{
    (void)state;
    const char *a = tmpdir_path("a.json");
    assert_int_equal(partial_open(a, &p), OK);
    put(a, former);
    tmpdir_text("a.json", "{\"generator\": \"somebody\"}");
    assert_int_equal(partial_show(&p, a), ERR_ARG);
    assert_non_null(strstr(err_text(), "a.json: already exists"));
    assert_holds("a.json", "{\"generator\": \"somebody\"}");
    tmpdir_text("a.json", ""); // left by mktemp
    assert_int_equal(partial_show(&p, a), OK);
    partial_close(&p);
}

static void in_this_folder(void **state)
{
    (void)state;
    char was[FILE_PATH_CAP];
    assert_non_null(getcwd(was, sizeof was));
    assert_int_equal(chdir(tmpdir_root), 0);
    assert_int_equal(partial_open("a", &p), OK);
    put("a", "1");
    err_t e = partial_show(&p, "a");
    partial_close(&p);
    assert_int_equal(chdir(was), 0);
    assert_int_equal(e, OK);
    assert_holds("a", "1");
    assert_int_equal(entries(), 1);
}

static void folders_of_paths(void **state)
{
    (void)state;
    static const char *const cases[][3] = {
        {"a", ".", "a"},     {"/a", "/", "a"},    {"//a", "/", "a"}, {"a/b", "a", "b"},
        {"a//b", "a", "b"},  {"/a/b", "/a", "b"}, {"a/", "a", ""},   {"./a", ".", "a"},
        {"../a", "..", "a"}, {"", ".", ""},
    };
    char parent[FILE_PATH_CAP];
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        assert_int_equal(file_parent(cases[i][0], parent), OK);
        assert_string_equal(parent, cases[i][1]);
        assert_string_equal(file_name(cases[i][0]), cases[i][2]);
    }
}

static void bad_names(void **state)
{
    (void)state;
    static const char *const bad[] = {"", "a/", ".", "..", "a/..", "/"};
    char path[FILE_PATH_CAP + 64];
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++)
        assert_int_equal(partial_open(bad[i], &p), ERR_ARG);
    assert_int_equal(partial_open(tmpdir_path("none/a"), &p), ERR_IO);
    assert_non_null(strstr(err_text(), "none/a: cannot create: No such file"));
    for (size_t n = FILE_PATH_CAP - 300; n < sizeof path; n++) { // folders that do not exist
        memset(path, 'a', n);
        for (size_t k = 0; k < n; k += 100)
            path[k] = '/';
        path[n] = 0;
        err_t e = partial_open(path, &p);
        assert_true(e == ERR_ARG || e == ERR_IO);
    }
}

static void longest_name(void **state)
{
    (void)state;
    char name[256];
    struct partial other;
    memset(name, 'a', sizeof name);
    name[255] = 0;
    const char *path = tmpdir_path(name);
    assert_int_equal(partial_open(path, &p), OK);
    put(path, "long");
    assert_int_equal(partial_open(path, &other), ERR_BUSY);
    assert_int_equal(partial_show(&p, path), OK);
    partial_close(&p);
    assert_holds(name, "long");
}

/* A process that holds p, and a folder as one with its name would have left it. */
static pid_t child_of(const char *path)
{
    int ready[2];
    char c = 0;
    assert_int_equal(pipe(ready), 0);
    pid_t child = fork();
    if (child == 0) {
        c = partial_open(path, &p) == OK ? '1' : '0';
        if (write(ready[1], &c, 1) != 1)
            _exit(1);
        pause();
    }
    assert_int_equal(read(ready[0], &c, 1), 1);
    assert_int_equal(c, '1');
    close(ready[0]);
    close(ready[1]);
    return child;
}

static void removes_only_what_the_dead_left(void **state)
{
    (void)state;
    static const char *const kept[] = {".tmp-ab-1", ".tmp-a-mine", ".tmp-a-", ".tmp-a"};
    char path[128];
    snprintf(path, sizeof path, "%s/a", tmpdir_root);
    pid_t child = child_of(path);
    tmpdir_mkdir(".tmp-a-999999999"); // nobody holds it
    tmpdir_text(".tmp-a-999999999/x", "");
    tmpdir_text(".tmp-a-999999999/" FILELIST_PARTIAL, "");
    tmpdir_mkdir(".tmp-a-999999998"); // died before its mark
    tmpdir_mkdir(".tmp-a-1999");      // somebody's
    tmpdir_text(".tmp-a-1999/diary", "");
    for (size_t i = 0; i < sizeof kept / sizeof kept[0]; i++)
        tmpdir_mkdir(kept[i]);
    tmpdir_text(".tmp-a-1", "a file");
    tmpdir_mkdir("precious");
    tmpdir_text("precious/x", "");
    assert_int_equal(symlink("precious", tmpdir_path(".tmp-a-2")), 0);
    err_t e = partial_open(path, &p);
    int alive = entries();
    partial_close(&p);
    kill(child, SIGKILL);
    waitpid(child, NULL, 0);
    assert_int_equal(e, OK);
    assert_int_equal(alive, 5 + 3 + 2); // these, the child's and ours
    assert_int_equal(partial_open(path, &p), OK);
    partial_close(&p);
    assert_int_equal(entries(), 5 + 3);
    assert_true(file_is_regular(tmpdir_path(".tmp-a-1999/diary")));
    assert_true(file_is_regular(tmpdir_path("precious/x")));
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, tmpdir_setup, teardown)

int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(appears_when_shown),
        TEST(keeps_somebody_elses_file),
        TEST(in_this_folder),
        TEST(folders_of_paths),
        TEST(bad_names),
        TEST(longest_name),
        TEST(removes_only_what_the_dead_left),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
