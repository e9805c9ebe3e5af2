#include "drivers/format/pixels.h"

#include "core/photo/develop.h"
#include "core/photo/undistort.h"
#include "drivers/format/exrfile.h"
#include "drivers/format/file.h"
#include "drivers/format/imgsize.h"
#include "drivers/format/masks.h"
#include "drivers/format/photofile.h"
#include "drivers/format/rawframe.h"

#include <stdlib.h>
#include <string.h>

enum { WHITE = 65535 };

err_t pixels_look(const char *path, struct shot *s)
{
    struct file_map m;
    err_t e = file_map(path, IMG_FILE_MAX, &m);
    if (e)
        return e;
    const struct photofile *photo = photofile_of(m.p, m.n);
    s->linear = photo ? photo->linear : imgsize_is_exr(m.p, m.n);
    s->deep = photo || s->linear || img_is_deep(m.p, m.n, &s->linear);
    file_unmap(&m);
    return OK;
}

void pixels_free16(struct image16 *im)
{
    free(im->px);
    *im = (struct image16){0};
}

size_t pixels_bytes(const struct shot *s)
{
    return s->deep ? 3 * (sizeof(uint16_t) + 2 * sizeof(float)) : 3; // OpenEXR: floats and its own
}

/* ---- what files say ---- */

/* False if photofile.h does not know it, or it is damaged; the readers of pictures then say why. */
static bool look_photo(const char *path, struct img_info *out)
{
    struct file_map m;
    if (file_map(path, IMG_FILE_MAX, &m) != OK)
        return false;
    const struct photofile *photo = photofile_of(m.p, m.n);
    const bool good = photo && photo->look(m.p, m.n, path, out) == OK;
    file_unmap(&m);
    return good;
}

err_t pixels_exif(const char *path, struct img_exif *out)
{
    struct img_info info;
    if (!look_photo(path, &info))
        return img_exif(path, out);
    *out = info.exif;
    return out->seconds > 0
               ? OK
               : err_fail(ERR_FORMAT, "%s: no ExposureTime above 0 in its EXIF data", path);
}

err_t pixels_camera(const char *path, struct img_camera *out)
{
    struct img_info info;
    if (!look_photo(path, &info))
        return img_camera(path, out);
    *out = info.camera;
    return OK;
}

/* ---- linear values ---- */

static err_t encode_exr(const char *path, const struct image *in, struct image16 *out)
{
    const size_t n = (size_t)in->w * (size_t)in->h;
    size_t above = 0;
    *out = (struct image16){in->w, in->h, 3, malloc(3 * n * sizeof *out->px)};
    if (!out->px)
        return err_fail(ERR_NOMEM, "%s: no memory for %d x %d px", path, in->w, in->h);
    for (size_t i = 0; i < 3 * n; i++) {
        const float v = in->px[i % 3 * n + i / 3];
        above += v > 1;
        out->px[i] = develop_srgb16(v);
    }
    if (above > 3 * n / 2)
        return err_fail(ERR_FORMAT,
                        "%s: %.0f %% of its values are above 1; linear photographs must have the "
                        "value 1 where the sensor is full: divide them, and their exposures, by "
                        "one number",
                        path, 100.0 * (double)above / (double)(3 * n));
    return OK;
}

static err_t read_exr(const struct file_map *m, const char *path, struct image16 *out)
{
    struct image im;
    err_t e = exrfile_read_mem(m->p, m->n, path, &im);
    if (!e)
        e = encode_exr(path, &im, out);
    exrfile_free(&im);
    return e;
}

static err_t read_png16(const struct file_map *m, const char *path, struct image16 *out)
{
    bool linear;
    err_t e = img_read16_mem(m->p, m->n, path, out);
    if (e || !img_is_deep(m->p, m->n, &linear) || !linear)
        return e;
    for (size_t i = 0; i < 3 * (size_t)out->w * (size_t)out->h; i++)
        out->px[i] = develop_srgb16((float)out->px[i] / WHITE);
    return OK;
}

/* ---- decoding ---- */

