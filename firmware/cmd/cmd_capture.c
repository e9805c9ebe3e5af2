/* hdrig capture: one take, by the daemon or, with --camera, by this program itself. */
#include "drivers/device/clocks.h"
#include "firmware/base/engine.h"
#include "firmware/base/progress.h"
#include "firmware/capture/schedule.h"
#include "firmware/capture/session.h"
#include "firmware/cmd/cmd.h"
#include "firmware/store/store.h"

#include "drivers/format/file.h"

#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define SECOND INT64_C(1000000000)

enum { SETTLE_S = 3 }; // at most, until the cameras see something

struct request {
    struct config cfg;
    const char *camera[CMD_TEXTS_MAX];
    const char *bracket, *middle, *out;
    bool stagger;
};

static err_t make_order(const struct request *q, struct session_order *o)
{
    const char *stops = q->bracket ? q->bracket : "auto";
    double middle = 0;
    err_t e = OK;
    *o = (struct session_order){.mode = SESSION_AUTO,
                                .stagger = q->stagger,
                                .turn = -1,
                                .verify = true,
                                .snr = pow(10, q->cfg.bracket_snr_db / 20.0)};
    if (strcmp(stops, "auto") != 0) {
        o->mode = SESSION_LIST;
        e = config_stops("--bracket", stops, o->ev, BRACKET_EXPOSURES_MAX, &o->n);
        if (!e && o->n == 0)
            e = err_fail(ERR_ARG, "--bracket: must be auto or stops like -4,0,4");
    }
    if (!e && q->middle)
        e = cmd_number("--middle", q->middle, 1e-6, 1e4, &middle);
    o->middle_s = middle;
    return e;
}

static err_t open_cameras(const struct request *q, struct session **out)
{
    struct session_config s = {.w = q->cfg.camera_w,
                               .h = q->cfg.camera_h,
                               .format = (enum camera_format)q->cfg.camera_format,
                               .calibration = q->cfg.calibration_path,
                               .memory = (size_t)config_memory_mb(&q->cfg) * 1000000};
    while (s.n < BRACKET_CAMERAS_MAX && q->camera[s.n]) {
        s.uri[s.n] = q->camera[s.n];
        s.n++;
    }
    if (q->camera[s.n])
        return err_fail(ERR_ARG, "--camera: more than %d cameras", BRACKET_CAMERAS_MAX);
    return session_open(&s, out);
}

/* Let the cameras settle, since they have just been opened. */
static err_t settle_cameras(struct session *s)
{
    int64_t end = clocks_now() + SETTLE_S * SECOND;
    err_t e = OK;
    while (!e && !session_settled(s) && clocks_now() < end && !atomic_load(&engine_cancel)) {
        cmd_wait(s);
        e = session_step(s);
    }
    return e;
}

static err_t run_take(struct session *s, const struct session_order *o, struct take **out)
{
    struct progress p;
    struct bracket_progress b = {0};
    err_t e = settle_cameras(s);
    if (!e)
        e = session_begin(s, o);
    progress_init(&p, stderr);
    while (!e && session_state(s) != SESSION_READY) {
        cmd_wait(s);
        e = session_step(s);
        if (atomic_load(&engine_cancel))
            session_cancel(s, "cancelled");
        session_progress(s, &b);
        if (!e && b.wanted > 0)
            progress_step(&p, session_state(s) == SESSION_METERING ? "metering" : "capture", b.kept,
                          b.wanted, NULL);
    }
    progress_end(&p);
    if (!e)
        e = session_collect(s, out);
    if (!e && (*out)->status != TAKE_COMPLETE)
        e = atomic_load(&engine_cancel) ? err_fail(ERR_CANCELLED, "cancelled")
                                        : err_fail(ERR_IO, "%s", (*out)->reason);
    return e;
}

/* ---- a temporary store beside DIR, whose only take becomes DIR ---- */

struct outlet {
    struct store *store;
    char path[FILE_PATH_CAP];
};

