/* Settings that change, and everything else that must not. */
#include "firmware/base/confedit.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

static void assert_edited(const char *text, const char *want)
{
    static const struct confedit values[] = {{"rig.role", "member"}, {"rig.board", ""}};
    char *got;
    assert_int_equal(confedit_apply(text, values, 2, &got), OK);
    assert_string_equal(got, want);
    free(got);
}

static void only_these_lines_change(void **state)
{
    (void)state;
    assert_edited("", "rig.role = member\nrig.board =\n");
    assert_edited("# rig.role = alone\nsize = 56", "# rig.role = alone\nsize = 56\n"
                                                   "rig.role = member\nrig.board =\n");
    assert_edited("rig.board=a\nsize = 56\n\nrig.role: alone # so\n",
                  "rig.board =\nsize = 56\n\nrig.role = member\n");
    assert_edited("rig.role = a\nrig.role = b\nrig.roles = c\nrig.role\t= d\n",
                  "rig.roles = c\nrig.role = member\nrig.board =\n");
    assert_edited("rig.board = rig.role = x\n", "rig.board =\nrig.role = member\n");
    assert_edited("\n\n", "\n\nrig.role = member\nrig.board =\n");
}

static void twice_is_once(void **state)
{
    (void)state;
    assert_edited("rig.role = member\nrig.board =\n", "rig.role = member\nrig.board =\n");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(only_these_lines_change),
        cmocka_unit_test(twice_is_once),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
