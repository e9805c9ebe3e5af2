/* Splats without a sidecar of their own have what their file tells: radiance, or sRGB at its ev. */
#include "firmware/result/sceneio.h"

#include "firmware/result/viewer.h"

#include "core/base/log.h"
#include "core/base/num.h"
#include "core/splat/display.h"
#include "drivers/format/dotsplat.h"
#include "drivers/format/glb.h"
#include "drivers/format/ksplat.h"
#include "drivers/format/origin.h"
#include "drivers/format/partial.h"
#include "drivers/format/ply.h"
#include "drivers/format/scenefile.h"
#include "drivers/format/sidecar.h"
#include "drivers/format/sog.h"
#include "drivers/format/spz.h"
#include "drivers/format/spzwrite.h"

#include <math.h>
#include <string.h>

enum kind { HDRIG, PLY, SPZ, GLB, SPLAT, KSPLAT, SOG, HTML, KINDS };
static const char *const ends[KINDS] = {".hdrig", ".ply",    ".spz", ".glb",
                                        ".splat", ".ksplat", ".sog", ".html"};

static const struct splats_format *const formats[KINDS] = {
    [PLY] = &ply_format,        [SPZ] = &spz_format,       [GLB] = &glb_format,
    [SPLAT] = &dotsplat_format, [KSPLAT] = &ksplat_format, [SOG] = &sog_format};

static bool has_sidecar(enum kind kind)
{
    return formats[kind] != NULL;
}

static err_t kind_of(const char *path, enum kind *out)
{
    size_t n = strlen(path);
    for (int k = 0; k < KINDS; k++) {
        size_t m = strlen(ends[k]);
        *out = (enum kind)k;
        if (n > m && strcmp(path + n - m, ends[k]) == 0)
            return OK;
    }
    return err_fail(ERR_ARG,
                    "%s: scenes are files .hdrig, .ply, .spz and .glb; .splat, .ksplat, .sog and "
                    "its meta.json are read, .html is written",
                    path);
}

/* ---- reading ---- */

/* The file of a folder: of a result, or of SOG that is not packed. */
static err_t find_in_folder(const char *path, char file[FILE_PATH_CAP], enum kind *kind)
{
    char meta[FILE_PATH_CAP];
    *kind = HDRIG;
    err_t e = file_join(path, "scene.hdrig", file);
    if (!e)
        e = file_join(path, SOG_META, meta);
    if (!e && !file_exists(file) && file_exists(meta)) {
        *kind = SOG;
        strcpy(file, meta);
    }
    return e;
}

/* The file of a folder, or the path as it is. */
static err_t find_file(const char *path, char file[FILE_PATH_CAP], enum kind *kind)
{
    err_t e = OK;
    if (file_is_dir(path))
        return find_in_folder(path, file, kind);
    if (strcmp(file_name(path), SOG_META) == 0)
        *kind = SOG;
    else
        e = kind_of(path, kind);
    if (!e && *kind == HTML)
        e = err_fail(ERR_ARG, "%s: pages are written, not read", path);
    if (!e && strlen(path) >= FILE_PATH_CAP)
        e = err_fail(ERR_ARG, "%.64s...: a path of more than %d bytes", path, FILE_PATH_CAP - 1);
    if (!e)
        strcpy(file, path);
    return e;
}

static err_t peek_scenefile(const char *path, struct sceneio_info *out)
{
    struct scenefile_info info;
    err_t e = scenefile_peek(path, &info);
    if (!e)
        *out = (struct sceneio_info){.n = info.n,
                                     .degree = info.degree,
                                     .n_views = info.n_views,
                                     .size = info.size,
                                     .has_hdr = true,
                                     .need = info.need};
    return e;
}

err_t sceneio_peek(const char *path, struct sceneio_info *out)
{
    char file[FILE_PATH_CAP];
    enum kind kind;
    struct splats_info splats;
    struct sidecar_info side;
    memset(out, 0, sizeof *out);
    err_t e = find_file(path, file, &kind);
    if (e || kind == HDRIG)
        return e ? e : peek_scenefile(file, out);
    e = splats_peek(formats[kind], file, &splats);
    if (!e)
        e = sidecar_peek(file, &side);
    if (e)
        return e;
    out->n_views = side.n_views;
    out->n = splats.n;
    out->degree = splats.degree;
    out->size = SIDECAR_SIZE;
    out->has_hdr = splats.has_hdr;
    out->has_sidecar = side.found;
    out->ev = splats.ev;
    out->headroom = formats[kind]->headroom;
    out->band_lost = splats.band_lost;
    out->need = arena_add(side.need, gaussians_need(splats.n, splats.degree));
    return OK;
}

