/* The queue of reconstructions, with shell scripts in the place of hdrig. */
#include "firmware/daemon/jobs.h"

#include "drivers/format/file.h"
#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

static struct jobs *j;
static struct jobs_state s;

static int set_up(void **state)
{
    (void)state;
    tmpdir_make();
    j = NULL;
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    jobs_close(j);
    tmpdir_remove();
    return 0;
}

static const char *launcher;

static void open_with(const char *script)
{
    char program[300], captures[300], results[300];
    tmpdir_text("prog", script);
    snprintf(program, sizeof program, "%s", tmpdir_path("prog"));
    snprintf(captures, sizeof captures, "%s", tmpdir_path("captures"));
    snprintf(results, sizeof results, "%s", tmpdir_path("results"));
    assert_int_equal(chmod(program, 0755), 0);
    struct jobs_config c = {program, captures, results, NULL, launcher};
    assert_int_equal(jobs_open(&c, &j), OK);
}

/* Run the loop until nothing runs, or a line of the child is `line`. */
static void run_until(const char *line)
{
    for (int i = 0; i < 3000; i++) {
        struct pollfd p[JOBS_FDS];
        jobs_step(j);
        jobs_look(j, &s);
        if (line ? strcmp(s.line, line) == 0 : !s.running && !s.waiting)
            return;
        poll(p, (nfds_t)jobs_poll(j, p, JOBS_FDS), 20);
    }
    fail_msg("never: %s", line ? line : "idle");
}

static bool pending(const char *id)
{
    char name[64];
    snprintf(name, sizeof name, "results/%s.pending", id);
    return file_exists(tmpdir_path(name));
}

static void a_launcher_starts_the_program(void **state)
{
    char text[300];
    (void)state;
    launcher = "env  HOSTS=2 nice ";
    open_with("#!/bin/sh\necho \"$HOSTS $1 $2 "
              "$OMPI_MCA_oob_tcp_keepalive_time $PRTE_MCA_oob_tcp_keepalive_probes\" >&2\n");
    launcher = NULL;
    assert_int_equal(jobs_add(j, "take-1"), OK);
    run_until(NULL);
    assert_int_equal(s.last, JOBS_DONE);
    assert_string_equal(s.last_line, "2 reconstruct --images 10 4");
    jobs_close(j);
    memset(text, 0, sizeof text);
    for (int i = 0; i < 33; i++)
        strcat(text, "a ");
    struct jobs_config c = {"p", tmpdir_path("captures"), tmpdir_path("results"), NULL, text};
    assert_int_equal(jobs_open(&c, &j), ERR_ARG);
    assert_non_null(strstr(err_text(), "job.launcher has 33 words, at most 32"));
}

static void one_after_the_other(void **state)
{
    (void)state;
    open_with(
        "#!/bin/sh\necho \"$@\" >>${5%/*}/log\necho part >&2\nprintf 'end of %s\\n' $5 >&2\n");
    jobs_look(j, &s);
    assert_true(!s.running && s.last == JOBS_NONE);
    assert_int_equal(jobs_add(j, "b-2"), OK);
    assert_int_equal(jobs_add(j, "a-1"), OK);
    assert_true(pending("b-2") && pending("a-1"));
    run_until(NULL);
    assert_int_equal(s.last, JOBS_DONE);
    assert_string_equal(s.last_id, "a-1");
    assert_non_null(strstr(s.last_line, "results/a-1"));
    assert_false(pending("b-2") || pending("a-1"));
    char text[1000];
    FILE *f = fopen(tmpdir_path("results/log"), "r");
    assert_non_null(f);
    assert_non_null(fgets(text, sizeof text, f));
    assert_non_null(strstr(text, "reconstruct --images "));
    assert_non_null(strstr(text, "captures/b-2 --out "));
    fclose(f);
}

static void put_place(const char *id, const char *session)
{
    char name[80], text[80];
    snprintf(name, sizeof name, "captures/%s", id);
    tmpdir_mkdir(name);
    snprintf(name, sizeof name, "captures/%s/manifest.json", id);
    snprintf(text, sizeof text, "{\"session\": \"%s\"}", session);
    tmpdir_text(name, text);
}

/* All places of the session that are there when its reconstruction begins. A session that goes on
 * can wait once behind itself. */
