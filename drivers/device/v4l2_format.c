/* VIDIOC_S_FMT adjusts a request instead of refusing it, so the answer is compared with the
 * request. Sizes and strides of the answer are bounded here; the bytes of a buffer are checked with
 * every frame. */
#include "drivers/device/v4l2_format.h"

#include <errno.h>
#include <linux/media-bus-format.h>
#include <linux/v4l2-subdev.h>
#include <linux/videodev2.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

enum { SIDE_MAX = 32768, LIST_MAX = 256, NAME = 5, TEXT = 200 };

struct pixel {
    enum camera_format format;
    uint32_t fourcc, bus;
    int bits;     // per sample
    int group;    // px that are stored together
    int together; // bytes of these
};

/* The best first: linear and deep, then colour without loss. */
static const struct pixel pixels[] = {
    {CAMERA_RGGB16, V4L2_PIX_FMT_SRGGB16, MEDIA_BUS_FMT_SRGGB16_1X16, 16, 1, 2},
    {CAMERA_BGGR16, V4L2_PIX_FMT_SBGGR16, MEDIA_BUS_FMT_SBGGR16_1X16, 16, 1, 2},
    {CAMERA_GRBG16, V4L2_PIX_FMT_SGRBG16, MEDIA_BUS_FMT_SGRBG16_1X16, 16, 1, 2},
    {CAMERA_GBRG16, V4L2_PIX_FMT_SGBRG16, MEDIA_BUS_FMT_SGBRG16_1X16, 16, 1, 2},
    {CAMERA_RGGB16, V4L2_PIX_FMT_SRGGB14, MEDIA_BUS_FMT_SRGGB14_1X14, 14, 1, 2},
    {CAMERA_BGGR16, V4L2_PIX_FMT_SBGGR14, MEDIA_BUS_FMT_SBGGR14_1X14, 14, 1, 2},
    {CAMERA_GRBG16, V4L2_PIX_FMT_SGRBG14, MEDIA_BUS_FMT_SGRBG14_1X14, 14, 1, 2},
    {CAMERA_GBRG16, V4L2_PIX_FMT_SGBRG14, MEDIA_BUS_FMT_SGBRG14_1X14, 14, 1, 2},
    {CAMERA_RGGB16, V4L2_PIX_FMT_SRGGB12, MEDIA_BUS_FMT_SRGGB12_1X12, 12, 1, 2},
    {CAMERA_BGGR16, V4L2_PIX_FMT_SBGGR12, MEDIA_BUS_FMT_SBGGR12_1X12, 12, 1, 2},
    {CAMERA_GRBG16, V4L2_PIX_FMT_SGRBG12, MEDIA_BUS_FMT_SGRBG12_1X12, 12, 1, 2},
    {CAMERA_GBRG16, V4L2_PIX_FMT_SGBRG12, MEDIA_BUS_FMT_SGBRG12_1X12, 12, 1, 2},
    {CAMERA_RGGB12P, V4L2_PIX_FMT_SRGGB12P, MEDIA_BUS_FMT_SRGGB12_1X12, 12, 2, 3},
    {CAMERA_BGGR12P, V4L2_PIX_FMT_SBGGR12P, MEDIA_BUS_FMT_SBGGR12_1X12, 12, 2, 3},
    {CAMERA_GRBG12P, V4L2_PIX_FMT_SGRBG12P, MEDIA_BUS_FMT_SGRBG12_1X12, 12, 2, 3},
    {CAMERA_GBRG12P, V4L2_PIX_FMT_SGBRG12P, MEDIA_BUS_FMT_SGBRG12_1X12, 12, 2, 3},
    {CAMERA_RGGB16, V4L2_PIX_FMT_SRGGB10, MEDIA_BUS_FMT_SRGGB10_1X10, 10, 1, 2},
    {CAMERA_BGGR16, V4L2_PIX_FMT_SBGGR10, MEDIA_BUS_FMT_SBGGR10_1X10, 10, 1, 2},
    {CAMERA_GRBG16, V4L2_PIX_FMT_SGRBG10, MEDIA_BUS_FMT_SGRBG10_1X10, 10, 1, 2},
    {CAMERA_GBRG16, V4L2_PIX_FMT_SGBRG10, MEDIA_BUS_FMT_SGBRG10_1X10, 10, 1, 2},
    {CAMERA_RGGB10P, V4L2_PIX_FMT_SRGGB10P, MEDIA_BUS_FMT_SRGGB10_1X10, 10, 4, 5},
    {CAMERA_BGGR10P, V4L2_PIX_FMT_SBGGR10P, MEDIA_BUS_FMT_SBGGR10_1X10, 10, 4, 5},
    {CAMERA_GRBG10P, V4L2_PIX_FMT_SGRBG10P, MEDIA_BUS_FMT_SGRBG10_1X10, 10, 4, 5},
    {CAMERA_GBRG10P, V4L2_PIX_FMT_SGBRG10P, MEDIA_BUS_FMT_SGBRG10_1X10, 10, 4, 5},
    {CAMERA_RGB8, V4L2_PIX_FMT_RGB24, 0, 8, 1, 3},
    {CAMERA_BGR8, V4L2_PIX_FMT_BGR24, 0, 8, 1, 3},
    {CAMERA_YUYV, V4L2_PIX_FMT_YUYV, 0, 8, 2, 4},
    {CAMERA_NV12, V4L2_PIX_FMT_NV12, 0, 8, 2, 2},
    {CAMERA_MJPG, V4L2_PIX_FMT_MJPEG, 0, 8, 0, 0},
    {CAMERA_MJPG, V4L2_PIX_FMT_JPEG, 0, 8, 0, 0},
    {CAMERA_GREY16, V4L2_PIX_FMT_Y16, 0, 16, 1, 2},
    {CAMERA_GREY16, V4L2_PIX_FMT_Y14, MEDIA_BUS_FMT_Y14_1X14, 14, 1, 2},
    {CAMERA_GREY16, V4L2_PIX_FMT_Y12, MEDIA_BUS_FMT_Y12_1X12, 12, 1, 2},
    {CAMERA_GREY16, V4L2_PIX_FMT_Y10, MEDIA_BUS_FMT_Y10_1X10, 10, 1, 2},
    {CAMERA_GREY, V4L2_PIX_FMT_GREY, MEDIA_BUS_FMT_Y8_1X8, 8, 1, 1},
};
enum { PIXELS = sizeof pixels / sizeof pixels[0] };