static err_t read_splats(const char *path, enum kind kind, struct arena *a, struct scene *s,
                         struct gaussians_report *report)
{
    struct splats_info splats;
    struct sidecar_info side;
    err_t e = splats_peek(formats[kind], path, &splats);
    if (!e)
        e = sidecar_peek(path, &side);
    if (!e)
        e = sidecar_read(path, splats.ev, a, s);
    if (e)
        return e;
    if (splats.hdr_stale)
        log_warn("%s: its radiance is not that of its display colours, as after a program that "
                 "rotates or recolours splats: it is not read",
                 path);
    float ev = side.found ? display_ev(&s->tone) : splats.ev;
    return splats_read(formats[kind], path, ev, a, &s->g, report);
}

err_t sceneio_read(const char *path, struct arena *a, struct scene *s,
                   struct gaussians_report *report)
{
    char file[FILE_PATH_CAP];
    enum kind kind;
    size_t mark = arena_mark(a);
    memset(s, 0, sizeof *s);
    *report = (struct gaussians_report){0};
    err_t e = find_file(path, file, &kind);
    if (!e)
        e = kind == HDRIG ? scenefile_read(file, a, s) : read_splats(file, kind, a, s, report);
    if (e) {
        arena_reset(a, mark);
        memset(s, 0, sizeof *s);
    }
    return e;
}

/* ---- what reading found ---- */

#define BRIGHT 0.01 // natural logarithm: more than rounding above white

/* Splats of which some colour is brighter than white where the tone curve shows sRGB. */
static int count_bright(const struct scene *s)
{
    const double shift = log(2) * (double)display_ev(&s->tone);
    int n = 0;
    for (int i = 0; i < s->g.n; i++) {
        float most = -INFINITY;
        for (int c = 0; c < 3; c++)
            most = fmaxf(most, s->g.plane[G_SH + c][i]);
        n += SH_BASIS0 * (double)most + shift > BRIGHT;
    }
    return n;
}

/* Display colours: their exposure, and light above white. */
static void warn_display(const char *path, const struct sceneio_info *info, const struct scene *s)
{
    int bright = count_bright(s), n = s->g.n;
    if (info->has_sidecar)
        log_warn("%s: display colours, taken as sRGB at the middle exposure of its sidecar", path);
    else if (info->ev != 0)
        log_warn("%s: display colours, taken as sRGB at its own %.2f stops", path,
                 (double)info->ev);
    else
        log_warn("%s: display colours, taken as sRGB; their exposure is not known", path);
    if (bright == 0)
        log_warn("%s: no splat is brighter than white: if the scene had brighter light, it is lost",
                 path);
    else if (isfinite(info->headroom))
        log_warn("%s: %d of %d splats are brighter than white: light more than %.1f stops above "
                 "it is lost",
                 path, bright, n, (double)info->headroom);
    else
        log_warn("%s: %d of %d splats are brighter than white and are kept", path, bright, n);
}

void sceneio_warn(const char *path, const struct sceneio_info *info, const struct scene *s,
                  const struct gaussians_report *r)
{
    if (!info->has_hdr)
        warn_display(path, info, s);
    if (info->band_lost)
        log_warn("%s: display colours of degree 4: the highest band is left out", path);
    if (r->dropped > 0)
        log_warn("%s: %d splats were not finite and are left out", path, r->dropped);
    if (r->repaired > 0)
        log_warn("%s: %d splats had values out of range, which were brought back", path,
                 r->repaired);
}

/* ---- writing ---- */

