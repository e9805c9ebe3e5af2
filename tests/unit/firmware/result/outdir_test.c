#include "drivers/format/filelist.h"
#include "firmware/result/outdir.h"
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

static int entries(const char *path)
{
    DIR *d = opendir(path);
    int n = 0;
    assert_non_null(d);
    while (readdir(d))
        n++;
    closedir(d);
    return n - 2;
}

static void put(const struct outdir *o, const char *name, const char *content)
{
    char path[FILE_PATH_CAP];
    assert_int_equal(outdir_path(o, name, path), OK);
    FILE *f = fopen(path, "w");
    assert_non_null(f);
    fputs(content, f);
    assert_int_equal(fclose(f), 0);
}

static char first_byte(const char *path)
{
    FILE *f = fopen(path, "r");
    assert_non_null(f);
    int c = getc(f);
    fclose(f);
    return (char)c;
}

static void publish(const char *path, const char *content)
{
    struct outdir o;
    assert_int_equal(outdir_open(path, NULL, &o), OK);
    assert_int_equal(outdir_mkdir(&o, "sub"), OK);
    put(&o, "sub/x", content);
    put(&o, OUTDIR_REPORT, "{}");
    assert_int_equal(outdir_commit(&o), OK);
    outdir_close(&o);
}

static void appears_when_complete(void **state)
{
    (void)state;
    struct outdir o;
    const char *path = tmpdir_path("deep/er/out");
    assert_int_equal(outdir_open(path, NULL, &o), OK);
    put(&o, OUTDIR_REPORT, "{}");
    assert_false(file_is_dir(path));
    assert_int_equal(outdir_commit(&o), OK);
    outdir_close(&o);
    assert_true(file_is_regular(tmpdir_path("deep/er/out/report.json")));
    assert_int_equal(entries(tmpdir_path("deep/er")), 1);
}

static void without_commit_nothing(void **state)
{
    (void)state;
    struct outdir o;
    assert_int_equal(outdir_open(tmpdir_path("out"), NULL, &o), OK);
    put(&o, "x", "1");
    outdir_close(&o);
    outdir_close(&o);
    assert_int_equal(entries(tmpdir_path(".")), 0);
}

static void replaces_results_and_empty_folders(void **state)
{
    (void)state;
    const char *path = tmpdir_path("out//");
    tmpdir_mkdir("out");
    publish(path, "1");
    publish(path, "2");
    assert_int_equal(first_byte(tmpdir_path("out/sub/x")), '2');
    assert_int_equal(entries(tmpdir_path(".")), 1);
}

static void keeps_what_is_not_ours(void **state)
{
    (void)state;
    struct outdir o;
    tmpdir_mkdir("photos");
    tmpdir_text("photos/a.jpg", "precious");
    tmpdir_text("file", "precious");
    assert_int_equal(outdir_open(tmpdir_path("photos"), NULL, &o), ERR_ARG);
    assert_non_null(strstr(err_text(), "photos"));
    assert_int_equal(outdir_open(tmpdir_path("file"), NULL, &o), ERR_ARG);
    publish(tmpdir_path("result"), "1");
    assert_int_equal(symlink("result", tmpdir_path("link")), 0);
    assert_int_equal(outdir_open(tmpdir_path("link"), NULL, &o), ERR_ARG);
    assert_int_equal(outdir_open("/", NULL, &o), ERR_ARG);
    assert_int_equal(outdir_open("", NULL, &o), ERR_ARG);
    assert_int_equal(outdir_open("..", NULL, &o), ERR_ARG);
    assert_int_equal(outdir_open(tmpdir_path("photos/."), NULL, &o), ERR_ARG);
    assert_int_equal(outdir_open(tmpdir_path("file/out"), NULL, &o), ERR_IO);
    assert_int_equal(entries(tmpdir_path(".")), 4);
}

