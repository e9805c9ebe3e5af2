/* Who may stay connected to the status page. Sockets are pairs; the other end tells what happened.
 */
#include "firmware/daemon/connections.h"

#include <netinet/in.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

enum { N = 4 * CONNECTIONS_MAX };

static struct connections c;
static int near_end[N], far_end[N];
static struct connection *slot[N];
static int n;

static int set_up(void **state)
{
    (void)state;
    connections_init(&c);
    n = 0;
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    while (n-- > 0) {
        close(near_end[n]);
        close(far_end[n]);
    }
    return 0;
}

static struct connection *add(uint32_t address, int64_t now_ns)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(address)};
    int pair[2];
    assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM, 0, pair), 0);
    near_end[n] = pair[0];
    far_end[n] = pair[1];
    slot[n] = connections_add(&c, pair[0], (struct sockaddr *)&a, now_ns);
    return slot[n++];
}

static bool is_ended(int i)
{
    char b;
    return recv(far_end[i], &b, 1, MSG_DONTWAIT) == 0;
}

/* As the server does, which sees the end. */
static void close_ended(void)
{
    for (int i = 0; i < n; i++)
        if (slot[i] && slot[i]->fd == near_end[i] && is_ended(i))
            connections_remove(slot[i]);
}

static void the_oldest_of_an_address_goes(void **state)
{
    (void)state;
    assert_non_null(add(9, 0)); // another address
    for (int i = 0; i < CONNECTIONS_EACH; i++)
        assert_non_null(add(1, 1 + i));
    connections_end(slot[1], 100); // asked something, so it is the newest that waits
    assert_non_null(add(1, 101));
    assert_true(is_ended(2));
    for (int i = 0; i < n; i++)
        assert_true(i == 2 || !is_ended(i));
}

static void what_is_answered_stays(void **state)
{
    (void)state;
    for (int i = 0; i < CONNECTIONS_EACH; i++)
        connections_begin(add(1, i));
    assert_null(add(1, 50));
    assert_true(is_ended(CONNECTIONS_EACH));
    assert_non_null(add(2, 50));
    connections_end(slot[3], 60);
    assert_non_null(add(1, 61));
    for (int i = 0; i < CONNECTIONS_EACH; i++)
        assert_int_equal(is_ended(i), i == 3);
}

static void all_addresses_have_a_bound(void **state)
{
    (void)state;
    int ended = 0;
    for (uint32_t i = 0; i < 3 * CONNECTIONS_MAX; i++) {
        assert_non_null(add(i, i));
        close_ended();
    }
    for (int i = 0; i < n; i++)
        ended += is_ended(i);
    assert_int_equal(ended, 3 * CONNECTIONS_MAX - CONNECTIONS_MAX / 2);
    assert_false(is_ended(n - 1));
}

static void patience_ends(void **state)
{
    (void)state;
    const int64_t s = 1000000000, wait = CONNECTIONS_WAIT_S * s;
    assert_true(connections_expire(&c, 0) == INT64_MAX);
    add(1, 0);
    add(2, s);
    connections_begin(add(3, 0));
    assert_true(connections_expire(&c, wait - 1) == wait);
    assert_false(is_ended(0));
    assert_true(connections_expire(&c, wait) == wait + s);
    assert_true(is_ended(0) && !is_ended(1) && !is_ended(2));
    assert_true(connections_expire(&c, 100 * wait) == INT64_MAX);
    assert_true(is_ended(1) && !is_ended(2)); // that is for the server's own limit
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(the_oldest_of_an_address_goes, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_is_answered_stays, set_up, tear_down),
        cmocka_unit_test_setup_teardown(all_addresses_have_a_bound, set_up, tear_down),
        cmocka_unit_test_setup_teardown(patience_ends, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
