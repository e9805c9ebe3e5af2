#include "firmware/base/config.h"

#include "drivers/device/camera.h"
#include "drivers/device/memory.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

static err_t parse(struct config *c, const char *text)
{
    return config_parse(c, "test.conf", text, strlen(text));
}

static void refused(const char *text, err_t code, const char *sentence)
{
    struct config c, before;
    config_defaults(&c);
    before = c;
    assert_int_equal(parse(&c, text), code);
    assert_string_equal(err_text(), sentence);
    assert_memory_equal(&c, &before, sizeof c);
}

static void shipped_file_equals_the_table(void **state)
{
    (void)state;
    struct config want, c;
    config_defaults(&want);
    memset(&c, 0x55, sizeof c);
    memset(c.camera, 0, sizeof c.camera); // the file has only the first of these
    memset(c.trigger, 0, sizeof c.trigger);
    memset(c.rig_member, 0, sizeof c.rig_member);
    assert_int_equal(config_read(&c, "board/common/defaults.conf"), OK);
    assert_memory_equal(&c, &want, sizeof c);
}

static void later_values_win(void **state)
{
    (void)state;
    struct config c;
    config_defaults(&c);
    const char *text = "\xef\xbb\xbf# board\r\nthreads = 4 ; big cores\n\n"
                       "size=56\nrefine.steps =  20\nthreads = 3";
    assert_int_equal(parse(&c, text), OK);
    assert_int_equal(c.threads, 3);
    assert_int_equal(c.size, 56);
    assert_int_equal(c.refine_steps, 20);
    assert_int_equal(c.max_memory_mb, 0);
    assert_int_equal(config_memory_mb(&c), memory_total("") / 4 * 3 / 1000000);
    assert_int_equal(config_assign(&c, "max_memory_mb = 64"), OK);
    assert_int_equal(config_memory_mb(&c), 64);
    assert_int_equal(config_assign(&c, "refine.gaussians_max = 1000"), OK);
    assert_int_equal(c.refine_gaussians_max, 1000);
    assert_int_equal(config_set(&c, "--seed", "seed", "2147483647"), OK);
    assert_int_equal(c.seed, 2147483647);
}

static void sentences_name_file_line_and_bound(void **state)
{
    (void)state;
    refused("threads = 2\nsize = 4081\n", ERR_FORMAT, "test.conf:2: size: 4081 is not in 56..4080");
    refused("size = fu", ERR_FORMAT, "test.conf:1: size: \"fu\" is not a whole number");
    refused("\n\nthread = 2\n", ERR_FORMAT, "test.conf:3: unknown key \"thread\"");
    refused("threads = two\n", ERR_FORMAT, "test.conf:1: threads: \"two\" is not a whole number");
    refused("threads = 4 # all\n", ERR_FORMAT,
            "test.conf:1: threads: \"4 # all\" is not a whole number");
    refused("threads =\n", ERR_FORMAT, "test.conf:1: threads: \"\" is not a whole number");
    refused("threads = -1\n", ERR_FORMAT, "test.conf:1: threads: -1 is not in 0..64");
    refused("seed = 99999999999999999999\n", ERR_FORMAT,
            "test.conf:1: seed: 99999999999999999999 is not in 0..2147483647");
    refused("threads = 2\nhello\nsize = 1\n", ERR_FORMAT, "test.conf:2: not \"key = value\"");
    refused("[refine]\nsteps = 2\n", ERR_FORMAT,
            "test.conf:2: key inside [refine], sections are not used");
}

static void hostile_files_are_refused(void **state)
{
    (void)state;
    struct config c;
    config_defaults(&c);
    char line[400];
    memset(line, 'x', sizeof line - 1);
    line[sizeof line - 1] = 0;
    refused(line, ERR_FORMAT, "test.conf:1: line of 399 bytes, at most 199");
    assert_int_equal(config_parse(&c, "zero", "threads = 1\nsize\0= 56\n", 22), ERR_FORMAT);
    assert_string_equal(err_text(), "zero:2: zero byte");
    static char big[CONFIG_FILE_MAX + 1];
    memset(big, '\n', sizeof big);
    assert_int_equal(config_parse(&c, "big", big, sizeof big), ERR_FORMAT);
    assert_int_equal(config_parse(&c, "big", big, sizeof big - 1), OK);
    assert_int_equal(config_parse(&c, "empty", NULL, 0), OK);
    assert_int_equal(config_read(&c, "tests/unit"), ERR_IO);
    assert_int_equal(config_read(&c, "tests/unit/none.conf"), ERR_IO);
    assert_non_null(strstr(err_text(), "none.conf"));
}

