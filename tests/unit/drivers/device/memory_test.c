/* What control groups allow, in trees of files like those of the kernel. */
#include "drivers/device/memory.h"

#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <unistd.h>

#include <cmocka.h>

static void put(const char *name, const char *text)
{
    char command[512];
    snprintf(command, sizeof command, "mkdir -p \"$(dirname %s/%s)\"", tmpdir_path(""), name);
    assert_int_equal(system(command), 0);
    tmpdir_text(name, text);
}

static uint64_t machine(void)
{
    return (uint64_t)sysconf(_SC_PHYS_PAGES) * (uint64_t)sysconf(_SC_PAGESIZE);
}

static void the_least_of_all_groups_counts(void **state)
{
    static const struct {
        const char *cgroup, *inner, *outer;
        uint64_t want; // 0: the machine's
    } cases[] = {
        {"0::/", "1000000", "max", 0}, // not its groups
        {"0::/a.slice/b.service", "2000000", "max", 2000000},
        {"0::/a.slice/b.service", "2000000", "1000000", 1000000},
        {"0::/a.slice/b.service", "max", "3000000", 3000000},
        {"0::/a.slice/b.service", "max", "max", 0},
        {"0::/a.slice/b.service", "", "-1", 0},
        {"9:memory:/x\n0::/a.slice\n", "5", "3000000", 3000000},
        {"9:memory:/a.slice\n", "5", "5", 0},
        {"0::/none/at/all", "5", "5", 0},
        {"", "5", "5", 0},
        {"0::/a.slice/b.service", "99999999999999999", "max", 0},
    };
    (void)state;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        put("proc/self/cgroup", cases[i].cgroup);
        put("sys/fs/cgroup/a.slice/memory.max", cases[i].outer);
        put("sys/fs/cgroup/a.slice/b.service/memory.max", cases[i].inner);
        const uint64_t want = cases[i].want ? cases[i].want : machine();
        assert_int_equal(memory_total(tmpdir_path("")), want);
    }
    assert_int_equal(memory_total("/nowhere"), machine());
    assert_true(memory_total("") <= machine() && memory_total("") > 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(the_least_of_all_groups_counts)};
    return cmocka_run_group_tests(tests, tmpdir_setup, tmpdir_teardown);
}
