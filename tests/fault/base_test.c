/* Arenas, pools and settings when memory runs out. */
#include "core/base/arena.h"
#include "core/base/pool.h"
#include "firmware/base/config.h"
#include "tests/fault/alloc_fail.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

static err_t use_arena(void *ctx)
{
    (void)ctx;
    struct arena a;
    void *p;
    err_t e = arena_init(&a, "test", 1000);
    if (!e)
        e = arena_alloc(&a, 10, 10, &p);
    arena_free(&a);
    return e;
}

static void arena_init_fails(void **state)
{
    (void)state;
    assert_int_equal(alloc_fail_sweep(use_arena, NULL), 1);
}

static err_t nothing(void *ctx, int chunk, int worker)
{
    (void)ctx, (void)chunk, (void)worker;
    return OK;
}

static err_t use_pool(void *ctx)
{
    (void)ctx;
    struct pool *p;
    err_t e = pool_open(&p, 4);
    if (!e)
        e = pool_for(p, 10, nothing, NULL);
    pool_close(p);
    return e;
}

static void pool_open_fails(void **state)
{
    (void)state;
    assert_true(alloc_fail_sweep(use_pool, NULL) >= 1);
}

static err_t use_config(void *ctx)
{
    (void)ctx;
    struct config c;
    config_defaults(&c);
    return config_read(&c, "board/common/defaults.conf");
}

static void config_read_fails(void **state)
{
    (void)state;
    assert_true(alloc_fail_sweep(use_config, NULL) >= 1);
}

static err_t lose_a_block(void *ctx)
{
    void **kept = ctx;
    void *first = malloc(10);
    if (!first)
        return err_fail(ERR_NOMEM, "first");
    void *second = malloc(10);
    if (!second)
        kept[0] = first; // as a forgotten clean-up
    else
        free(first);
    free(second);
    return second ? OK : err_fail(ERR_NOMEM, "second");
}

/* The sweep itself: a block lost on the way out must be noticed. */
static void lost_blocks_are_counted(void **state)
{
    (void)state;
    void *kept = NULL;
    assert_int_equal(alloc_fail_sweep(lose_a_block, &kept), -1);
    free(kept);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(arena_init_fails),
        cmocka_unit_test(pool_open_fails),
        cmocka_unit_test(config_read_fails),
        cmocka_unit_test(lost_blocks_are_counted),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