static void a_session_is_one_scene(void **state)
{
    (void)state;
    open_with("#!/bin/sh\nfor x; do last=$x; done\necho \"$@\" | sed 's|/[^ ]*/||g' "
              ">>$last.log\necho begun >&2\nwhile [ ! -e $last.go ]; do sleep 0.02; done\n");
    tmpdir_mkdir("captures");
    put_place("00000001-000004", "00000001-000004"); // another session
    put_place("00000001-000005", "00000001-000005");
    put_place("00000002-000007", "00000001-000005"); // after a reboot
    assert_int_equal(jobs_add(j, "00000001-000005"), OK);
    run_until("begun");
    put_place("00000002-000008", "00000001-000005");
    assert_int_equal(jobs_add(j, "00000001-000005"), OK);
    assert_int_equal(jobs_add(j, "00000001-000005"), OK);
    jobs_look(j, &s);
    assert_int_equal(s.waiting, 1);
    tmpdir_text("results/00000001-000005.go", "");
    run_until(NULL);
    assert_int_equal(s.last, JOBS_DONE);
    assert_false(pending("00000001-000005"));
    struct file_map m;
    static const char want[] =
        "reconstruct --images 00000001-000005 --images 00000002-000007 --out 00000001-000005\n"
        "reconstruct --images 00000001-000005 --images 00000002-000007 --images 00000002-000008 "
        "--out 00000001-000005\n";
    assert_int_equal(file_map(tmpdir_path("results/00000001-000005.log"), 4096, &m), OK);
    assert_int_equal(m.n, sizeof want - 1);
    assert_memory_equal(m.p, want, m.n);
    file_unmap(&m);
}

static void failures_do_not_stop_the_queue(void **state)
{
    (void)state;
    open_with("#!/bin/sh\ncase $5 in *bad) echo no light >&2; exit 1;; *dead) kill -9 $$;; esac\n");
    assert_int_equal(jobs_add(j, "bad"), OK);
    run_until(NULL);
    assert_int_equal(s.last, JOBS_FAILED);
    assert_string_equal(s.last_line, "no light");
    assert_int_equal(jobs_add(j, "dead"), OK);
    run_until(NULL);
    assert_int_equal(s.last, JOBS_FAILED);
    assert_string_equal(s.last_line, "killed by signal 9");
    assert_int_equal(jobs_add(j, "good"), OK);
    run_until(NULL);
    assert_int_equal(s.last, JOBS_DONE);
    unlink(tmpdir_path("prog"));
    assert_int_equal(jobs_add(j, "gone"), OK);
    run_until(NULL);
    assert_int_equal(s.last, JOBS_FAILED);
    assert_non_null(strstr(s.last_line, "No such file"));
}

/* The warnings of a scene are counted, and are not its last line. */
static void warnings_are_counted(void **state)
{
    (void)state;
    open_with(
        "#!/bin/sh\necho working >&2\ncase $5 in *two) "
        "echo 'hdrig reconstruct: warning: a' >&2; echo 'hdrig reconstruct: warning: b' >&2;; "
        "esac\n");
    assert_int_equal(jobs_add(j, "two"), OK);
    run_until(NULL);
    assert_int_equal(s.last_warnings, 2);
    assert_string_equal(s.last_line, "working");
    assert_int_equal(jobs_add(j, "none"), OK);
    run_until(NULL);
    assert_int_equal(s.last_warnings, 0);
}

/* A file that only has the name of a pending one is neither run nor removed nor written. */
static void somebody_elses_pending_file(void **state)
{
    (void)state;
    char results[300];
    snprintf(results, sizeof results, "%s", tmpdir_path("results"));
    assert_int_equal(mkdir(results, 0777), 0);
    tmpdir_text("results/diary.pending", "mine\n");
    open_with("#!/bin/sh\necho ran >&2\n");
    run_until(NULL);
    assert_int_equal(s.last, JOBS_NONE);
    assert_int_equal(jobs_add(j, "diary"), ERR_ARG);
    run_until(NULL);
    assert_true(pending("diary"));
}

static const char sleeper[] = "#!/bin/sh\ntrap 'exit 130' TERM\necho asleep >&2\n"
                              "while :; do sleep 0.02; done\n";

