/* Takes are written behind the caller's back, in order, and come back with their outcome. */
#include "firmware/capture/writer.h"

#include "tests/unit/small_take.h"
#include "tests/unit/tmpdir.h"

#include <poll.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static struct store *store;
static struct writer *w;

static int set_up(void **state)
{
    (void)state;
    tmpdir_make();
    const struct store_config c = {.path = tmpdir_path("store")};
    if (store_open(&c, &store) != OK || writer_open(store, &w) != OK)
        return -1;
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    writer_close(w);
    store_close(store);
    tmpdir_remove();
    return 0;
}

static void wait_outcome(struct writer_outcome *o)
{
    struct pollfd p = {.fd = writer_fd(w), .events = POLLIN};
    assert_int_equal(poll(&p, 1, 10000), 1);
    assert_int_equal(writer_outcome(w, o), OK);
}

static void in_order_and_two_at_most(void **state)
{
    (void)state;
    struct writer_outcome o;
    struct take *first = small_take(2, 3, CAMERA_RGGB12P), *second = small_take(1, 1, CAMERA_GREY);
    struct take *third = small_take(1, 1, CAMERA_GREY);
    char ids[4][STORE_ID_CAP];
    assert_int_equal(writer_outcome(w, &o), ERR_AGAIN);
    assert_int_equal(writer_since_ns(w), 0);
    assert_int_equal(writer_put(w, first), OK);
    assert_int_equal(writer_put(w, second), OK);
    assert_false(writer_free(w));
    assert_int_equal(writer_put(w, third), ERR_BUSY);
    assert_int_equal(store_room(store, 1), OK); // while it writes
    wait_outcome(&o);
    assert_ptr_equal(o.take, first);
    if (o.err)
        fail_msg("%s", o.text);
    take_free(o.take);
    assert_true(writer_free(w));
    assert_int_equal(writer_put(w, third), OK);
    wait_outcome(&o);
    assert_ptr_equal(o.take, second);
    take_free(o.take);
    wait_outcome(&o);
    assert_ptr_equal(o.take, third);
    take_free(o.take);
    assert_int_equal(store_list(store, ids, 4), 3);
    assert_string_equal(ids[0], o.id);
}

static void errors_come_back(void **state)
{
    (void)state;
    struct writer_outcome o;
    struct take *t = small_take(1, 1, CAMERA_GREY);
    t->frame[0].camera = 7; // a take of one camera
    assert_int_equal(writer_put(w, t), OK);
    wait_outcome(&o);
    assert_int_not_equal(o.err, OK);
    assert_int_not_equal(o.text[0], 0);
    take_free(o.take);
}

static void closing_writes_what_waits(void **state)
{
    (void)state;
    char ids[4][STORE_ID_CAP];
    assert_int_equal(writer_put(w, small_take(1, 2, CAMERA_GREY)), OK);
    assert_int_equal(writer_put(w, small_take(1, 2, CAMERA_GREY)), OK);
    writer_close(w);
    w = NULL;
    assert_int_equal(store_list(store, ids, 4), 2);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(in_order_and_two_at_most, set_up, tear_down),
        cmocka_unit_test_setup_teardown(errors_come_back, set_up, tear_down),
        cmocka_unit_test_setup_teardown(closing_writes_what_waits, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
