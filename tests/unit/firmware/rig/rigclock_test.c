/* Two simulated clocks and a network between them: the true offset must lie within the bounds. */
#include "firmware/rig/rigclock.h"

#include "core/base/splitmix.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#define MS INT64_C(1000000)
#define SECOND INT64_C(1000000000)
#define YEAR (365 * 86400 * SECOND)

struct clock { // reads from + t + t * ppm
    int64_t from_ns;
    double ppm;
};

struct pair {
    uint64_t seed;
    struct clock common, mono;
    struct rigclock known;
};

static int64_t at(const struct clock *c, int64_t t_ns)
{
    return c->from_ns + t_ns + (int64_t)((double)t_ns * c->ppm * 1e-6);
}

static double uniform(struct pair *p, double low, double high)
{
    return low + (high - low) * (double)(splitmix_next(&p->seed) >> 11) * 0x1p-53;
}

static struct pair new_pair(uint64_t seed, double ppm)
{
    struct pair p = {.seed = seed};
    p.common = (struct clock){(int64_t)uniform(&p, 0, 70) * YEAR, uniform(&p, -ppm, ppm)};
    p.mono = (struct clock){(int64_t)uniform(&p, 0, 2e9) * SECOND, uniform(&p, -ppm, ppm)};
    return p;
}

/* Mostly short, sometimes 1000 times as long, as behind a radio that sleeps. */
static int64_t delay(struct pair *p)
{
    const double ms = uniform(p, 0, 4);
    return (int64_t)((ms > 3 ? uniform(p, 0.1, 100) : uniform(p, 0.1, 0.3)) * MS);
}

/* How far the true offset lies outside the bounds at a time; 0: inside. */
static int64_t beyond(const struct pair *p, int64_t t_ns, struct rigclock_state *s)
{
    assert_true(rigclock_read(&p->known, at(&p->mono, t_ns), s));
    const int64_t error = llabs(at(&p->common, t_ns) - at(&p->mono, t_ns) - s->offset_ns);
    return error > s->within_ns ? error - s->within_ns : 0;
}

/* Ask at t_ns; back_ns is the way back. */
static void exchange(struct pair *p, int64_t t_ns, int64_t there_ns, int64_t back_ns)
{
    const int64_t got = t_ns + there_ns, replied = got + (int64_t)(uniform(p, 0, 0.2) * MS);
    rigclock_exchange(&p->known, at(&p->mono, t_ns), at(&p->common, got), at(&p->common, replied),
                      at(&p->mono, replied + back_ns));
}

static void nothing_is_known(void **state)
{
    (void)state;
    struct rigclock c = {0};
    struct rigclock_state s = {1, 1, true, 1};
    assert_false(rigclock_read(&c, SECOND, &s));
    assert_int_equal(s.offset_ns, 0);
    rigclock_kernel(&c, SECOND, 5, 5); // a promise, without an exchange that agrees
    assert_false(rigclock_read(&c, SECOND, &s));
}

/* Lost answers, answers that come twice and long after later ones. */
static void true_offset_is_within(void **state)
{
    (void)state;
    double worst = 0;
    for (uint64_t seed = 1; seed <= 300; seed++) {
        struct pair p = new_pair(seed, 50);
        struct rigclock_state s;
        int64_t t = SECOND;
        exchange(&p, t, delay(&p), delay(&p));
        for (int i = 0; i < 400; i++, t += (int64_t)(uniform(&p, 0.1, 4) * SECOND)) {
            const int64_t there = delay(&p), back = delay(&p);
            if (uniform(&p, 0, 1) > 0.3)
                exchange(&p, t, there, back);
            if (uniform(&p, 0, 1) > 0.9)
                exchange(&p, t, there, back + (int64_t)(uniform(&p, 0, 10) * SECOND));
            const int64_t read = t + there + back + (int64_t)(uniform(&p, 0, 30) * SECOND);
            assert_int_equal(beyond(&p, read, &s), 0);
            assert_int_equal(beyond(&p, t, &s), 0); // of the past, too
            assert_int_equal(s.contradiction_ns, 0);
        }
        rigclock_read(&p.known, at(&p.mono, t), &s);
        worst = (double)s.within_ns > worst ? (double)s.within_ns : worst;
    }
    assert_true(worst < 15 * MS);
}

/* Rates at the ends of the bound, and one way that takes no time. */
static void bound_is_reached(void **state)
{
    (void)state;
    for (int sign = -1; sign <= 1; sign += 2)
        for (int64_t there = 0; there <= 30 * SECOND; there += 10 * SECOND) {
            struct pair p = {.common = {40 * YEAR, 50 * sign}, .mono = {0, -50 * sign}};
            struct rigclock_state s;
            exchange(&p, SECOND, there, 0);
            assert_int_equal(beyond(&p, 40000 * SECOND, &s), 0);
            exchange(&p, 50000 * SECOND, 0, there);
            assert_int_equal(beyond(&p, 50100 * SECOND, &s), 0);
            assert_int_equal(beyond(&p, 90000 * SECOND, &s), 0);
        }
}