err_t sceneio_check_place(const char *path, bool *readable)
{
    enum kind kind;
    *readable = false;
    err_t e = kind_of(path, &kind);
    if (!e && (kind == SPLAT || kind == KSPLAT || kind == SOG))
        e = err_fail(ERR_ARG, "%s: such files are read, not written", path);
    if (!e && file_is_dir(path))
        e = err_fail(ERR_ARG, "%s: a folder", path);
    if (!e)
        e = origin_check_place(path);
    if (!e && has_sidecar(kind))
        e = sidecar_check_place(path);
    *readable = !e && kind != HTML;
    return e;
}

static err_t write_kind(const char *path, enum kind kind, const struct scene *s,
                        const struct sceneio_format *f)
{
    struct viewer_input page = {
        .scene = s, .title = f->title ? f->title : "hdrig", .lossless = f->lossless};
    switch (kind) {
    case HDRIG:
        return scenefile_write(path, s);
    case PLY:
        return ply_write(path, s);
    case SPZ:
        return spzwrite_scene(path, s, f->spz);
    case GLB:
        return glb_write(path, s);
    default:
        return viewer_write(path, &page);
    }
}

static bool same_bytes(const char *a, const char *b)
{
    struct file_map m = {0}, n = {0};
    bool same = file_map(a, SIZE_MAX, &m) == OK && file_map(b, SIZE_MAX, &n) == OK && m.n == n.n &&
                memcmp(m.p, n.p, m.n) == 0;
    file_unmap(&m);
    file_unmap(&n);
    return same;
}

/* NAME.ply, NAME.spz and NAME.glb have one sidecar, `now`, which `next` would replace. */
static err_t check_siblings(const char *next, const char *now, const char *path, enum kind kind)
{
    char other[FILE_PATH_CAP];
    if (!file_exists(now) || same_bytes(next, now))
        return OK;
    for (int k = 0; k < KINDS; k++) {
        int n = snprintf(other, sizeof other, "%.*s%s", (int)(strlen(path) - strlen(ends[kind])),
                         path, ends[k]);
        if (k != (int)kind && has_sidecar((enum kind)k) && n < FILE_PATH_CAP && file_exists(other))
            return err_fail(ERR_ARG,
                            "%s belongs to %s too and would change: choose another name or remove "
                            "that file",
                            now, other);
    }
    return OK;
}

static err_t write_sidecar(const struct partial *p, const char *file, const char *path,
                           enum kind kind, const struct scene *s)
{
    char next[FILE_PATH_CAP], now[FILE_PATH_CAP];
    err_t e = sidecar_write(file, s);
    if (!e)
        e = sidecar_path(file, next, sizeof next);
    if (!e)
        e = sidecar_path(path, now, sizeof now);
    if (!e)
        e = check_siblings(next, now, path, kind);
    return e ? e : partial_show(p, now);
}

/* The splats come last, so that a reader that sees them finds their sidecar too. */
static err_t write_parts(const struct partial *p, const char *path, enum kind kind,
                         const struct scene *s, const struct sceneio_format *f)
{
    char file[FILE_PATH_CAP];
    err_t e = partial_path(p, path, file);
    if (!e)
        e = write_kind(file, kind, s, f);
    if (!e && has_sidecar(kind))
        e = write_sidecar(p, file, path, kind, s);
    return e ? e : partial_show(p, path);
}

err_t sceneio_write(const char *path, const struct scene *s, const struct sceneio_format *f)
{
    struct partial p = {0};
    enum kind kind;
    bool readable;
    err_t e = sceneio_check_place(path, &readable);
    if (!e)
        e = kind_of(path, &kind);
    if (!e)
        e = partial_open(path, &p);
    if (!e)
        e = write_parts(&p, path, kind, s, f);
    partial_close(&p);
    return e;
}

/* Colours as .spz has them, and what zstd takes; or a page. */
size_t sceneio_write_plan(int n, int degree)
{
    enum {
        SHOWN = 3 * (DISPLAY_DEGREE_MAX + 1) * (DISPLAY_DEGREE_MAX + 1),
        PACKING_MAX = 96 << 20
    };
    const struct scene s = {.g = {.n = n, .degree = degree}};
    const size_t packing = (size_t)n * 256 < PACKING_MAX ? (size_t)n * 256 : PACKING_MAX;
    return num_max_size((size_t)n * SHOWN + packing,
                        viewer_plan(&(struct viewer_input){.scene = &s}));
}
