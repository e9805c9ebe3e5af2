/* hdrig calibrate: measures a camera and writes its calibration. */
#include "firmware/capture/calibrate.h"
#include "firmware/capture/take.h"
#include "firmware/cmd/cmd.h"
#include "firmware/daemon/ctl.h"

#include "core/base/log.h"
#include "drivers/format/file.h"

#include <math.h>
#include <string.h>

#define LONGEST_S 2.0 // usual end of a sweep

struct request {
    struct config cfg;
    const char *camera, *what, *longest, *dir;
    unsigned parts;
    double longest_s;
};

static err_t read_parts(const char *what, unsigned *parts)
{
    static const struct {
        const char *word;
        unsigned parts;
    } words[] = {{"all", CALIBRATE_LATENCY | CALIBRATE_RANGE | CALIBRATE_RESPONSE},
                 {"latency", CALIBRATE_LATENCY},
                 {"range", CALIBRATE_RANGE},
                 {"response", CALIBRATE_RESPONSE}};
    for (size_t i = 0; i < sizeof words / sizeof words[0]; i++)
        if (!what || strcmp(what, words[i].word) == 0) {
            *parts = words[i].parts;
            return OK;
        }
    return err_fail(ERR_ARG, "--what: \"%.64s\" is none of latency, range, response, all", what);
}

static err_t read_request(struct request *q)
{
    q->longest_s = LONGEST_S;
    err_t e = read_parts(q->what, &q->parts);
    if (!e && q->longest)
        e = cmd_number("--longest", q->longest, 1e-4, 1000, &q->longest_s);
    if (!q->dir)
        q->dir = q->cfg.calibration_path;
    return e;
}

static struct camera_cfg camera_of(const struct request *q)
{
    return (struct camera_cfg){q->camera, q->cfg.camera_w, q->cfg.camera_h,
                               (enum camera_format)q->cfg.camera_format, 0};
}

/* ---- output ---- */

/* "20 us", "1.25 ms", "2 s"; one of four buffers in turn. */
static const char *time_text(double s)
{
    static char text[4][24];
    static unsigned turn;
    char *t = text[turn++ % 4];
    if (s < 1e-3)
        snprintf(t, sizeof text[0], "%.3g us", s * 1e6);
    else
        snprintf(t, sizeof text[0], s < 1.0 ? "%.3g ms" : "%.3g s", s < 1.0 ? s * 1e3 : s);
    return t;
}

static void print_delay(const struct calibrate *c, int promised)
{
    char said[40] = "the device does not say";
    if (promised >= 0)
        snprintf(said, sizeof said, "the device says %d", promised);
    if (c->calib.delay_lo == c->calib.delay_hi)
        printf("delay      %d frames in all of %d steps; %s\n", c->calib.delay_lo, c->trials, said);
    else
        printf("delay      %d to %d frames in %d steps; %s\n", c->calib.delay_lo, c->calib.delay_hi,
               c->trials, said);
    if (c->unsure)
        printf("           %d steps did not count: frames were lost\n", c->unsure);
}

static void print_range(const struct calibrate *c, const struct camera_info *info)
{
    const struct calib *k = &c->calib;
    double tried = c->step[c->n - 1].time_s, worst = 0.0;
    printf("range      %s to %s", time_text(k->time_min_s), time_text(k->time_max_s));
    if (k->time_min_s > info->time_min_s || k->time_max_s < info->time_max_s)
        printf("; beyond, exposure does not obey: the device says %s to %s",
               time_text(info->time_min_s), time_text(info->time_max_s));
    printf("\n           proven by the pixels from %s to %s, tried to %s\n",
           time_text(c->seen_min_s), time_text(c->seen_max_s), time_text(tried));
    for (int i = 1; i < c->n; i++)
        if (c->step[i].verdict == CALIBRATE_OBEYS && c->step[i].time_s <= k->time_max_s &&
            c->step[i - 1].time_s >= k->time_min_s)
            worst = fmax(worst, fabs(c->step[i].measured - c->step[i].requested));
    printf("           neighbours are right within %.2f stops\n", worst);
}