/* Exchanges over years of asymmetry are as narrow as the best of the last ones. */
static void short_exchange_narrows(void **state)
{
    (void)state;
    struct pair p = new_pair(7, 0);
    struct rigclock_state s;
    exchange(&p, SECOND, 90 * MS, MS);
    assert_int_equal(beyond(&p, SECOND, &s), 0);
    assert_in_range(s.within_ns, 45 * MS, 46 * MS);
    exchange(&p, SECOND, MS / 10, MS / 10);
    exchange(&p, SECOND, MS, 90 * MS);
    assert_int_equal(beyond(&p, SECOND, &s), 0);
    assert_in_range(s.within_ns, MS / 20, MS / 5);
}

/* A member whose clock was made to run 500 ppm faster for a while: bounds from before are wrong,
 * and forgotten when later exchanges exclude them. */
static void slew_recovers(void **state)
{
    (void)state;
    for (uint64_t seed = 1; seed <= 100; seed++) {
        struct pair p = new_pair(seed, 50);
        struct rigclock_state s;
        int64_t t = SECOND;
        for (int i = 0; i < 20; i++, t += 2 * SECOND)
            exchange(&p, t, delay(&p), delay(&p));
        p.mono.from_ns += seed % 2 ? 100 * MS : -100 * MS; // the sum of a slew
        for (int i = 0; i < RIGCLOCK_SAMPLES; i++, t += 2 * SECOND)
            exchange(&p, t, delay(&p), delay(&p));
        assert_int_equal(beyond(&p, t, &s), 0);
        exchange(&p, t, MS / 10, MS / 10); // and at once by one that is short
        p.mono.from_ns += 50 * MS;
        exchange(&p, t + SECOND, MS / 10, MS / 10);
        assert_int_equal(beyond(&p, t + 2 * SECOND, &s), 0);
    }
}

static void kernels(void **state)
{
    (void)state;
    struct pair p = new_pair(3, 20);
    struct rigclock_state s;
    const int64_t t = 100 * SECOND, now = at(&p.mono, t);
    const int64_t offset = at(&p.common, t) - now;
    exchange(&p, t, 3 * MS, 3 * MS);
    rigclock_kernel(&p.known, now, offset + MS / 10, MS / 4); // narrower, and right
    assert_int_equal(beyond(&p, t + SECOND, &s), 0);
    assert_true(s.by_kernel && !s.contradiction_ns && s.within_ns < MS / 2);
    rigclock_kernel(&p.known, now, offset, 20 * MS); // wider: of no use
    assert_int_equal(beyond(&p, t, &s), 0);
    assert_true(!s.by_kernel && !s.contradiction_ns);
    for (int sign = -1; sign <= 1; sign += 2) { // wrong: exchanges win, and say so
        rigclock_kernel(&p.known, now, offset + sign * 50 * MS, MS);
        assert_int_equal(beyond(&p, t, &s), 0);
        assert_true(!s.by_kernel && s.contradiction_ns > 40 * MS && s.contradiction_ns < 50 * MS);
        assert_in_range(s.within_ns, 3 * MS, 4 * MS);
    }
    rigclock_kernel(&p.known, now, offset - 60 * YEAR, MS);
    assert_int_equal(beyond(&p, t, &s), 0);
    assert_true(s.contradiction_ns > 59 * YEAR);
}

static void impossible_stamps(void **state)
{
    (void)state;
    struct rigclock c = {0};
    struct rigclock_state s;
    rigclock_exchange(&c, 100, 1000, 1000, 99);  // back before it was sent
    rigclock_exchange(&c, 100, 1000, 999, 200);  // replied before it came
    rigclock_exchange(&c, 100, 1000, 1200, 200); // the conductor took longer than all of it
    assert_int_equal(c.n, 0);
    assert_false(rigclock_read(&c, 200, &s));
    rigclock_exchange(&c, 100, 1000, 1000, 100);
    assert_true(rigclock_read(&c, 100, &s));
    assert_in_range(s.offset_ns, 899, 901);
    rigclock_exchange(&c, INT64_MAX / 2, INT64_C(4000000000000000000), INT64_C(4000000000000000000),
                      INT64_MAX / 2);
    assert_true(rigclock_read(&c, 0, &s));
    assert_true(rigclock_read(&c, INT64_MAX / 2, &s));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(nothing_is_known),  cmocka_unit_test(true_offset_is_within),
        cmocka_unit_test(bound_is_reached),  cmocka_unit_test(short_exchange_narrows),
        cmocka_unit_test(slew_recovers),     cmocka_unit_test(kernels),
        cmocka_unit_test(impossible_stamps),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
