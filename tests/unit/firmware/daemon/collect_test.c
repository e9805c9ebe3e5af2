/* The rules of a session, with a script in the place of the reconstruction. */
#include "firmware/daemon/collect.h"

#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <sys/stat.h>

#include <cmocka.h>

static struct collect c;
static struct jobs *jobs;
static char store[300];

static int set_up(void **state)
{
    char program[300], results[300];
    (void)state;
    tmpdir_make();
    tmpdir_text("prog", "#!/bin/sh\n");
    snprintf(program, sizeof program, "%s", tmpdir_path("prog"));
    snprintf(results, sizeof results, "%s", tmpdir_path("results"));
    snprintf(store, sizeof store, "%s", tmpdir_mkdir("store"));
    struct jobs_config j = {program, store, results, NULL, NULL};
    c = (struct collect){.store = store, .cameras = 1, .on = true};
    return chmod(program, 0755) != 0 || jobs_open(&j, &jobs) != OK || collect_look(&c) != OK;
}

static int tear_down(void **state)
{
    (void)state;
    jobs_close(jobs);
    tmpdir_remove();
    return 0;
}

/* What the store does with the take that the session gives. */
static void capture(int number)
{
    struct take *t = calloc(1, sizeof *t);
    char id[STORE_ID_CAP], name[80], text[80];
    assert_non_null(t);
    collect_take(&c, t);
    assert_true(t->is_place);
    snprintf(id, sizeof id, "0123abcd-%06d", number);
    snprintf(name, sizeof name, "store/%s", id);
    tmpdir_mkdir(name);
    snprintf(name, sizeof name, "store/%s/manifest.json", id);
    snprintf(text, sizeof text, "{\"session\": \"%s\"}", t->session[0] ? t->session : id);
    tmpdir_text(name, text);
    take_free(t);
    assert_int_equal(collect_look(&c), OK);
}

static void says(err_t got, err_t want, const char *words)
{
    if (got != want || !strstr(want ? err_text() : c.line, words))
        fail_msg("%d \"%s\" \"%s\", not %d \"%s\"", got, c.line, err_text(), want, words);
}

static int waiting(void)
{
    struct jobs_state s;
    jobs_look(jobs, &s);
    return s.waiting;
}

static void from_the_first_place_to_the_scene(void **state)
{
    (void)state;
    c.jobs = jobs;
    says(OK, OK, "no place yet");
    says(collect_scene(&c), ERR_ARG, "no session is open");
    says(collect_end(&c, false), ERR_ARG, "no session is open");
    capture(1);
    says(OK, OK, "1 place so far");
    says(collect_scene(&c), ERR_ARG, "1 place so far, a scene needs at least 2");
    capture(2);
    capture(3);
    says(OK, OK, "3 places so far");
    says(collect_scene(&c), OK, "3 places so far");
    assert_int_equal(waiting(), 1);
    says(collect_end(&c, true), OK, "ends when the running capture is stored");
    assert_true(c.ending);
    assert_string_equal(c.places.id, "0123abcd-000001");
    capture(4);
    says(collect_end(&c, false), OK, "ended with 4 places: being reconstructed");
    assert_false(c.ending);
    assert_int_equal(waiting(), 1); // it waited already
    assert_true(file_exists(tmpdir_path("results/0123abcd-000001.pending")));
    capture(5);
    assert_string_equal(c.places.id, "0123abcd-000005");
    says(OK, OK, "1 place so far");
}

static void too_few_places(void **state)
{
    (void)state;
    c.jobs = jobs;
    capture(1);
    says(collect_end(&c, false), OK, "ended with 1 place: no scene, which needs at least 2");
    assert_int_equal(waiting(), 0);
    c.line[0] = 0;
    assert_int_equal(collect_look(&c), OK);
    says(OK, OK, "no place yet");
}

/* A place of several cameras has as many views. */
static void several_cameras(void **state)
{
    (void)state;
    c.jobs = jobs;
    c.cameras = 30;
    capture(1);
    assert_int_equal(collect_room(&c), OK);
    capture(2);
    says(collect_room(&c), ERR_LIMIT, "2 places: a scene takes no more than 64 views");
    says(collect_end(&c, false), OK, "ended with 2 places: being reconstructed");
    capture(3);
    says(collect_end(&c, false), OK, "ended with 1 place: being reconstructed");
    assert_int_equal(waiting(), 2);
}

static void without_reconstructions(void **state)
{
    (void)state;
    capture(1);
    capture(2);
    says(collect_scene(&c), ERR_ARG, "2 places so far; job.run is 0");
    says(collect_end(&c, false), OK, "ended with 2 places: job.run is 0");
}

static void a_scene_takes_so_many(void **state)
{
    struct take *t = calloc(1, sizeof *t);
    (void)state;
    for (int i = 1; i <= PLACES_MAX; i++) {
        assert_int_equal(collect_room(&c), OK);
        capture(i);
    }
    says(collect_room(&c), ERR_LIMIT,
         "64 places: a scene takes no more than 64 views; end the session");
    c.on = false; // now each is a scene
    assert_int_equal(collect_room(&c), OK);
    assert_non_null(t);
    collect_take(&c, t);
    assert_false(t->is_place);
    take_free(t);
    c.jobs = jobs;
    says(collect_end(&c, false), OK, "ended with 64 places");
}

static void an_end_that_fails_leaves_it_open(void **state)
{
    (void)state;
    c.jobs = jobs;
    capture(1);
    capture(2);
    tmpdir_text("store/" STORE_SESSION_ENDED, "mine");
    says(collect_end(&c, false), ERR_ARG, "was not written by hdrig");
    assert_int_equal(c.places.n, 2);
    says(OK, OK, "2 places so far");
}

static void as_json(void **state)
{
    char text[300];
    struct cJSON *doc;
    double n;
    bool on = false;
    (void)state;
    capture(1);
    FILE *f = fmemopen(text, sizeof text, "w");
    assert_non_null(f);
    collect_write(&c, f);
    fclose(f);
    assert_int_equal(json_parse("session", text, strlen(text), &doc), OK);
    assert_true(json_truth(json_member(doc, "collect"), &on) && on);
    assert_true(json_number(json_member(doc, "places"), &n) && n == 1);
    assert_string_equal(json_string(json_member(doc, "id")), "0123abcd-000001");
    assert_string_equal(json_string(json_member(doc, "line")), "1 place so far");
    json_free(doc);
}

int main(void)
{
#define EACH(f) cmocka_unit_test_setup_teardown(f, set_up, tear_down)
    const struct CMUnitTest tests[] = {
        EACH(from_the_first_place_to_the_scene),
        EACH(too_few_places),
        EACH(several_cameras),
        EACH(without_reconstructions),
        EACH(a_scene_takes_so_many),
        EACH(an_end_that_fails_leaves_it_open),
        EACH(as_json),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