static void print_result(const struct calibrate *c, const struct camera_info *info)
{
    printf("camera     %s, %dx%d px, %s\n", info->unit[0] ? info->unit : "without a name", info->w,
           info->h, take_format(info->format));
    if (c->parts & CALIBRATE_LATENCY)
        print_delay(c, info->exposure_delay);
    if ((c->parts & CALIBRATE_RANGE) && c->n > 1)
        print_range(c, info);
    if (info->format > CAMERA_GREY)
        printf("response   linear\n");
    else if (c->calib.has_crf)
        printf("response   known within %.2f stops\n", (double)c->calib.crf.error);
    else
        printf("response   not known, sRGB is assumed%s%s\n", c->curve_why[0] ? ": " : "",
               c->curve_why);
    printf("tolerance  %.2f stops between what is asked and what pixels show\n",
           c->calib.tolerance);
}

/* ---- calibrate ---- */

static err_t calibrate_takes(const struct request *q)
{
    static struct calibrate c;
    struct camera_cfg cfg = camera_of(q);
    struct progress p;
    struct device_probe *w;
    struct calib known;
    bool found = false;
    progress_init(&p, stderr);
    err_t e = calib_check_place(q->dir);
    if (!e)
        e = device_probe_open(&cfg, &w);
    if (e)
        return e;
    w->progress = &p;
    if (w->info.unit[0] && calib_load(q->dir, &w->info, &known, &found) != OK)
        log_warn("%s; measured anew", err_text());
    if (!w->info.unit[0])
        e = err_fail(ERR_UNSUPPORTED,
                     "%s: the camera reports no unit name, so its calibration cannot be stored",
                     q->camera);
    if (!e)
        e = calibrate_run(w, q->parts, q->longest_s, &known, &c);
    progress_end(&p);
    if (!e)
        print_result(&c, &w->info);
    if (!e)
        e = calib_save(q->dir, &w->info, &c.calib);
    if (!e)
        printf("saved in   %s\n", q->dir);
    device_probe_close(w);
    return e;
}

/* The daemon owns its cameras. An interrupted command ends the calibration as well. */
static int ask_daemon(const struct request *q)
{
    static char answer[CTL_ANSWER_MAX];
    char order[CTL_LINE_MAX];
    snprintf(order, sizeof order, "calibrate %s %g", q->what ? q->what : "all", q->longest_s);
    int code = cmd_ask("calibrate", &q->cfg, order);
    if (code == CMD_INTERRUPTED && ctl_ask(q->cfg.control_socket, "cancel", 10, answer) != OK)
        log_warn("%s", err_text());
    return code;
}

int cmd_calibrate_run(int argc, char **argv)
{
    struct request q = {0};
    int code;
    const struct cmd_option options[] = {
        {"camera", "URI", "measure it here; else the daemon measures its cameras", NULL, &q.camera,
         NULL},
        {"what", "W", "latency, range, response or all (all)", NULL, &q.what, NULL},
        {"longest", "S", "end of the range that is tried, s (2)", NULL, &q.longest, NULL},
        {"out", "DIR", "with --camera: where calibrations are (calibration.path)", NULL, &q.dir,
         NULL},
    };
    const struct cmd_usage usage = {
        "calibrate", "",
        "Measures a camera that looks at a scene which stays as it is: after how many frames\n"
        "exposure shows, in which range it obeys, the response curve.",
        options, sizeof options / sizeof options[0]};
    if (!cmd_parse(&usage, argc, argv, &q.cfg, &code))
        return code;
    if (!q.camera && q.dir)
        return cmd_misuse(&usage, "--out goes with --camera: the daemon has calibration.path");
    if (read_request(&q) != OK)
        return cmd_misuse(&usage, err_text());
    if (!q.camera)
        return ask_daemon(&q);
    return cmd_finish("calibrate", calibrate_takes(&q));
}
