/* Cameras of libcamera: checks that the module was built from the same structs, and forwards every
 * call. */
#include "drivers/device/camera.h"

#include "drivers/device/focus.h"
#include "drivers/device/libcamera_shim.h"
#include "drivers/device/module.h"
#include "drivers/device/uri.h"

#include <stdlib.h>
#include <string.h>

static const char scheme[] = "libcamera:";

#define LENS_MOST 1000.0 // 1/m

struct state {
    const struct libcamera_shim *shim;
    struct libcamera_shim_camera *camera;
};

struct options {
    char camera[URI_TEXT], module[URI_TEXT], focus[URI_TEXT];
    int stamp, sync;
};

#define AT(field) offsetof(struct options, field)
static const struct uri_key keys[] = {
    {"stamp", AT(stamp), URI_WORD, 0, 0, "start|end"},
    {"focus", AT(focus), URI_STRING, 0, 0, NULL},
    {"sync", AT(sync), URI_WORD, 0, 0, "off|server|client|wired"},
    {"module", AT(module), URI_STRING, 0, 0, NULL},
};

static err_t parse_uri(const char *uri, struct options *o)
{
    size_t skip = sizeof scheme - 1;
    *o = (struct options){.stamp = CAMERA_STAMP_END};
    if (strncmp(uri, scheme, skip) != 0)
        return err_fail(ERR_ARG, "%.64s: does not begin with \"%s\"", uri, scheme);
    size_t n = strcspn(uri + skip, ",");
    if (n >= sizeof o->camera)
        return err_fail(ERR_ARG, "libcamera: the name of a camera has %zu bytes, at most %zu", n,
                        sizeof o->camera - 1);
    memcpy(o->camera, uri + skip, n);
    const char *rest = uri + skip + n;
    return uri_parse("libcamera", rest + (*rest == ','),
                     &(struct uri_table){keys, sizeof keys / sizeof keys[0], o}, 1);
}

static err_t load_module(const struct options *o, const struct libcamera_shim **out)
{
    static const struct module module = {
        .what = "libcamera",
        .file = "hdrig-libcamera.so",
        .package = "libcamera-dev",
        .needs = "the package of that library (libcamera0.0.3 on Debian 12, and libcamera-ipa)",
        .table = LIBCAMERA_SHIM_TABLE};
    const void *table;
    setenv("LIBCAMERA_LOG_LEVELS", "*:WARN", 0); // it would print a greeting to stderr
    err_t e = module_load(&module, o->module, &table);
    if (e)
        return e;
    *out = table;
    if ((*out)->stamp != LIBCAMERA_SHIM_STAMP)
        e = err_fail(ERR_UNSUPPORTED,
                     "libcamera: %s was built for another version of this program (%x)",
                     o->module[0] ? o->module : module.file, (*out)->stamp);
    return e;
}

/* The sentence of an error is in the module. */
static err_t pass_error(const struct state *s, err_t e)
{
    return e == OK || e == ERR_AGAIN ? e : err_fail(e, "%s", s->shim->text());
}

static err_t lib_open(void *st, const struct camera_cfg *cfg)
{
    struct state *s = st;
    struct options o;
    struct focus focus;
    memset(s, 0, sizeof *s);
    err_t e = parse_uri(cfg->uri, &o);
    if (!e)
        e = focus_parse("libcamera", o.focus, LENS_MOST, &focus);
    if (!e && (cfg->buffers < 0 || cfg->buffers > CAMERA_BUFFERS_MAX))
        e = err_fail(ERR_ARG, "libcamera: %d buffers, not 0..%d", cfg->buffers, CAMERA_BUFFERS_MAX);
    if (!e)
        e = load_module(&o, &s->shim);
    if (e)
        return e;
    struct libcamera_shim_cfg how = {o.camera, *cfg, (enum camera_stamp)o.stamp, focus,
                                     (enum libcamera_sync)o.sync};
    return pass_error(s, s->shim->open(&how, &s->camera));
}

static void lib_close(void *st)
{
    struct state *s = st;
    s->shim->close(s->camera);
    s->camera = NULL;
}

static void lib_info(const void *st, struct camera_info *out)
{
    const struct state *s = st;
    s->shim->info(s->camera, out);
}

static int lib_fd(const void *st)
{
    const struct state *s = st;
    return s->shim->fd(s->camera);
}

static err_t lib_request(void *st, const struct exposure *requested, struct exposure *set)
{
    struct state *s = st;
    return pass_error(s, s->shim->request(s->camera, requested, set));
}

static err_t lib_next(void *st, struct frame *out)
{
    struct state *s = st;
    return pass_error(s, s->shim->next(s->camera, out));
}

static void lib_release(void *st, struct frame *f)
{
    struct state *s = st;
    s->shim->release(s->camera, f);
}

static err_t lib_focus(void *st, bool again)
{
    struct state *s = st;
    return pass_error(s, s->shim->focus(s->camera, again));
}

const struct camera_ops camera_libcamera = {.name = "libcamera",
                                            .state_bytes = sizeof(struct state),
                                            .open = lib_open,
                                            .close = lib_close,
                                            .info = lib_info,
                                            .fd = lib_fd,
                                            .request = lib_request,
                                            .next = lib_next,
                                            .release = lib_release,
                                            .focus = lib_focus};
