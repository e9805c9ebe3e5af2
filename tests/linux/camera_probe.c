/* Opens a camera and does what it is told, a line of output for everything:
 *   camera_probe URI [WxH] [FORMAT] OPERATION...
 *   ask US     request an exposure time; tells what the device says that it has set
 *   frames N   take N frames: steps of sequence and of time, flags, and their truth, if it is
 *              usbcam that sends them
 *   until US   take frames until the truth is that exposure; tells how many
 *   reopen N   close and open, N times, each with a frame; an error is told, and the next try made
 *   control ID=VALUE   set a control of the node, as another program would
 * Exits with 0, 1 after an error, 2 when the camera cannot be opened. */
#include "tests/linux/truth.h"

#include "drivers/device/camera.h"
#include "drivers/device/unpack.h"
#include "firmware/base/backends.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <unistd.h>

static const char *const formats[CAMERA_FORMATS] = {
    "any",     "rgb8",    "bgr8",    "yuyv",    "nv12",    "mjpg",    "grey",
    "grey16",  "rggb16",  "bggr16",  "grbg16",  "gbrg16",  "rggb10p", "bggr10p",
    "grbg10p", "gbrg10p", "rggb12p", "bggr12p", "grbg12p", "gbrg12p"};

struct probe {
    const struct camera_ops *ops;
    void *st;
    struct camera_cfg cfg;
    struct camera_info info;
    bool is_open;
    uint32_t sequence;
    int64_t stamp_ns;
};

static err_t open_it(struct probe *p)
{
    err_t e = p->ops->open(p->st, &p->cfg);
    p->is_open = e == OK;
    if (!e)
        p->ops->info(p->st, &p->info);
    p->stamp_ns = 0;
    return e;
}

static err_t wait_frame(struct probe *p, struct frame *f)
{
    for (int i = 0; i < 50; i++) {
        struct pollfd fd = {.fd = p->ops->fd(p->st), .events = POLLIN};
        err_t e = p->ops->next(p->st, f);
        if (e != ERR_AGAIN)
            return e;
        poll(&fd, 1, 100);
    }
    return err_fail(ERR_TIMEOUT, "no frame in 5 s");
}

/* Means by channel; of a mosaic by place in its squares of 2 x 2. */
static void tell_means(const struct probe *p, const struct frame *f)
{
    struct raw raw = {.px = malloc(unpack_count(&p->info) * sizeof *raw.px)};
    double sum[4] = {0.0};
    if (raw.px && unpack_run(&p->info, f, &raw) == OK) {
        int n = raw.cfa == RAW_RGB ? 3 : raw.cfa == RAW_MONO ? 1 : 4;
        for (int i = 0; i < raw.w * raw.h; i++) {
            for (int c = 0; n == 3 && c < 3; c++)
                sum[c] += raw.px[3 * i + c];
            if (n != 3)
                sum[n == 1 ? 0 : i / raw.w % 2 * 2 + i % raw.w % 2] += raw.px[i];
        }
        printf(" mean");
        for (int c = 0; c < n; c++)
            printf(" %.2f", sum[c] / (raw.w * raw.h / (n == 4 ? 4 : 1)));
    } else {
        printf(" unusable: %s", err_text());
    }
    free(raw.px);
}

static void tell(struct probe *p, const struct frame *f)
{
    struct truth t;
    if (p->stamp_ns)
        printf("frame %+d %+.0f ms", (int)(f->sequence - p->sequence),
               (double)(f->timestamp_ns - p->stamp_ns) * 1e-6);
    else
        printf("first frame");
    printf(" flags %u", f->flags);
    tell_means(p, f);
    if (f->exposure_known)
        printf(" reported %.0f us", f->exposure.time_s * 1e6);
    if (truth_read(f->data, f->bytes, &t))
        printf(" truth %u %.0f us", t.number, t.exposure * 1e6);
    putchar('\n');
    p->sequence = f->sequence;
    p->stamp_ns = f->timestamp_ns;
}

static err_t frames(struct probe *p, int n)
{
    for (int i = 0; i < n; i++) {
        struct frame f;
        err_t e = wait_frame(p, &f);
        if (e == ERR_LOST || e == ERR_TIMEOUT)
            return e;
        if (e) {
            printf("error %d: %s\n", (int)e, err_text());
            continue;
        }
        tell(p, &f);
        p->ops->release(p->st, &f);
    }
    return OK;
}

static err_t ask(struct probe *p, double us)
{
    struct exposure want = {us * 1e-6, 1.0}, set = {0};
    err_t e = p->ops->request(p->st, &want, &set);
    if (e)
        printf("ask %.0f us: error %d: %s\n", us, (int)e, err_text());
    else
        printf("ask %.0f us: set %.1f us gain %.2f\n", us, set.time_s * 1e6, set.gain);
    return e == ERR_LOST ? e : OK;
}

