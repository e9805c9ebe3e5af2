#include "firmware/daemon/daemon_inner.h"
#include "firmware/rig/boards_status.h"

#include "drivers/device/clocks.h"
#include "drivers/format/img.h"
#include "drivers/format/json.h"

#include <sys/statvfs.h>
#include <unistd.h>

enum {
    LIVE_QUALITY = 80,
    LIVE_CORES = 4 // of boards whose page shows live pictures unless somebody wants none
};

static const char *state_word(const struct daemon *d)
{
    static const char *const words[] = {[SESSION_LOST] = "lost",
                                        [SESSION_ARMED] = "armed",
                                        [SESSION_METERING] = "metering",
                                        [SESSION_SHOOTING] = "shooting",
                                        [SESSION_READY] = "ready"};
    if (d->stopping)
        return "stopping";
    if (d->calibrator.on)
        return "calibrating";
    if (d->boards && !d->set->camera[0][0])
        return boards_trouble(d->boards) ? "lost" : "armed";
    return d->session ? words[session_state(d->session)] : "lost";
}

const char *daemon_status_sentence(struct daemon *d)
{
    if (d->calibrator.on)
        return calibrator_sentence(&d->calibrator);
    if (d->trouble[0])
        return d->trouble;
    if (d->boards && !d->set->camera[0][0])
        return boards_trouble(d->boards) ? boards_trouble(d->boards) : "ready to capture";
    return d->session ? session_status(d->session) : "waits for the cameras";
}

static void write_cameras(const struct daemon *d, FILE *f)
{
    int n = d->session ? session_cameras(d->session) : 0;
    fputs("\"cameras\": [", f);
    for (int i = 0; i < n; i++) {
        const struct take_camera *c = session_camera(d->session, i);
        struct session_view v;
        session_view(d->session, i, &v);
        fprintf(f, "%s{\"uri\": ", i ? ", " : "");
        json_put_string(f, c->uri);
        fputs(", \"unit\": ", f);
        json_put_string(f, c->info.unit);
        fprintf(f,
                ", \"present\": %s, \"width\": %d, \"height\": %d, \"format\": \"%s\", "
                "\"exposure_s\": %.9g, \"clipped\": %.4g, \"dark\": %.4g, \"histogram\": [",
                v.present ? "true" : "false", c->info.w, c->info.h, take_format(c->info.format),
                v.exposure.time_s, v.clipped, v.dark);
        for (int k = 0; k < SESSION_BINS; k++)
            fprintf(f, "%s%u", k ? "," : "", v.histogram[k]);
        fputs("]}", f);
    }
    fputs("]", f);
}

err_t daemon_status_live(void *ctx, int camera, void **jpeg, size_t *n)
{
    const struct daemon *d = ctx;
    const int cameras = d->session ? session_cameras(d->session) : 0;
    if (camera < 0 || camera >= cameras)
        return err_fail(ERR_ARG, "camera %d of %d", camera, cameras);
    const struct idle_view_picture *p = session_picture(d->session, camera);
    if (p->w == 0)
        return err_fail(ERR_AGAIN, "camera %d has seen nothing yet", camera);
    const struct image8 im = {p->w, p->h, 3, (uint8_t *)(uintptr_t)p->px};
    return img_encode_jpeg(&im, LIVE_QUALITY, "live picture", jpeg, n);
}

static void write_counters(const struct daemon *d, FILE *f)
{
    const struct counters *c = &d->count;
    struct triggers_count t;
    triggers_look(d->triggers, &t);
    fprintf(f,
            "\"counters\": {\"presses\": %ld, \"takes\": %ld, \"aborted\": %ld, "
            "\"locked_out\": %ld, \"rejected\": %ld, \"queued\": %ld, \"coalesced\": %ld, "
            "\"refused\": %ld, \"lost_edges\": %ld, \"clock_steps\": %ld}",
            c->presses + t.locked_out, c->takes, c->aborted, t.locked_out, c->rejected, c->queued,
            c->coalesced, c->refused, t.lost_edges, c->clock_steps);
}

/* What the next press does. */
static void write_press(const struct daemon *d, FILE *f)
{
    const struct config *c = d->set;
    double ev[BRACKET_EXPOSURES_MAX];
    char what[128], text[TAKE_TEXT];
    int n = 0;
    if (c->bracket_mode == CONFIG_LIST &&
        config_stops("bracket.ev", c->bracket_ev, ev, BRACKET_EXPOSURES_MAX, &n) == OK)
        snprintf(what, sizeof what, "photographs %d exposure%s", n, n == 1 ? "" : "s");
    else
        snprintf(what, sizeof what,
                 "measures the light and photographs the exposures that the scene needs");
    snprintf(text, sizeof text, "A press %s%s%s, and %s.", what,
             c->bracket_stagger ? ", one per camera in turn" : "",
             d->boards ? ", on all boards of the rig" : "",
             d->collect.on ? "adds them to the session as a place"
             : c->job_run  ? "makes a scene of them"
                           : "keeps them without making a scene (job.run = 0)");
    fputs(", \"press\": ", f);
    json_put_string(f, text);
}

void daemon_status_write(void *ctx, FILE *f)
{
    struct daemon *d = ctx;
    struct bracket_progress p = {0};
    struct statvfs v;
    if (d->session)
        session_progress(d->session, &p);
    double free_mb =
        statvfs(d->set->store_path, &v) == 0 ? (double)v.f_bavail * (double)v.f_frsize / 1e6 : -1;
    fprintf(f, "{\"ok\": true, \"state\": \"%s\", \"sentence\": ", state_word(d));
    json_put_string(f, daemon_status_sentence(d));
    write_press(d, f);
    fprintf(f, ", \"live\": %s", sysconf(_SC_NPROCESSORS_ONLN) >= LIVE_CORES ? "true" : "false");
    fprintf(f,
            ", \"uptime_s\": %.1f, \"progress\": {\"kept\": %d, \"wanted\": %d, \"frames\": %d, "
            "\"rejected\": %d, \"lost\": %d}, \"waiting\": %d, \"free_mb\": %.0f, ",
            (double)(clocks_now() - d->start_ns) / 1e9, p.kept, p.wanted, p.frames, p.rejected,
            p.lost, d->n_waiting, free_mb);
    write_cameras(d, f);
    fputs(", ", f);
    jobs_write(d->jobs, f);
    fputs(", ", f);
    fputs("\"session\": ", f);
    collect_write(&d->collect, f);
    fputs(", ", f);
    write_counters(d, f);
    fputs(", \"captures\": [", f);
    for (int i = 0; i < d->n_recent; i++) {
        if (i)
            fputs(", ", f);
        summary_write(&d->recent[i], summary_warnings(d->set->results_path, &d->recent[i]), f);
    }
    fputs("]", f);
    if (d->boards) {
        fputs(", \"rig\": ", f);
        boards_status_write(d->boards, f);
    }
    fputs("}", f);
}