/* A folder that gained a stranger's files while we worked is not replaced. */
static void looks_again_before_it_replaces(void **state)
{
    (void)state;
    struct outdir o;
    assert_int_equal(outdir_open(tmpdir_path("out"), NULL, &o), OK);
    put(&o, OUTDIR_REPORT, "{}");
    tmpdir_mkdir("out");
    tmpdir_text("out/stranger", "precious");
    assert_int_equal(outdir_commit(&o), ERR_ARG);
    outdir_close(&o);
    assert_int_equal(entries(tmpdir_path("out")), 1);
    assert_int_equal(entries(tmpdir_path(".")), 1);
}

static err_t open_at(const char *path, const struct outdir_rules *rules)
{
    struct outdir o;
    err_t e = outdir_open(path, rules, &o);
    outdir_close(&o);
    return e;
}

/* A report.json makes no result, nor does somebody's own list of hashes. */
static void keeps_foreign_folders(void **state)
{
    (void)state;
    const struct outdir_rules force = {.force = true};
    tmpdir_mkdir("thesis");
    tmpdir_text("thesis/report.json", "{}");
    tmpdir_text("thesis/thesis.txt", "precious");
    assert_int_equal(open_at(tmpdir_path("thesis"), &force), ERR_ARG);
    tmpdir_text("thesis/" FILELIST_NAME, "# my own\n");
    assert_int_equal(open_at(tmpdir_path("thesis"), &force), ERR_ARG);
    assert_non_null(strstr(err_text(), "was not written by hdrig"));
    assert_int_equal(entries(tmpdir_path("thesis")), 3);
}

/* Notes, edited files, links and folders in a result of ours. */
static void keeps_what_was_added(void **state)
{
    (void)state;
    static const char *const added[] = {"out/notes.txt", "out/sub/notes.txt", "out/report.txt"};
    const struct outdir_rules force = {.force = true};
    char path[512];
    snprintf(path, sizeof path, "%s", tmpdir_path("out"));
    publish(path, "1");
    for (int i = 0; i < 3; i++) {
        tmpdir_text(added[i], "mine");
        assert_int_equal(open_at(path, &force), ERR_ARG);
        assert_non_null(strstr(err_text(), added[i]));
        assert_int_equal(unlink(tmpdir_path(added[i])), 0);
    }
    tmpdir_mkdir("out/empty");
    assert_int_equal(open_at(path, &force), ERR_ARG);
    assert_int_equal(rmdir(tmpdir_path("out/empty")), 0);
    assert_int_equal(unlink(tmpdir_path("out/sub/x")), 0);
    assert_int_equal(symlink("../report.json", tmpdir_path("out/sub/x")), 0);
    assert_int_equal(open_at(path, &force), ERR_ARG);
    assert_int_equal(unlink(tmpdir_path("out/sub/x")), 0);
    assert_int_equal(open_at(path, NULL), OK); // less than was written is fine
    tmpdir_text("out/sub/x", "edited");
    assert_int_equal(open_at(path, NULL), ERR_ARG);
    assert_non_null(strstr(err_text(), "out/sub/x: was changed"));
    assert_int_equal(open_at(path, &force), OK);
    assert_int_equal(first_byte(tmpdir_path("out/sub/x")), 'e');
}

static void keeps_inputs(void **state)
{
    (void)state;
    char inputs[4][512];
    struct outdir_rules rules = {.force = true};
    publish(tmpdir_path("in"), "1");
    publish(tmpdir_path("out"), "1");
    assert_int_equal(symlink("in", tmpdir_path("link")), 0);
    for (int i = 0; i < 4; i++) {
        static const char *const names[] = {"in", "in/.", "in/sub/x", "link"};
        snprintf(inputs[i], sizeof inputs[i], "%s", tmpdir_path(names[i]));
        rules.inputs[OUTDIR_INPUTS - 1] = inputs[i];
        assert_int_equal(open_at(tmpdir_path("in"), &rules), ERR_ARG);
        assert_non_null(strstr(err_text(), "a folder of its own"));
        assert_int_equal(open_at(tmpdir_path("out"), &rules), OK);
        assert_int_equal(open_at(tmpdir_path("in/new"), &rules), OK); // beside its files
    }
}