static err_t until(struct probe *p, double us)
{
    for (int i = 1; i < 40; i++) {
        struct frame f;
        struct truth t = {0};
        err_t e = wait_frame(p, &f);
        if (e)
            return e;
        bool there = truth_read(f.data, f.bytes, &t) && fabs(t.exposure * 1e6 - us) < 1.0;
        p->sequence = f.sequence;
        p->stamp_ns = f.timestamp_ns;
        p->ops->release(p->st, &f);
        if (there) {
            printf("there after %d frames\n", i);
            return OK;
        }
    }
    return err_fail(ERR_TIMEOUT, "never saw %.0f us", us);
}

static err_t reopen(struct probe *p, int n)
{
    int opened = 0;
    for (int i = 0; i < n; i++) {
        struct frame f;
        if (p->is_open)
            p->ops->close(p->st);
        err_t e = open_it(p);
        if (!e)
            e = wait_frame(p, &f);
        if (e) {
            printf("error %d: %s\n", (int)e, err_text());
            continue;
        }
        p->ops->release(p->st, &f);
        opened++;
    }
    printf("opened %d of %d times\n", opened, n);
    return p->is_open ? OK : ERR_LOST;
}

static err_t control(struct probe *p, const char *text)
{
    const char *path = strchr(p->cfg.uri, ':') + 1;
    char *end;
    struct v4l2_control c = {.id = (uint32_t)strtoul(text, &end, 0)};
    c.value = atoi(end + 1);
    int fd = open(path, O_RDWR | O_CLOEXEC);
    if (fd < 0 || ioctl(fd, VIDIOC_S_CTRL, &c))
        return err_fail(ERR_IO, "control %s: %s", text, strerror(errno));
    close(fd);
    return OK;
}

static err_t operate(struct probe *p, char **word)
{
    static const struct {
        const char *name;
        err_t (*run)(struct probe *p, int n);
    } counted[] = {{"frames", frames}, {"reopen", reopen}};
    static const struct {
        const char *name;
        err_t (*run)(struct probe *p, double us);
    } timed[] = {{"ask", ask}, {"until", until}};
    for (int i = 0; i < 2; i++) {
        if (!strcmp(word[0], counted[i].name))
            return counted[i].run(p, atoi(word[1]));
        if (!strcmp(word[0], timed[i].name))
            return timed[i].run(p, atof(word[1]));
    }
    if (!strcmp(word[0], "control"))
        return control(p, word[1]);
    fprintf(stderr, "no operation %s\n", word[0]);
    exit(3);
}

static int wish(struct camera_cfg *cfg, char **argv, int i)
{
    if (argv[i] && sscanf(argv[i], "%dx%d", &cfg->w, &cfg->h) == 2)
        i++;
    for (int f = 0; argv[i] && f < CAMERA_FORMATS; f++) {
        if (strcmp(argv[i], formats[f]) == 0) {
            cfg->format = (enum camera_format)f;
            return i + 1;
        }
    }
    return i;
}

int main(int argc, char **argv)
{
    struct probe p = {0};
    if (argc < 2)
        return 3;
    setvbuf(stdout, NULL, _IOLBF, 0);
    if (backends_camera(argv[1], &p.ops))
        return 3;
    p.st = malloc(p.ops->state_bytes);
    p.cfg.uri = argv[1];
    int i = wish(&p.cfg, argv, 2);
    err_t e = p.st ? open_it(&p) : ERR_NOMEM;
    if (e) {
        printf("error %d: %s\n", (int)e, err_text());
        return 2;
    }
    const struct camera_info *f = &p.info;
    printf("%s: %d x %d stride %d %s %d bits, black %d, %d buffers, %.2f ms, time %.0f..%.0f us "
           "step %.0f us, gain %.2f, delay %d, stamp %d, reports %d, limited %d, bt709 %d\n",
           f->unit, f->w, f->h, f->stride, formats[f->format], f->bits, f->black, f->buffers,
           f->period_s * 1e3, f->time_min_s * 1e6, f->time_max_s * 1e6, f->time_step_s * 1e6,
           f->gain_max, f->exposure_delay, (int)f->stamp, f->reports, f->limited, f->bt709);
    for (; i + 1 < argc && !e; i += 2)
        e = operate(&p, argv + i);
    if (e)
        printf("error %d: %s\n", (int)e, err_text());
    if (p.is_open)
        p.ops->close(p.st);
    free(p.st);
    return e != OK;
}