static err_t check_size(const char *path, const struct shot *s, int w, int h)
{
    if (w != s->taken_w || h != s->taken_h)
        return err_fail(ERR_FORMAT, "%s: %d x %d px, but its header said %d x %d before", path, w,
                        h, s->taken_w, s->taken_h);
    return OK;
}

/* The photograph becomes the picture of its pinhole. */
static err_t undistort_photo8(const char *path, const struct shot *s, struct image8 *im)
{
    struct image8 out = {s->cam.w, s->cam.h, 3, NULL};
    out.px = malloc((size_t)out.w * (size_t)out.h * 3);
    if (!out.px)
        return err_fail(ERR_NOMEM, "%s: no memory for %d x %d px", path, out.w, out.h);
    err_t e = undistort_image8(NULL, &s->lens, im, &s->cam, out.px);
    img_free(im);
    *im = out;
    return e;
}

err_t pixels_decode_mask(const char *photograph, const struct shot *s, struct image8 *out)
{
    char path[FILE_PATH_CAP];
    bool found;
    err_t e = masks_find(photograph, &found, path);
    if (!e && !found)
        e = err_fail(ERR_IO, "%s: its mask is gone", photograph);
    if (!e)
        e = img_read(path, out);
    if (!e)
        e = check_size(path, s, out->w, out->h);
    for (int i = 0; i < out->w * out->h && !e; i++) {
        uint8_t *p = out->px + 3 * (size_t)i;
        memset(p, p[0] || p[1] || p[2] ? 255 : 0, 3);
    }
    if (!e && s->lens.model != LENS_PINHOLE)
        e = undistort_photo8(path, s, out);
    if (e)
        img_free(out);
    return e;
}

static err_t undistort_photo16(const char *path, const struct shot *s, struct image16 *im)
{
    struct image16 out = {s->cam.w, s->cam.h, 3, NULL};
    out.px = malloc((size_t)out.w * (size_t)out.h * 3 * sizeof *out.px);
    if (!out.px)
        return err_fail(ERR_NOMEM, "%s: no memory for %d x %d px", path, out.w, out.h);
    err_t e = undistort_image16(NULL, &s->lens, im, &s->cam, out.px);
    pixels_free16(im);
    *im = out;
    return e;
}

static err_t read_file16(const char *path, struct image16 *out)
{
    struct file_map m;
    err_t e = file_map(path, IMG_FILE_MAX, &m);
    const struct photofile *photo = e ? NULL : photofile_of(m.p, m.n);
    if (photo)
        e = photo->read(m.p, m.n, path, out);
    else if (!e)
        e = imgsize_is_exr(m.p, m.n) ? read_exr(&m, path, out) : read_png16(&m, path, out);
    file_unmap(&m);
    return e;
}

err_t pixels_decode16(const char *path, const struct shot *s, struct image16 *out)
{
    *out = (struct image16){0};
    err_t e = s->raw ? rawframe_read(s->raw, out) : read_file16(path, out);
    if (!e)
        e = check_size(path, s, out->w, out->h);
    if (!e && s->lens.model != LENS_PINHOLE)
        e = undistort_photo16(path, s, out);
    if (e)
        pixels_free16(out);
    return e;
}

static err_t round_deep(const char *path, const struct shot *s, struct image8 *out)
{
    struct image16 deep;
    err_t e = pixels_decode16(path, s, &deep);
    if (e)
        return e;
    const size_t n = 3 * (size_t)deep.w * (size_t)deep.h;
    *out = (struct image8){deep.w, deep.h, 3, malloc(n)};
    if (!out->px)
        e = err_fail(ERR_NOMEM, "%s: no memory for %d x %d px", path, deep.w, deep.h);
    for (size_t i = 0; i < n && !e; i++)
        out->px[i] = (uint8_t)((deep.px[i] + 128) / 257);
    pixels_free16(&deep);
    return e;
}

err_t pixels_decode(const char *path, const struct shot *s, struct image8 *out)
{
    memset(out, 0, sizeof *out);
    if (s->deep)
        return round_deep(path, s, out);
    err_t e = img_read(path, out);
    if (!e)
        e = check_size(path, s, out->w, out->h);
    if (!e && s->lens.model != LENS_PINHOLE)
        e = undistort_photo8(path, s, out);
    if (e)
        img_free(out);
    return e;
}