static void cancelling(void **state)
{
    (void)state;
    open_with(sleeper);
    jobs_cancel(j); // nothing runs
    assert_int_equal(jobs_add(j, "x"), OK);
    run_until("asleep");
    assert_true(s.running);
    assert_string_equal(s.id, "x");
    jobs_cancel(j);
    run_until(NULL);
    assert_int_equal(s.last, JOBS_CANCELLED);
    assert_false(pending("x"));
}

static void what_waits_survives_the_daemon(void **state)
{
    (void)state;
    open_with(sleeper);
    assert_int_equal(jobs_add(j, "boot-000002"), OK);
    assert_int_equal(jobs_add(j, "boot-000001"), OK);
    run_until("asleep");
    jobs_close(j);
    j = NULL;
    assert_true(pending("boot-000002") && pending("boot-000001"));
    tmpdir_text("results/.pending", "");
    tmpdir_text("results/0123456789012345678901234567890123456789.pending", "");
    open_with("#!/bin/sh\necho ran >&2\n");
    jobs_look(j, &s);
    assert_int_equal(s.waiting, 2);
    jobs_step(j);
    jobs_look(j, &s);
    assert_string_equal(s.id, "boot-000001");
    run_until(NULL);
    assert_string_equal(s.last_id, "boot-000002");
}

static void put_checkpoint(void)
{
    tmpdir_text("results/.a-1.checkpoint",
                "hdrig checkpoint"
                "0123456789012345678901234567890123456789012345678901234567890123"
                "0123456789012345678901234567890123456789012345678901234567890123");
}

static bool has_checkpoint(void)
{
    return file_exists(tmpdir_path("results/.a-1.checkpoint"));
}

/* With a checkpoint a job goes on from it; if that fails, it begins again. */
static void going_on(void **state)
{
    (void)state;
    char log[300];
    open_with("#!/bin/sh\nlog=${5%/*}/log\necho \"$6\" >>$log\n"
              "[ \"$6\" != --resume ] || exit 1\n");
    put_checkpoint();
    assert_int_equal(jobs_add(j, "a-1"), OK);
    run_until(NULL);
    assert_int_equal(s.last, JOBS_DONE);
    assert_false(has_checkpoint() || pending("a-1"));
    snprintf(log, sizeof log, "%s", tmpdir_path("results/log"));
    FILE *f = fopen(log, "r");
    char line[2][80] = {"", ""};
    assert_non_null(f);
    assert_true(fgets(line[0], sizeof line[0], f) && fgets(line[1], sizeof line[1], f));
    fclose(f);
    assert_string_equal(line[0], "--resume\n");
    assert_string_equal(line[1], "\n");
}

/* One that the user ends is not needed any more. */
static void cancelling_forgets(void **state)
{
    (void)state;
    open_with("#!/bin/sh\necho begun >&2\nexec sleep 30\n");
    put_checkpoint();
    assert_int_equal(jobs_add(j, "a-1"), OK);
    run_until("begun");
    jobs_cancel(j);
    run_until(NULL);
    assert_int_equal(s.last, JOBS_CANCELLED);
    assert_false(has_checkpoint());
}

static void the_queue_is_bounded(void **state)
{
    (void)state;
    char id[32];
    open_with(sleeper);
    for (int i = 0; i < JOBS_MAX; i++) {
        snprintf(id, sizeof id, "t-%06d", i);
        assert_int_equal(jobs_add(j, id), OK);
    }
    assert_int_equal(jobs_add(j, "more"), ERR_LIMIT);
    assert_false(pending("more"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_launcher_starts_the_program, set_up, tear_down),
        cmocka_unit_test_setup_teardown(one_after_the_other, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_session_is_one_scene, set_up, tear_down),
        cmocka_unit_test_setup_teardown(failures_do_not_stop_the_queue, set_up, tear_down),
        cmocka_unit_test_setup_teardown(warnings_are_counted, set_up, tear_down),
        cmocka_unit_test_setup_teardown(somebody_elses_pending_file, set_up, tear_down),
        cmocka_unit_test_setup_teardown(cancelling, set_up, tear_down),
        cmocka_unit_test_setup_teardown(going_on, set_up, tear_down),
        cmocka_unit_test_setup_teardown(cancelling_forgets, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_waits_survives_the_daemon, set_up, tear_down),
        cmocka_unit_test_setup_teardown(the_queue_is_bounded, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
