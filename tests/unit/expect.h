/* expect.h - errors as tests state them: the code, and words of its sentence. */
#ifndef UNIT_EXPECT_H
#define UNIT_EXPECT_H

#include "core/base/err.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

static inline void expect_ok(err_t e)
{
    if (e)
        fail_msg("error %d: %s", e, err_text());
}

static inline void expect_err(err_t got, err_t want, const char *words)
{
    if (got != want || !strstr(err_text(), words))
        fail_msg("error %d, \"%s\" instead of %d with \"%s\"", got, err_text(), want, words);
}

#endif
