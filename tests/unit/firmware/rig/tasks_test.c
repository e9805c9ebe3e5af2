/* What a conductor does with its disk and the network: orders recorded, parts fetched from another
 * board's page, joined, released; with the other board silent, lying, or without the part. */
#include "firmware/rig/tasks.h"

#include "firmware/daemon/http.h"
#include "firmware/store/joint.h"
#include "tests/unit/expect.h"
#include "tests/unit/small_rig.h"
#include "tests/unit/tmpdir.h"

#include <poll.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#define TOKEN "0123456789abcdef0123456789abcdef"

static char folder[2][300]; // stores of the conductor and of the other board
static struct store *store[2];
static struct tasks *tasks[2]; // each of its store
static struct http *page;      // of the other board

static void status(void *ctx, FILE *f)
{
    (void)ctx;
    fputs("{}", f);
}

static err_t command(void *ctx, const char *line)
{
    (void)ctx;
    (void)line;
    return OK;
}

static int set_up(void **state)
{
    (void)state;
    signal(SIGPIPE, SIG_IGN);
    tmpdir_make();
    for (int i = 0; i < 2; i++) {
        snprintf(folder[i], sizeof folder[i], "%s", tmpdir_path(i ? "other" : "conductor"));
        struct store_config cfg = {.path = folder[i], .merge = true};
        expect_ok(store_open(&cfg, &store[i]));
        expect_ok(tasks_open("tasks", store[i], folder[i], &tasks[i]));
    }
    struct http_config c = {.address = "127.0.0.1",
                            .token = "t",
                            .captures = folder[1],
                            .results = folder[1],
                            .status = status,
                            .command = command,
                            .parts_token = TOKEN};
    expect_ok(http_open(&c, &page));
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    for (int i = 0; i < 2; i++) {
        tasks_close(tasks[i]);
        store_close(store[i]);
    }
    http_close(page);
    tmpdir_remove();
    return 0;
}

/* The outcome of a task, while the other board's page is served. */
static void run(int board, struct task *k)
{
    expect_ok(tasks_add(tasks[board], k));
    for (int i = 0; i < 3000; i++) {
        int64_t deadline = INT64_MAX;
        struct pollfd fds[2] = {{.fd = tasks_fd(tasks[board]), .events = POLLIN}};
        fds[1] = http_poll(page, 0, &deadline);
        poll(fds, 2, 10);
        http_step(page);
        if (tasks_outcome(tasks[board], k))
            return;
    }
    fail_msg("a task does not end");
}

static void ends_with(const struct task *k, err_t want, const char *words)
{
    if (k->err != want || !strstr(k->text, words))
        fail_msg("error %d, \"%s\" instead of %d with \"%s\"", k->err, k->text, want, words);
}

/* An order for two boards, b0 and b1. */
static void record(struct task *k)
{
    *k = (struct task){.kind = TASK_RECORD};
    k->order = (struct message_order){.kind = MESSAGE_SHOOT, .epoch = "1", .serial = 1, .n = 2};
    strcpy(k->order.member[0], "b0");
    strcpy(k->order.member[1], "b1");
    k->order.n_times = 1;
    k->order.time_s[0] = 0.01;
    run(0, k);
    ends_with(k, OK, "");
    assert_true(k->take[0]);
}

/* The part of a board, in the store of one of the two. */
static void put_part(int in, const char *take, const char *member)
{
    char id[STORE_ID_CAP];
    struct take *t = small_part(1, 2, CAMERA_RGGB16, take, member);
    expect_ok(store_commit(store[in], t, id));
    take_free(t);
}

static void list_holds(int board, struct task *k)
{
    *k = (struct task){.kind = TASK_HOLDS};
    run(board, k);
    ends_with(k, OK, "");
}

static struct task fetching(const char *take, const struct message_hold *part)
{
    struct task k = {.kind = TASK_FETCH, .part = *part, .token = TOKEN};
    snprintf(k.take, sizeof k.take, "%s", take);
    snprintf(k.url, sizeof k.url, "http://127.0.0.1:%d", http_port(page));
    strcpy(k.member, "b1");
    return k;
}

static void a_part_comes_and_goes(void **state)
{
    static struct task order, k;
    (void)state;
    record(&order);
    put_part(0, order.take, "b0");
    put_part(1, order.take, "b1");
    list_holds(0, &k);
    assert_int_equal(k.n_holds, 1);
    const struct message_hold own = k.hold[0];
    list_holds(1, &k);
    const struct message_hold part = k.hold[0];
    assert_string_equal(part.take, order.take);

    k = (struct task){.kind = TASK_OWN, .part = own};
    memcpy(k.take, order.take, sizeof k.take);
    strcpy(k.member, "b0");
    run(0, &k);
    ends_with(&k, OK, "");
    assert_int_equal(k.report.n_starts, 2);

    k = fetching(order.take, &part);
    run(0, &k);
    ends_with(&k, OK, "");
    assert_int_equal(k.report.n_starts, 2);
    assert_true(k.report.start[1].common_ns == small_rig_ns + INT64_C(1000000000));
    assert_true(k.report.red > 0 && k.bytes > 0);
    k = fetching(order.take, &part); // again: all is there
    run(0, &k);
    ends_with(&k, OK, "");

    k = (struct task){.kind = TASK_JOIN, .order = order.order};
    memcpy(k.take, order.take, sizeof k.take);
    run(0, &k);
    ends_with(&k, OK, "");
    char path[FILE_PATH_CAP];
    expect_ok(file_join(folder[0], order.take, path));
    expect_ok(store_verify(path));

    k = (struct task){.kind = TASK_RELEASE};
    memcpy(k.take, order.take, sizeof k.take);
    run(1, &k);
    ends_with(&k, OK, "");
    assert_int_equal(k.n_holds, 0);
}