static void assignments_are_checked(void **state)
{
    (void)state;
    struct config c;
    config_defaults(&c);
    assert_int_equal(config_assign(&c, "threads"), ERR_ARG);
    assert_string_equal(err_text(), "--set: \"threads\" is not key=value");
    assert_int_equal(config_assign(&c, "=4"), ERR_ARG);
    assert_int_equal(config_assign(&c, "threads=65"), ERR_ARG);
    assert_string_equal(err_text(), "--set: threads: 65 is not in 0..64");
    assert_int_equal(config_set(&c, "--size", "size", "55"), ERR_ARG);
    assert_string_equal(err_text(), "--size: size: 55 is not in 56..4080");
}

static void put(const char *dir, const char *name, const char *text)
{
    char path[256];
    snprintf(path, sizeof path, "%s/%s", dir, name);
    FILE *f = fopen(path, "w");
    assert_non_null(f);
    fputs(text, f);
    assert_int_equal(fclose(f), 0);
}

static void take_away(const char *dir, const char *name)
{
    char path[256];
    snprintf(path, sizeof path, "%s/%s", dir, name);
    unlink(path);
}

static void layers_are_read_in_order(void **state)
{
    (void)state;
    char dir[] = "/tmp/config_test.XXXXXX";
    assert_non_null(mkdtemp(dir));
    struct config c, before;
    config_defaults(&c);
    before = c;
    assert_int_equal(config_load(&c, dir), OK); // no files at all
    assert_memory_equal(&c, &before, sizeof c);
    put(dir, "hdrig.conf", "threads = 5\n");
    put(dir, "board.conf", "threads = 4\nsize = 224\n");
    put(dir, "defaults.conf", "threads = 3\nsize = 112\nseed = 9\n");
    assert_int_equal(config_load(&c, dir), OK);
    assert_int_equal(c.threads, 5);
    assert_int_equal(c.size, 224);
    assert_int_equal(c.seed, 9);
    put(dir, "hdrig.conf", "threads = 500\n");
    before = c;
    assert_int_equal(config_load(&c, dir), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "hdrig.conf:1: threads: 500 is not in 0..64"));
    assert_memory_equal(&c, &before, sizeof c);
    take_away(dir, "hdrig.conf");
    take_away(dir, "board.conf");
    take_away(dir, "defaults.conf");
    assert_int_equal(rmdir(dir), 0);
}

static void printed_settings_read_back(void **state)
{
    (void)state;
    struct config c, back;
    config_defaults(&c);
    assert_int_equal(config_assign(&c, "refine.steps=123"), OK);
    assert_int_equal(config_assign(&c, "size=56"), OK);
    FILE *f = tmpfile();
    assert_non_null(f);
    assert_int_equal(config_print(&c, f), OK);
    static char text[CONFIG_FILE_MAX];
    rewind(f);
    size_t n = fread(text, 1, sizeof text, f);
    fclose(f);
    config_defaults(&back);
    assert_int_equal(config_parse(&back, "printed", text, n), OK);
    assert_memory_equal(&back, &c, sizeof c);
    FILE *full = fopen("/dev/full", "w");
    assert_non_null(full);
    assert_int_equal(config_print(&c, full), ERR_IO);
    fclose(full);
}

