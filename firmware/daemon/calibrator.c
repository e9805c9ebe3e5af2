/* One child for each camera; the first that fails ends the order. */
#include "firmware/daemon/calibrator.h"

#include "core/base/log.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>

/* {BEFORE "text"} to the client. */
static void send_text(const struct calibrator *c, const char *before, const char *text)
{
    char *json = NULL;
    size_t n;
    FILE *f = open_memstream(&json, &n);
    if (!f)
        return;
    fprintf(f, "{%s", before);
    json_put_string(f, text);
    fputs("}", f);
    if (fclose(f) == 0)
        ctl_answer(c->ctl, c->id, json);
    free(json);
}

static int count_cameras(const struct config *set)
{
    int n = 0;
    while (n < CONFIG_CAMERAS && set->camera[n][0])
        n++;
    return n;
}

err_t calibrator_begin(struct calibrator *c, uint64_t id, const char *order)
{
    char what[sizeof c->what] = "all", longest[sizeof c->longest] = "2";
    int end = 0;
    if (c->on || c->done)
        return err_fail(ERR_BUSY, "a calibration is already running: wait until it ends");
    if (strcmp(order, "calibrate") != 0 &&
        (sscanf(order, "calibrate %15[a-z] %31[0-9.e+-]%n", what, longest, &end) != 2 ||
         order[end] != 0))
        return err_fail(ERR_ARG, "\"%.60s\" is not a command: calibrate [WHAT SECONDS] is expected",
                        order);
    if (count_cameras(c->set) == 0)
        return err_fail(ERR_ARG, "camera.1 is not set: there is no camera to calibrate");
    strcpy(c->what, what);
    strcpy(c->longest, longest);
    c->id = id;
    c->i = 0;
    c->on = true;
    c->cancelled = false;
    c->line[0] = 0;
    return OK;
}

static void end_order(struct calibrator *c, const char *why)
{
    c->on = false;
    if (!why) {
        log_info("cameras are calibrated");
        c->done = true;
        c->done_ns = 0;
        return;
    }
    snprintf(c->text, sizeof c->text, "camera.%d is not calibrated: %.*s", c->i + 1, CHILD_LINE - 1,
             why);
    log_warn("%s", c->text);
    send_text(c, "\"ok\": false, \"error\": ", c->text);
}

static void take_line(void *ctx, const char *line)
{
    struct calibrator *c = ctx;
    snprintf(c->line, sizeof c->line, "%s", line);
    send_text(c, "\"line\": ", line);
}

static err_t start_child(struct calibrator *c)
{
    char program[FILE_PATH_CAP], camera[FILE_PATH_CAP], out[FILE_PATH_CAP], config[FILE_PATH_CAP];
    static char name[] = "calibrate", camera_is[] = "--camera", what_is[] = "--what";
    static char longest_is[] = "--longest", out_is[] = "--out", config_is[] = "--config";
    const struct {
        char *to;
        const char *from;
    } texts[] = {{program, c->program},
                 {camera, c->set->camera[c->i]},
                 {out, c->set->calibration_path},
                 {config, c->config_path ? c->config_path : ""}};
    for (size_t i = 0; i < sizeof texts / sizeof texts[0]; i++)
        if (snprintf(texts[i].to, FILE_PATH_CAP, "%s", texts[i].from) >= FILE_PATH_CAP)
            return err_fail(ERR_ARG, "%.40s...: longer than %d bytes", texts[i].from,
                            FILE_PATH_CAP);
    char *argv[] = {program,
                    name,
                    camera_is,
                    camera,
                    what_is,
                    c->what,
                    longest_is,
                    c->longest,
                    out_is,
                    out,
                    c->config_path ? config_is : NULL,
                    config,
                    NULL};
    snprintf(c->text, sizeof c->text, "camera.%d: %.*s", c->i + 1, CHILD_LINE - 1, camera);
    send_text(c, "\"line\": ", c->text);
    return child_start(&c->child, argv, true);
}

/* The last line of the child without its prefix "hdrig calibrate: ". */
static const char *failure_reason(const struct calibrator *c)
{
    static const char prefix[] = "hdrig calibrate: ";
    bool has = strncmp(c->line, prefix, sizeof prefix - 1) == 0;
    return c->cancelled ? "cancelled" : c->line + (has ? sizeof prefix - 1 : 0);
}

void calibrator_step(struct calibrator *c)
{
    int status;
    child_listen(&c->child, take_line, c);
    if (child_ended(&c->child, take_line, c, &status)) {
        if (WIFSIGNALED(status))
            snprintf(c->line, sizeof c->line, "killed by signal %d", WTERMSIG(status));
        if (!WIFEXITED(status) || WEXITSTATUS(status) != 0)
            end_order(c, failure_reason(c));
        else if (++c->i == count_cameras(c->set))
            end_order(c, NULL);
    }
    if (c->on && !c->child.pid && (c->cancelled || start_child(c) != OK))
        end_order(c, c->cancelled ? "cancelled" : err_text());
}

void calibrator_answer(struct calibrator *c, bool armed, int64_t now_ns)
{
    if (!c->done)
        return;
    c->done_ns = c->done_ns ? c->done_ns : now_ns;
    if (!armed && now_ns - c->done_ns < CALIBRATOR_WAIT_S * INT64_C(1000000000))
        return;
    c->done = false;
    ctl_answer(c->ctl, c->id, "{\"ok\": true}");
}

void calibrator_cancel(struct calibrator *c)
{
    c->cancelled = true;
    child_cancel(&c->child);
}

int calibrator_poll(const struct calibrator *c, struct pollfd *fds, int cap)
{
    return child_poll(&c->child, fds, cap);
}

const char *calibrator_sentence(struct calibrator *c)
{
    snprintf(c->text, sizeof c->text, "calibrates camera.%d: %s", c->i + 1, c->line);
    return c->text;
}

void calibrator_close(struct calibrator *c)
{
    child_stop(&c->child);
    c->on = false;
}