/* The fields that both kinds of struct v4l2_format have. */
struct answer {
    uint32_t w, h, fourcc, field, stride, bytes, colours, matrix, range, planes;
};

static uint32_t buf_type(bool mplane)
{
    return mplane ? V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE : V4L2_BUF_TYPE_VIDEO_CAPTURE;
}

/* ---- words ---- */

static const char *code_name(uint32_t fourcc, char out[NAME])
{
    for (int i = 0; i < 4; i++) {
        char c = (char)(fourcc >> (8 * i) & 0x7F);
        out[i] = c > ' ' ? c : '.';
    }
    out[4] = '\0';
    return out;
}

static void append_word(char list[TEXT], const char *word)
{
    size_t n = strlen(list);
    snprintf(list + n, TEXT - n, "%s%s", n ? " " : "", word);
}

static err_t no_format(const struct v4l2_node *n, const struct camera_cfg *cfg,
                       const char list[TEXT])
{
    char name[NAME] = "";
    for (int i = 0; i < PIXELS && !name[0]; i++)
        if (pixels[i].format == cfg->format)
            code_name(pixels[i].fourcc, name);
    return err_fail(ERR_UNSUPPORTED, "%s: no pictures in %s; it offers %s", n->path,
                    name[0] ? name : "a known format", list[0] ? list : "nothing");
}