static err_t outlet_open(const char *dir, const struct config *cfg, struct outlet *o)
{
    char copy[FILE_PATH_CAP], name[32];
    if (file_exists(dir))
        return err_fail(ERR_ARG, "--out: %s already exists", dir);
    if (strlen(dir) >= sizeof copy)
        return err_fail(ERR_ARG, "--out: longer than %zu bytes", sizeof copy - 1);
    strcpy(copy, dir);
    const char *parent = dirname(copy);
    if (!file_exists(parent))
        return err_fail(ERR_IO, "--out: %s: there is no folder %s", dir, parent);
    snprintf(name, sizeof name, ".hdrig-%d", (int)getpid());
    err_t e = file_join(parent, name, o->path);
    struct store_config c = {o->path, (uint64_t)cfg->store_reserve_mb * 1000000, cfg->store_merge,
                             cfg->bracket_moved / 100.0, 0};
    return e ? e : store_open(&c, &o->store);
}

/* Check the room for a take before it is taken. */
static err_t outlet_room(const struct outlet *out, const struct session *s,
                         const struct session_order *o)
{
    uint64_t need = 0;
    for (int i = 0; i < session_cameras(s); i++)
        need += store_need(out->store, &session_camera(s, i)->info, schedule_frames(o));
    return store_room(out->store, need);
}

static err_t outlet_commit(const struct outlet *o, struct take *t, const char *dir)
{
    char from[FILE_PATH_CAP], id[STORE_ID_CAP];
    err_t e = store_commit(o->store, t, id);
    if (!e)
        e = file_join(o->path, id, from);
    if (!e && renameat2(AT_FDCWD, from, AT_FDCWD, dir, RENAME_NOREPLACE) != 0)
        e = err_fail(ERR_IO, "%s: %s", dir, strerror(errno));
    return e;
}

static void outlet_close(struct outlet *o)
{
    char counter[FILE_PATH_CAP];
    if (!o->store)
        return;
    store_close(o->store);
    if (file_join(o->path, "counter", counter) == OK)
        unlink(counter);
    rmdir(o->path);
}

static void print_take(const struct take *t, const char *dir)
{
    fprintf(stderr, "%d frames of %d camera%s, %d looked at, %d refused%s%s\n", t->n, t->n_cameras,
            t->n_cameras == 1 ? "" : "s", t->frames_used, t->rejected, t->reason[0] ? "; " : "",
            t->reason);
    for (int i = 0; i < t->n; i++) {
        const struct take_frame *f = &t->frame[i];
        fprintf(stderr, "  camera %d: %.6g s%s\n", f->camera, take_exposure_s(f),
                f->evidence.proof >= BRACKET_UNVERIFIED ? ", not proven by its pixels" : "");
    }
    printf("%s\n", dir);
}

static err_t capture_take(const struct request *q)
{
    struct session *s = NULL;
    struct session_order o;
    struct outlet out = {0};
    struct take *t = NULL;
    err_t e = make_order(q, &o);
    if (!e)
        e = outlet_open(q->out, &q->cfg, &out);
    if (!e)
        e = open_cameras(q, &s);
    if (!e)
        e = outlet_room(&out, s, &o);
    if (!e)
        e = run_take(s, &o, &t);
    if (!e)
        e = outlet_commit(&out, t, q->out);
    outlet_close(&out);
    if (!e)
        print_take(t, q->out);
    take_free(t);
    session_close(s);
    return e;
}

int cmd_capture_run(int argc, char **argv)
{
    struct request q = {0};
    int code;
    const struct cmd_option options[] = {
        {"camera", "URI...", "take it here, with these cameras; else the daemon does", NULL,
         q.camera, NULL},
        {"out", "DIR", "with --camera: where the take goes", NULL, &q.out, NULL},
        {"bracket", "B", "auto, or stops around the middle exposure: -4,0,4 (auto)", NULL,
         &q.bracket, NULL},
        {"middle", "S", "exposure of 0 stops, s; else metered", NULL, &q.middle, NULL},
        {"stagger", NULL, "one exposure per camera, in turn", NULL, NULL, &q.stagger},
        CMD_MEMORY,
    };
    const struct cmd_usage usage = {"capture", "", "Takes one capture.", options,
                                    sizeof options / sizeof options[0]};
    if (!cmd_parse(&usage, argc, argv, &q.cfg, &code))
        return code;
    if (!q.camera[0] && (q.out || q.bracket || q.middle || q.stagger))
        return cmd_misuse(&usage, "--out, --bracket, --middle and --stagger go with --camera: the "
                                  "daemon has its settings");
    if (!q.camera[0])
        return cmd_ask("capture", &q.cfg, "capture wait");
    if (!q.out)
        return cmd_misuse(&usage, "--out is needed");
    return cmd_finish("capture", capture_take(&q));
}
