/* kill -9 at random moments while results are published: what is there is always one whole result,
 * and a later run removes what the dead one left. */
#include "drivers/format/json.h"
#include "drivers/format/scenefile.h"
#include "firmware/result/publish.h"
#include "tests/unit/small_job.h"
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

enum { KILLS = 40, WAIT_US = 30000, MANY = 2000, FEW = 1000 };

static struct small_job job;

static err_t publish(int n)
{
    struct outdir out;
    job.result.scene.g.n = n;
    err_t e = outdir_open(tmpdir_path("out"), NULL, &out);
    if (!e)
        e = publish_run(&job.run, &job.result, &out);
    outdir_close(&out);
    return e;
}

/* Two results by turns, until killed. */
static void child(void)
{
    for (int n = MANY; publish(n) == OK;)
        n = n == MANY ? FEW : MANY;
    _exit(1);
}

static void whole(void)
{
    static const char *const names[] = {"cameras.json", "tone.json", "scene.ply", "ldr/a.png",
                                        "ldr/b.png",    "hdr/a.exr", "hdr/b.exr"};
    struct scenefile_info info;
    struct cJSON *doc;
    double n;
    char name[32];
    assert_int_equal(scenefile_peek(tmpdir_path("out/scene.hdrig"), &info), OK);
    assert_int_equal(json_read(tmpdir_path("out/report.json"), &doc), OK);
    assert_true(json_number(json_member(doc, "gaussians"), &n));
    json_free(doc);
    assert_int_equal(info.n, (int)n);
    assert_true(info.n == MANY || info.n == FEW);
    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        snprintf(name, sizeof name, "out/%s", names[i]);
        assert_true(file_is_regular(tmpdir_path(name)));
    }
}

static int entries(void)
{
    DIR *d = opendir(tmpdir_path("."));
    int n = 0;
    while (readdir(d))
        n++;
    closedir(d);
    return n - 2;
}

static void killed_at_any_moment(void **state)
{
    (void)state;
    unsigned rng = 1;
    int left_something = 0;
    assert_int_equal(publish(FEW), OK);
    /* a busy machine may be slow to begin: more kills then, until enough hit the writing */
    for (int i = 0; i < KILLS || (left_something <= KILLS / 4 && i < 20 * KILLS); i++) {
        int status;
        pid_t pid = fork();
        if (pid == 0)
            child();
        rng = rng * 1664525u + 1013904223u;
        usleep(1000 + (rng >> 8) % WAIT_US);
        kill(pid, SIGKILL);
        assert_int_equal(waitpid(pid, &status, 0), pid);
        assert_true(WIFSIGNALED(status)); // it was still at work
        whole();
        left_something += entries() > 1;
    }
    assert_true(left_something > KILLS / 4);
    assert_int_equal(publish(MANY), OK);
    whole();
    assert_int_equal(entries(), 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(killed_at_any_moment)};
    tmpdir_make();
    small_job_init(&job, MANY);
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    small_job_free(&job);
    tmpdir_remove();
    return failed;
}