static void list_sizes(const struct v4l2_node *n, uint32_t fourcc, char list[TEXT])
{
    list[0] = '\0';
    for (uint32_t i = 0; i < 16; i++) {
        char word[64];
        struct v4l2_frmsizeenum s = {.index = i, .pixel_format = fourcc};
        if (v4l2_sys_ioctl(n, VIDIOC_ENUM_FRAMESIZES, &s) != 0)
            return;
        if (s.type == V4L2_FRMSIZE_TYPE_DISCRETE)
            snprintf(word, sizeof word, "%ux%u", s.discrete.width, s.discrete.height);
        else
            snprintf(word, sizeof word, "%ux%u..%ux%u", s.stepwise.min_width, s.stepwise.min_height,
                     s.stepwise.max_width, s.stepwise.max_height);
        append_word(list, word);
        if (s.type != V4L2_FRMSIZE_TYPE_DISCRETE)
            return;
    }
}

/* ---- choice ---- */

static err_t choose_format(const struct v4l2_node *n, const struct camera_cfg *cfg, bool mplane,
                           const struct pixel **out)
{
    char list[TEXT] = "";
    *out = NULL;
    for (uint32_t i = 0; i < LIST_MAX; i++) {
        char name[NAME];
        struct v4l2_fmtdesc d = {.index = i, .type = buf_type(mplane)};
        int number = v4l2_sys_ioctl(n, VIDIOC_ENUM_FMT, &d);
        if (number == EINVAL)
            break;
        if (number)
            return v4l2_sys_fail(n, number, "list its pixel formats");
        append_word(list, code_name(d.pixelformat, name));
        for (const struct pixel *p = pixels; p < pixels + PIXELS; p++)
            if (p->fourcc == d.pixelformat && (!*out || p < *out) &&
                (cfg->format == CAMERA_ANY || cfg->format == p->format))
                *out = p;
    }
    return *out ? OK : no_format(n, cfg, list);
}

static struct answer read_format(const struct v4l2_format *f, bool mplane)
{
    const struct v4l2_pix_format *p = &f->fmt.pix;
    const struct v4l2_pix_format_mplane *m = &f->fmt.pix_mp;
    if (mplane)
        return (struct answer){m->width,
                               m->height,
                               m->pixelformat,
                               m->field,
                               m->plane_fmt[0].bytesperline,
                               m->plane_fmt[0].sizeimage,
                               m->colorspace,
                               m->ycbcr_enc,
                               m->quantization,
                               m->num_planes};
    return (struct answer){
        p->width,     p->height,     p->pixelformat, p->field,        p->bytesperline,
        p->sizeimage, p->colorspace, p->ycbcr_enc,   p->quantization, 1};
}

/* Colour space stays with the driver, which knows its own output. */
static void ask_format(struct v4l2_format *f, bool mplane, const struct answer *a)
{
    *f = (struct v4l2_format){.type = buf_type(mplane)};
    if (mplane) {
        f->fmt.pix_mp.width = a->w;
        f->fmt.pix_mp.height = a->h;
        f->fmt.pix_mp.pixelformat = a->fourcc;
        f->fmt.pix_mp.field = V4L2_FIELD_NONE;
        f->fmt.pix_mp.num_planes = 1;
    } else {
        f->fmt.pix.width = a->w;
        f->fmt.pix.height = a->h;
        f->fmt.pix.pixelformat = a->fourcc;
        f->fmt.pix.field = V4L2_FIELD_NONE;
    }
}

static err_t check_answer(const struct v4l2_node *n, const struct answer *requested,
                          const struct answer *got)
{
    char a[NAME], b[NAME], sizes[TEXT];
    if (got->w != requested->w || got->h != requested->h || got->fourcc != requested->fourcc) {
        list_sizes(n, requested->fourcc, sizes);
        return err_fail(ERR_UNSUPPORTED,
                        "%s: asked for %ux%u px in %s, the driver came back with %ux%u px in %s; "
                        "sizes it names: %s",
                        n->path, requested->w, requested->h, code_name(requested->fourcc, a),
                        got->w, got->h, code_name(got->fourcc, b), sizes[0] ? sizes : "none");
    }
    if (got->planes != 1)
        return err_fail(ERR_UNSUPPORTED, "%s: %s in %u planes, only 1 is supported", n->path,
                        code_name(got->fourcc, b), got->planes);
    if (got->field != V4L2_FIELD_NONE && got->field != V4L2_FIELD_ANY)
        return err_fail(ERR_UNSUPPORTED, "%s: interlaced pictures (field order %u)", n->path,
                        got->field);
    return OK;
}

