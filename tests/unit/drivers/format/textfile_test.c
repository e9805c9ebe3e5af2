/* Rights of what is written, files of others that stay, and what is refused. */
#include "drivers/format/textfile.h"
#include "tests/unit/tmpdir.h"

#include <dirent.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <unistd.h>

#include <cmocka.h>

static const struct textfile_rights secret = {0640, NULL, "no-such-group", false};

static unsigned mode_of(const char *name)
{
    struct stat st;
    assert_int_equal(stat(tmpdir_path(name), &st), 0);
    return st.st_mode & 0777;
}

static void assert_holds(const char *name, const char *want)
{
    char *text;
    assert_int_equal(textfile_read(tmpdir_path(name), 64, &text), OK);
    assert_string_equal(text, want);
    free(text);
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

static void rights_are_exact(void **state)
{
    (void)state;
    const struct textfile_rights open_to_all = {0644, NULL, NULL, false},
                                 kept = {0644, NULL, NULL, true};
    umask(0);
    assert_int_equal(textfile_write(tmpdir_path("a"), &secret, "one\n"), OK);
    assert_int_equal(mode_of("a"), 0600); // the group does not exist
    assert_int_equal(textfile_write(tmpdir_path("a"), &kept, "two\n"), OK);
    assert_int_equal(mode_of("a"), 0600);
    assert_holds("a", "two\n");
    umask(077);
    assert_int_equal(textfile_write(tmpdir_path("a"), &open_to_all, ""), OK);
    assert_int_equal(mode_of("a"), 0644);
    assert_holds("a", "");
    assert_int_equal(entries(), 1);
}

static void errors_leave_nothing(void **state)
{
    (void)state;
    assert_int_equal(mkdir(tmpdir_path("folder"), 0700), 0);
    assert_int_equal(textfile_write(tmpdir_path("folder"), &secret, "x"), ERR_IO);
    assert_int_equal(textfile_write(tmpdir_path("none/a"), &secret, "x"), ERR_IO);
    assert_int_equal(entries(), 1);
}

static void others_stay(void **state)
{
    (void)state;
    assert_int_equal(textfile_check(tmpdir_path("a")), OK); // nothing there
    assert_int_equal(textfile_write(tmpdir_path("a"), &secret, TEXTFILE_MARK " x\n"), OK);
    assert_int_equal(textfile_check(tmpdir_path("a")), OK);
    assert_int_equal(symlink("a", tmpdir_path("link")), 0);
    assert_int_equal(textfile_check(tmpdir_path("link")), ERR_ARG);
    assert_int_equal(textfile_check(tmpdir_root), ERR_ARG);
    assert_int_equal(textfile_write(tmpdir_path("a"), &secret, "# mine\n" TEXTFILE_MARK "\n"), OK);
    assert_int_equal(textfile_check(tmpdir_path("a")), ERR_ARG);
    assert_int_equal(textfile_write(tmpdir_path("a"), &secret, ""), OK);
    assert_int_equal(textfile_check(tmpdir_path("a")), ERR_ARG);
}

static void what_cannot_be_read(void **state)
{
    (void)state;
    char *text;
    assert_int_equal(textfile_read(tmpdir_path("none"), 64, &text), ERR_LOST);
    assert_null(text);
    assert_int_equal(textfile_read(tmpdir_root, 64, &text), ERR_IO);
    assert_int_equal(textfile_write(tmpdir_path("a"), &secret, "12345"), OK);
    assert_int_equal(textfile_read(tmpdir_path("a"), 4, &text), ERR_FORMAT);
    assert_int_equal(textfile_read(tmpdir_path("a"), 5, &text), OK);
    free(text);
    FILE *f = fopen(tmpdir_path("a"), "w");
    fwrite("1\0002", 1, 3, f);
    fclose(f);
    assert_int_equal(textfile_read(tmpdir_path("a"), 64, &text), ERR_FORMAT);
}

static int teardown(void **state)
{
    (void)state;
    tmpdir_remove();
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(rights_are_exact, tmpdir_setup, teardown),
        cmocka_unit_test_setup_teardown(errors_leave_nothing, tmpdir_setup, teardown),
        cmocka_unit_test_setup_teardown(others_stay, tmpdir_setup, teardown),
        cmocka_unit_test_setup_teardown(what_cannot_be_read, tmpdir_setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
