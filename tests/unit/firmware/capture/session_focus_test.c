/* Takes with a camera that searches its focus: before anything else, when it is to, and what
 * becomes of the take when it finds none. libcamera is played (fakecamera); its pictures are dark,
 * which takes frames that are not proven, but takes them. */
#include "tests/unit/drivers/device/fakecamera/fakecamera.h"
#include "tests/unit/firmware/capture/session_rig.h"

#include "drivers/device/clocks.h"

#include <dlfcn.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <unistd.h>

#include <cmocka.h>

#define SECOND INT64_C(1000000000)
#define MODULE "../../drivers/device/fakecamera_72.so" // from this program's folder

static struct fakecamera *fake;
static void (*put)(int *field, int value);
static struct session *s;

static const struct fakecamera with_lens = {.n_cameras = 1,
                                            .id = {"/base/cam"},
                                            .model = {"imx708"},
                                            .lens = true,
                                            .search = 12,
                                            .dark = true,
                                            .delay = 2};

static void open_rig(const struct fakecamera *how, const char *options)
{
    char self[400], module[512], uri[1024];
    ssize_t n = readlink("/proc/self/exe", self, sizeof self - 1);
    assert_true(n > 0);
    self[n] = '\0';
    strrchr(self, '/')[1] = '\0';
    snprintf(module, sizeof module, "%s" MODULE, self);
    void *lib = dlopen(module, RTLD_NOW);
    assert_non_null(lib);
    fake = dlsym(lib, FAKECAMERA_SYMBOL);
    *(void **)&put = dlsym(lib, FAKECAMERA_PUT);
    *fake = *how;
    snprintf(uri, sizeof uri, "libcamera:cam%s,module=%s", options, module);
    struct session_config c = {.n = 1, .uri = {uri}, .format = CAMERA_RGGB16};
    if (session_open(&c, &s) != OK)
        fail_msg("%s", err_text());
}

static void begin(bool refocus)
{
    struct session_order o = {.mode = SESSION_LIST, .n = 2, .ev = {0, 2}, .middle_s = 0.004};
    o.refocus = refocus;
    if (session_begin(s, &o) != OK)
        fail_msg("%s", err_text());
}

static void turn(void)
{
    assert_int_equal(rig_turn(s), OK);
}

static struct take *end(void)
{
    struct take *t;
    int64_t limit = clocks_now() + 60 * SECOND;
    while (session_state(s) != SESSION_READY && clocks_now() < limit)
        turn();
    assert_int_equal(session_state(s), SESSION_READY);
    assert_int_equal(session_collect(s, &t), OK);
    return t;
}

static void check_take(const struct take *t, enum take_status status, const char *says)
{
    if (t->status != status || !strstr(t->reason, says))
        fail_msg("status %d: \"%s\" instead of \"%s\"", t->status, t->reason, says);
}

static void end_as(enum take_status status, const char *says)
{
    struct take *t = end();
    check_take(t, status, says);
    take_free(t);
}

static void close_rig(void)
{
    session_close(s);
    s = NULL;
    assert_int_equal(fake->wrong, 0);
    assert_int_equal(fake->running, 0);
}

/* Once after opening, and again only when that is asked for; every frame says where the lens is. */
static void searches_when_it_is_to(void **state)
{
    static const struct {
        bool refocus;
        int searches;
    } c[] = {{false, 1}, {false, 1}, {true, 2}, {false, 2}};
    (void)state;
    open_rig(&with_lens, ",focus=once");
    for (int i = 0; i < 30; i++)
        turn();
    assert_int_equal(fake->searches, 0);
    for (size_t i = 0; i < sizeof c / sizeof c[0]; i++) {
        begin(c[i].refocus);
        bool begins = i == 0 || c[i].refocus;
        assert_int_equal(session_state(s), begins ? SESSION_METERING : SESSION_SHOOTING);
        assert_true(!begins || strcmp(session_status(s), "focuses") == 0);
        struct take *t = end();
        check_take(t, TAKE_COMPLETE, "too dark");
        assert_int_equal(fake->searches, c[i].searches);
        assert_int_equal(t->n, 2);
        for (int k = 0; k < t->n; k++)
            assert_true(t->frame[k].lens_known && t->frame[k].lens == 3.25);
        take_free(t);
    }
    close_rig();
    open_rig(&with_lens, ",focus=2");
    begin(true);
    assert_int_equal(session_state(s), SESSION_SHOOTING);
    end_as(TAKE_COMPLETE, "too dark");
    assert_int_equal(fake->searches, 0);
    close_rig();
}

static void a_lens_that_moves_is_told(void **state)
{
    struct bracket_progress p = {0};
    (void)state;
    open_rig(&with_lens, ",focus=once");
    begin(false);
    while (session_state(s) != SESSION_READY && p.kept < 1) {
        turn();
        session_progress(s, &p);
    }
    put(&fake->nudge, 4);
    end_as(TAKE_COMPLETE, "; the lens of camera 1 moved between its frames");
    close_rig();
}

static void no_focus_no_take(void **state)
{
    struct fakecamera how = with_lens;
    (void)state;
    how.in_vain = true;
    open_rig(&how, ",focus=once");
    for (int i = 1; i <= 2; i++) {
        begin(false);
        struct take *t = end();
        assert_int_equal(t->n, 0);
        check_take(t, TAKE_ABORTED, "/base/cam: found no focus");
        take_free(t);
        assert_int_equal(fake->searches, i);
        assert_int_equal(session_state(s), SESSION_ARMED);
    }
    close_rig();
    how.search = 1 << 30;
    open_rig(&how, ",focus=once");
    begin(false);
    for (int i = 0; i < 10; i++)
        turn();
    session_cancel(s, "enough");
    end_as(TAKE_ABORTED, "enough");
    begin(true);
    put(&fake->unplug, 1);
    end_as(TAKE_ABORTED, "lost while it focused");
    put(&fake->unplug, 0);
    close_rig();
}

static int tear_down(void **state)
{
    (void)state;
    session_close(s);
    s = NULL;
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(searches_when_it_is_to, tear_down),
        cmocka_unit_test_teardown(a_lens_that_moves_is_told, tear_down),
        cmocka_unit_test_teardown(no_focus_no_take, tear_down)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