/* One camera is carried from place to place, several stand around the scene. */
static void one_camera_collects(void **state)
{
    (void)state;
    struct config c;
    config_defaults(&c);
    assert_false(config_collects(&c)); // no rig
    assert_int_equal(config_assign(&c, "camera.1=sim:seed=1"), OK);
    assert_true(config_collects(&c));
    assert_int_equal(config_assign(&c, "session.collect=0"), OK);
    assert_false(config_collects(&c));
    assert_int_equal(config_assign(&c, "session.collect=auto"), OK);
    assert_int_equal(config_assign(&c, "trigger.2=timer:60"), OK);
    assert_false(config_collects(&c));
    assert_int_equal(config_assign(&c, "trigger.2="), OK);
    assert_int_equal(config_assign(&c, "camera.2=sim:seed=2"), OK);
    assert_false(config_collects(&c));
    assert_int_equal(config_assign(&c, "session.collect=1"), OK);
    assert_true(config_collects(&c));
}

static void words_texts_and_numbered_keys(void **state)
{
    (void)state;
    struct config c;
    config_defaults(&c);
    const char *text = "camera.1 = v4l2:/dev/video0,longest_ms=100\ncamera.16=sim:seed=3\n"
                       "camera.format = rggb12p\ntrigger.busy = coalesce\nlamp =\n";
    assert_int_equal(parse(&c, text), OK);
    assert_string_equal(c.camera[0], "v4l2:/dev/video0,longest_ms=100");
    assert_string_equal(c.camera[15], "sim:seed=3");
    assert_int_equal(c.camera_format, CAMERA_RGGB12P);
    assert_int_equal(c.trigger_busy, CONFIG_COALESCE);
    assert_string_equal(c.lamp, "");
    refused("trigger.busy = rejec", ERR_FORMAT,
            "test.conf:1: trigger.busy: \"rejec\" is none of reject|queue|coalesce");
    refused("camera.17 = a", ERR_FORMAT, "test.conf:1: unknown key \"camera.17\"");
    refused("camera.0 = a", ERR_FORMAT, "test.conf:1: unknown key \"camera.0\"");
    refused("camera. = a", ERR_FORMAT, "test.conf:1: unknown key \"camera.\"");
    refused("lamp = a\x01z", ERR_FORMAT, "test.conf:1: lamp: control character 1");
}

static void contradiction(const char *text, const char *sentence)
{
    struct config c;
    config_defaults(&c);
    assert_int_equal(parse(&c, text), OK);
    assert_int_equal(config_check_rig(&c), ERR_ARG);
    assert_string_equal(err_text(), sentence);
}

static void contradictions_name_both_keys(void **state)
{
    (void)state;
    struct config c;
    config_defaults(&c);
    assert_int_equal(config_check_rig(&c), OK);
    contradiction("camera.2 = sim:seed=1", "camera.2 is set, but camera.1 is not");
    contradiction("camera.1 = sim:\ncamera.2 = sim:", "camera.1 and camera.2 are both sim:");
    contradiction("bracket.ev = 0 x", "bracket.ev: \"x\" is not a number in -16..16");
    contradiction("bracket.ev = 17", "bracket.ev: \"17\" is not a number in -16..16");
    contradiction("bracket.ev = nan", "bracket.ev: \"nan\" is not a number in -16..16");
    contradiction("bracket.ev = 1 1 1 1 1 1 1 1 1 1", "bracket.ev: more than 9 exposures");
    contradiction("bracket.ev =\nbracket.mode = list",
                  "bracket.mode is list, but bracket.ev has no exposures");
    contradiction("bracket.middle_us = 100",
                  "bracket.mode is auto, which has no use for bracket.middle_us");
    contradiction("http.address = 0.0.0.0",
                  "http.address 0.0.0.0 is open to others: http.token must be set, or the address "
                  "be 127.0.0.1");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(shipped_file_equals_the_table),
        cmocka_unit_test(words_texts_and_numbered_keys),
        cmocka_unit_test(one_camera_collects),
        cmocka_unit_test(contradictions_name_both_keys),
        cmocka_unit_test(later_values_win),
        cmocka_unit_test(sentences_name_file_line_and_bound),
        cmocka_unit_test(hostile_files_are_refused),
        cmocka_unit_test(assignments_are_checked),
        cmocka_unit_test(layers_are_read_in_order),
        cmocka_unit_test(printed_settings_read_back),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