static void names_with_line_breaks(void **state)
{
    (void)state;
    struct outdir o;
    const char *path = tmpdir_path("out");
    for (int i = 0; i < 2; i++) {
        assert_int_equal(outdir_open(path, NULL, &o), OK);
        put(&o, "a\nb\\c", "1");
        put(&o, "n", "2");
        assert_int_equal(outdir_commit(&o), OK);
        outdir_close(&o);
    }
    assert_int_equal(entries(path), 3);
}

static void removes_only_what_the_dead_left(void **state)
{
    (void)state;
    struct outdir o;
    int ready[2];
    assert_int_equal(pipe(ready), 0);
    pid_t child = fork();
    if (child == 0) {
        bool ok = outdir_open(tmpdir_path("out"), NULL, &o) == OK;
        if (write(ready[1], ok ? "1" : "0", 1) != 1)
            _exit(1);
        pause();
    }
    char c = 0;
    assert_int_equal(read(ready[0], &c, 1), 1);
    assert_int_equal(c, '1');
    tmpdir_mkdir(".tmp-out-999999999"); // nobody holds it
    tmpdir_text(".tmp-out-999999999/x", "");
    tmpdir_text(".tmp-out-999999999/" FILELIST_PARTIAL, "");
    tmpdir_mkdir(".tmp-output-1"); // belongs to another name
    tmpdir_mkdir(".tmp-out-mine");
    assert_int_equal(outdir_open(tmpdir_path("out"), NULL, &o), OK);
    assert_int_equal(entries(tmpdir_path(".")), 4); // child's, ours, the two others
    outdir_close(&o);
    kill(child, SIGKILL);
    waitpid(child, NULL, 0);
    close(ready[0]);
    close(ready[1]);
    assert_int_equal(outdir_open(tmpdir_path("out"), NULL, &o), OK);
    outdir_close(&o);
    assert_int_equal(entries(tmpdir_path(".")), 2);
}

static void report_of_the_folder(void **state)
{
    (void)state;
    struct outdir o;
    struct report rep;
    char text[64] = "";
    assert_int_equal(outdir_open(tmpdir_path("out"), NULL, &o), OK);
    assert_int_equal(outdir_report_open(&o, &rep), OK);
    report_int(&rep, "n", 1);
    assert_int_equal(outdir_report_close(&o, &rep), OK);
    assert_int_equal(outdir_commit(&o), OK);
    outdir_close(&o);
    FILE *f = fopen(tmpdir_path("out/report.json"), "r");
    assert_non_null(f);
    assert_true(fread(text, 1, sizeof text - 1, f) > 0);
    fclose(f);
    assert_string_equal(text, "{\n  \"generator\": \"hdrig\",\n  \"n\": 1\n}\n");
}

static void tells_missing_space(void **state)
{
    (void)state;
    struct outdir o;
    assert_int_equal(outdir_open(tmpdir_path("out"), NULL, &o), OK);
    assert_int_equal(outdir_reserve(&o, 1), OK);
    assert_int_equal(outdir_reason(&o, err_fail(ERR_IO, "x: broken disk")), ERR_IO);
    assert_int_equal(outdir_reason(&o, OK), OK);
    assert_int_equal(outdir_reason(&o, ERR_FORMAT), ERR_FORMAT);
    assert_int_equal(outdir_reserve(&o, UINT64_MAX), ERR_LIMIT);
    assert_non_null(strstr(err_text(), "18446744073709551615 bytes"));
    assert_int_equal(outdir_reason(&o, err_fail(ERR_IO, "y: no space left")), ERR_LIMIT);
    assert_non_null(strstr(err_text(), "y: no space left ("));
    outdir_close(&o);
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, tmpdir_setup, tmpdir_teardown)

int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(appears_when_complete),
        TEST(without_commit_nothing),
        TEST(replaces_results_and_empty_folders),
        TEST(keeps_what_is_not_ours),
        TEST(looks_again_before_it_replaces),
        TEST(keeps_foreign_folders),
        TEST(keeps_what_was_added),
        TEST(keeps_inputs),
        TEST(names_with_line_breaks),
        TEST(removes_only_what_the_dead_left),
        TEST(report_of_the_folder),
        TEST(tells_missing_space),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