/* What is left of the part of b1 when its thumbnails are missing and damaged. */
static void a_part_without_thumbnails(void **state)
{
    static struct task order, k;
    static const char *const names[] = {"thumbs/train_00_00.jpg", "thumbs/train_00_01.jpg"};
    char path[FILE_PATH_CAP], file[FILE_PATH_CAP];
    (void)state;
    record(&order);
    put_part(1, order.take, "b1");
    list_holds(1, &k);
    expect_ok(file_join(folder[1], k.hold[0].part, path));
    expect_ok(file_join(path, names[0], file));
    assert_int_equal(truncate(file, 100), 0);
    expect_ok(file_join(path, names[1], file));
    assert_int_equal(unlink(file), 0);
    k = fetching(order.take, &k.hold[0]);
    run(0, &k);
    ends_with(&k, OK, "");
    k = (struct task){.kind = TASK_JOIN, .order = order.order};
    k.order.n = 1;
    strcpy(k.order.member[0], "b1");
    memcpy(k.take, order.take, sizeof k.take);
    run(0, &k);
    ends_with(&k, OK, "");
    expect_ok(file_join(folder[0], order.take, path));
    expect_ok(store_verify(path));
    for (int i = 0; i < 2; i++) {
        expect_ok(file_join(path, names[i], file));
        assert_false(file_exists(file));
    }
}

static void parts_that_cannot_be_fetched(void **state)
{
    static struct task order, k, holds;
    (void)state;
    record(&order);
    put_part(1, order.take, "b1");
    list_holds(1, &holds);

    k = fetching(order.take, &holds.hold[0]);
    k.token[0] = 'f';
    run(0, &k);
    ends_with(&k, ERR_ARG, "token");

    k = fetching(order.take, &holds.hold[0]);
    k.part.sha256[0] = k.part.sha256[0] == '0' ? '1' : '0';
    run(0, &k);
    ends_with(&k, ERR_FORMAT, "manifest.json");

    k = fetching(order.take, &holds.hold[0]);
    k.part.bytes = 1 << 30;
    run(0, &k);
    ends_with(&k, ERR_FORMAT, "1073741824 bytes");

    k = fetching(order.take, &holds.hold[0]);
    strcpy(k.part.part, "00000000-000009");
    run(0, &k);
    ends_with(&k, ERR_IO, "no such file");

    k = fetching(order.take, &holds.hold[0]);
    snprintf(k.url, sizeof k.url, "http://127.0.0.1:1");
    run(0, &k);
    ends_with(&k, ERR_LOST, "127.0.0.1:1");

    // it says to be another board's
    k = fetching(order.take, &holds.hold[0]);
    strcpy(k.member, "b0");
    run(0, &k);
    ends_with(&k, ERR_FORMAT, "b0");

    // and is of another take
    static struct task other;
    record(&other);
    k = fetching(other.take, &holds.hold[0]);
    run(0, &k);
    ends_with(&k, ERR_FORMAT, order.take);
}

static void dropped_takes_are_remembered(void **state)
{
    static struct task order, k;
    char ids[4][STORE_ID_CAP], *text;
    struct message_order o;
    (void)state;
    record(&order);
    assert_int_equal(joint_pending(folder[0], ids, 4), 1);
    k = (struct task){.kind = TASK_DROP, .order = order.order};
    memcpy(k.take, order.take, sizeof k.take);
    run(0, &k);
    ends_with(&k, OK, "");
    expect_ok(joint_order(folder[0], order.take, &text));
    expect_ok(message_read_order(text, strlen(text), &o));
    free(text);
    assert_int_equal(o.kind, MESSAGE_RELEASE);
    assert_string_equal(o.take, order.take);
    k.kind = TASK_CLEAR;
    run(0, &k);
    ends_with(&k, OK, "");
    assert_int_equal(joint_pending(folder[0], ids, 4), 0);
}

/* Closing ends a transfer from a board that is silent. */
static void closing_does_not_wait(void **state)
{
    static struct task order, holds;
    (void)state;
    record(&order);
    put_part(1, order.take, "b1");
    list_holds(1, &holds);
    struct task k = fetching(order.take, &holds.hold[0]); // nobody serves the page
    expect_ok(tasks_add(tasks[0], &k));
    poll(NULL, 0, 200);
    tasks_close(tasks[0]);
    expect_ok(tasks_open("tasks", store[0], folder[0], &tasks[0]));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_part_comes_and_goes, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_part_without_thumbnails, set_up, tear_down),
        cmocka_unit_test_setup_teardown(parts_that_cannot_be_fetched, set_up, tear_down),
        cmocka_unit_test_setup_teardown(dropped_takes_are_remembered, set_up, tear_down),
        cmocka_unit_test_setup_teardown(closing_does_not_wait, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
