#include "core/base/arena.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#if defined(__SANITIZE_ADDRESS__)
#include <sanitizer/asan_interface.h>
#endif

static void planned_needs_fit_exactly(void **state)
{
    (void)state;
    size_t need = arena_add(arena_need(3, 4), arena_add(arena_need(0, 8), arena_need(65, 1)));
    struct arena a;
    assert_int_equal(arena_init(&a, "test", need), OK);
    unsigned char *p[3];
    assert_int_equal(arena_alloc(&a, 3, 4, &p[0]), OK);
    assert_int_equal(arena_alloc(&a, 0, 8, &p[1]), OK);
    assert_int_equal(arena_alloc(&a, 65, 1, &p[2]), OK);
    for (int i = 0; i < 3; i++) {
        assert_non_null(p[i]);
        assert_int_equal((uintptr_t)p[i] % ARENA_ALIGN, 0);
    }
    assert_true(p[2] >= p[0] + 12);
    arena_free(&a);
    assert_null(a.base);
    arena_free(&a);
}

static void counting_needs_what_allocating_takes(void **state)
{
    (void)state;
    struct arena counts = arena_counter(), real, *both[] = {&counts, &real};
    assert_int_equal(arena_init(&real, "real", 4096), OK);
    for (int i = 0; i < 2; i++) {
        float *p, *q;
        assert_int_equal(arena_zalloc(both[i], 3, sizeof *p, &p), OK);
        size_t mark = arena_mark(both[i]);
        assert_int_equal(arena_alloc(both[i], 100, sizeof *q, &q), OK);
        assert_int_equal((uintptr_t)q % ARENA_ALIGN, 0);
        assert_non_null(q + 99); // can be added to
        arena_step(both[i], 640);
        arena_reset(both[i], mark);
    }
    assert_int_equal(counts.used, real.used);
    assert_int_equal(counts.peak, real.peak);
    arena_free(&counts);
    arena_free(&real);
}

static void counting_stops_at_the_end_of_the_address_space(void **state)
{
    (void)state;
    struct arena a = arena_counter();
    char *p;
    for (int i = 0; i < 3; i++)
        assert_int_equal(arena_alloc(&a, SIZE_MAX / 2, 1, &p), OK);
    arena_reset(&a, 0);
    assert_true(a.used == 0 && a.peak == SIZE_MAX);
    a = arena_counter();
    assert_int_equal(arena_alloc(&a, SIZE_MAX / 2, 3, &p), OK);
    assert_true(a.peak == SIZE_MAX);
}

static void full_arena_says_so(void **state)
{
    (void)state;
    struct arena a;
    assert_int_equal(arena_init(&a, "small", 128), OK);
    void *p = &a;
    assert_int_equal(arena_alloc(&a, 1000, 1, &p), ERR_NOMEM);
    assert_null(p);
    assert_non_null(strstr(err_text(), "small"));
    assert_non_null(strstr(err_text(), "1000 x 1"));
    assert_int_equal(a.used, 0);
    assert_int_equal(arena_alloc(&a, 128, 1, &p), OK);
    assert_int_equal(arena_alloc(&a, 1, 100000, &p), ERR_NOMEM);
    arena_free(&a);
}

static void overflow_is_refused(void **state)
{
    (void)state;
    struct arena a;
    void *p;
    assert_int_equal(arena_need(SIZE_MAX / 2, 3), SIZE_MAX);
    assert_int_equal(arena_need(SIZE_MAX - 3, 1), SIZE_MAX);
    assert_int_equal(arena_add(SIZE_MAX - 1, 2), SIZE_MAX);
    assert_int_equal(arena_add(SIZE_MAX, 0), SIZE_MAX);
    assert_int_equal(arena_add(1, 2), 3);
    assert_int_equal(arena_init(&a, "huge", SIZE_MAX), ERR_NOMEM);
    arena_free(&a);
    assert_int_equal(arena_init(&a, "test", 256), OK);
    assert_int_equal(arena_alloc(&a, SIZE_MAX / 4, 8, &p), ERR_NOMEM);
    assert_int_equal(arena_zalloc(&a, SIZE_MAX / 4, 8, &p), ERR_NOMEM);
    arena_free(&a);
}

static void reset_releases_to_the_mark(void **state)
{
    (void)state;
    struct arena a;
    unsigned char *p, *q, *again;
    assert_int_equal(arena_init(&a, "test", 4096), OK);
    assert_int_equal(arena_alloc(&a, 10, 1, &p), OK);
    size_t mark = arena_mark(&a);
    assert_int_equal(arena_alloc(&a, 1000, 1, &q), OK);
    memset(q, 0xff, 1000);
    size_t peak = a.peak;
    assert_true(peak >= 1010);
    arena_reset(&a, mark);
    assert_int_equal(arena_mark(&a), mark);
    assert_int_equal(arena_zalloc(&a, 100, 1, &again), OK);
    assert_ptr_equal(again, q);
    for (int i = 0; i < 100; i++)
        assert_int_equal(again[i], 0);
    assert_int_equal(a.peak, peak);
    arena_reset(&a, 4096); // above the level: nothing to release
    assert_true(arena_mark(&a) > mark);
    arena_free(&a);
}

static void memory_outside_allocations_is_poisoned(void **state)
{
    (void)state;
#if defined(__SANITIZE_ADDRESS__)
    struct arena a;
    unsigned char *p;
    assert_int_equal(arena_init(&a, "test", 4096), OK);
    assert_true(__asan_address_is_poisoned(a.base));
    size_t mark = arena_mark(&a);
    assert_int_equal(arena_alloc(&a, 64, 1, &p), OK);
    assert_false(__asan_address_is_poisoned(p));
    assert_false(__asan_address_is_poisoned(p + 63));
    assert_true(__asan_address_is_poisoned(p + 64));
    arena_reset(&a, mark);
    assert_true(__asan_address_is_poisoned(p));
    arena_free(&a);
#else
    skip();
#endif
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(planned_needs_fit_exactly),
        cmocka_unit_test(counting_needs_what_allocating_takes),
        cmocka_unit_test(counting_stops_at_the_end_of_the_address_space),
        cmocka_unit_test(full_arena_says_so),
        cmocka_unit_test(overflow_is_refused),
        cmocka_unit_test(reset_releases_to_the_mark),
        cmocka_unit_test(memory_outside_allocations_is_poisoned),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