static err_t bound_layout(const struct v4l2_node *n, const struct pixel *p,
                          const struct answer *got, struct v4l2_layout *out)
{
    size_t w = got->w, rows = p->format == CAMERA_NV12 ? (size_t)got->h / 2 * 3 : got->h;
    if (got->w < 1 || got->h < 1 || got->w > SIDE_MAX || got->h > SIDE_MAX)
        return err_fail(ERR_UNSUPPORTED, "%s: pictures of %ux%u px, sides must be in 1..%d",
                        n->path, got->w, got->h, SIDE_MAX);
    out->least = 0;
    out->stride = 0;
    if (p->group == 0)
        return OK;
    size_t group = (size_t)p->group;
    size_t row = (w + group - 1) / group * (size_t)p->together;
    if (got->stride < row || got->stride > 16 * row + 65536)
        return err_fail(ERR_UNSUPPORTED, "%s: %u bytes from row to row, a row of %u px has %zu",
                        n->path, got->stride, got->w, row);
    out->stride = (int)got->stride;
    out->least = (rows - 1) * got->stride + row;
    if (got->bytes < out->least)
        return err_fail(ERR_UNSUPPORTED, "%s: pictures of %u bytes, %ux%u px need %zu", n->path,
                        got->bytes, got->w, got->h, out->least);
    return OK;
}

static void set_colours(const struct pixel *p, const struct answer *got, struct v4l2_layout *out)
{
    uint32_t matrix = got->matrix, range = got->range;
    bool yuv = p->format == CAMERA_YUYV || p->format == CAMERA_NV12;
    if (matrix == V4L2_YCBCR_ENC_DEFAULT)
        matrix = V4L2_MAP_YCBCR_ENC_DEFAULT(got->colours);
    if (range == V4L2_QUANTIZATION_DEFAULT)
        range = V4L2_MAP_QUANTIZATION_DEFAULT(false, got->colours, matrix);
    out->limited = yuv && range == V4L2_QUANTIZATION_LIM_RANGE;
    out->bt709 = yuv && (matrix == V4L2_YCBCR_ENC_709 || matrix == V4L2_YCBCR_ENC_XV709);
}

err_t v4l2_format_set(const struct v4l2_node *n, const struct camera_cfg *cfg,
                      struct v4l2_layout *out)
{
    const struct pixel *p;
    err_t e = choose_format(n, cfg, out->mplane, &p);
    if (e)
        return e;
    struct v4l2_format f = {.type = buf_type(out->mplane)};
    int number = v4l2_sys_ioctl(n, VIDIOC_G_FMT, &f);
    if (number)
        return v4l2_sys_fail(n, number, "tell its pixel format");
    struct answer requested = read_format(&f, out->mplane);
    requested.w = cfg->w ? (uint32_t)cfg->w : requested.w;
    requested.h = cfg->h ? (uint32_t)cfg->h : requested.h;
    requested.fourcc = p->fourcc;
    ask_format(&f, out->mplane, &requested);
    number = v4l2_sys_ioctl(n, VIDIOC_S_FMT, &f);
    if (number)
        return v4l2_sys_fail(n, number, "set its pixel format");
    struct answer got = read_format(&f, out->mplane);
    e = check_answer(n, &requested, &got);
    if (!e)
        e = bound_layout(n, p, &got, out);
    if (e)
        return e;
    out->format = p->format;
    out->fourcc = p->fourcc;
    out->bus = p->bus;
    out->bits = p->bits;
    out->w = (int)got.w;
    out->h = (int)got.h;
    set_colours(p, &got, out);
    return OK;
}

/* ---- pace ---- */

static double fract_seconds(struct v4l2_fract f)
{
    double s = f.denominator ? (double)f.numerator / f.denominator : 0.0;
    return s >= 1e-5 && s <= 3600.0 ? s : 0.0; // else not credible
}

/* 1e-3: 33 ms are meant to fit into 1/30 s, and 1/29.97 into that. */
static bool is_better_pace(double s, double best, double longest_s)
{
    bool fits = s >= longest_s * 0.999, best_fits = best >= longest_s * 0.999;
    if (fits != best_fits)
        return fits;
    return fits ? s < best : s > best;
}

static struct v4l2_fract pick_pace(const struct v4l2_node *n, const struct v4l2_frmivalenum *of,
                                   double longest_s)
{
    struct v4l2_fract best = {0};
    for (uint32_t i = 0; i < LIST_MAX; i++) {
        struct v4l2_frmivalenum v = *of;
        v.index = i;
        if (v4l2_sys_ioctl(n, VIDIOC_ENUM_FRAMEINTERVALS, &v) != 0)
            break;
        if (v.type != V4L2_FRMIVAL_TYPE_DISCRETE) {
            double lo = fract_seconds(v.stepwise.min), hi = fract_seconds(v.stepwise.max);
            double us = fmin(fmax(longest_s, lo), hi) * 1e6;
            return (struct v4l2_fract){(uint32_t)us, 1000000};
        }
        double s = fract_seconds(v.discrete);
        if (s > 0.0 && (!best.denominator || is_better_pace(s, fract_seconds(best), longest_s)))
            best = v.discrete;
    }
    return best;
}

err_t v4l2_format_pace(const struct v4l2_node *n, const struct v4l2_layout *l, double longest_s,
                       double *period_s)
{
    struct v4l2_streamparm parm = {.type = buf_type(l->mplane)};
    *period_s = 0.0;
    int number = v4l2_sys_ioctl(n, VIDIOC_G_PARM, &parm);
    if (number == ENODEV)
        return v4l2_sys_fail(n, number, "tell its pace");
    if (number)
        return OK; // has none
    struct v4l2_frmivalenum of = {
        .pixel_format = l->fourcc, .width = (uint32_t)l->w, .height = (uint32_t)l->h};
    struct v4l2_fract want = pick_pace(n, &of, longest_s);
    if (want.numerator && want.denominator &&
        (parm.parm.capture.capability & V4L2_CAP_TIMEPERFRAME)) {
        struct v4l2_streamparm set = {.type = parm.type};
        set.parm.capture.timeperframe = want;
        number = v4l2_sys_ioctl(n, VIDIOC_S_PARM, &set);
        if (number == EBUSY || number == ENODEV)
            return v4l2_sys_fail(n, number, "set its pace");
        if (!number)
            parm = set;
    }
    *period_s = fract_seconds(parm.parm.capture.timeperframe);
    return OK;
}

/* ---- sensor ---- */

err_t v4l2_format_pad(const struct v4l2_node *sub, const struct v4l2_layout *l)
{
    struct v4l2_subdev_format f = {.which = V4L2_SUBDEV_FORMAT_ACTIVE};
    int number = v4l2_sys_ioctl(sub, VIDIOC_SUBDEV_G_FMT, &f);
    if (number)
        return v4l2_sys_fail(sub, number, "tell the format of its pad");
    uint32_t code = l->bus ? l->bus : f.format.code;
    if ((int)f.format.width != l->w || (int)f.format.height != l->h || f.format.code != code) {
        f.format.width = (uint32_t)l->w;
        f.format.height = (uint32_t)l->h;
        f.format.code = code;
        number = v4l2_sys_ioctl(sub, VIDIOC_SUBDEV_S_FMT, &f);
        if (number)
            return v4l2_sys_fail(sub, number, "set the format of its pad");
    }
    if ((int)f.format.width != l->w || (int)f.format.height != l->h || f.format.code != code)
        return err_fail(ERR_UNSUPPORTED,
                        "%s: the sensor makes %ux%u px with bus code 0x%04x, the pictures are "
                        "%dx%d px with 0x%04x",
                        sub->path, f.format.width, f.format.height, f.format.code, l->w, l->h,
                        code);
    return OK;
}
