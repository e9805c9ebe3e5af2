/* Every camera replays the same pictures of a made-up scene, 1280 x 720, so that making pictures
 * costs nothing and the figures are those of watching, copying and proving. */
#include "firmware/cmd/bench_capture.h"

#include "drivers/device/clocks.h"
#include "firmware/base/engine.h"
#include "firmware/base/tempdir.h"
#include "firmware/capture/session.h"
#include "firmware/store/store.h"

#include "core/photo/crf.h"
#include "drivers/format/file.h"
#include "drivers/format/img.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

enum {
    W = 1280,
    H = 720,
    TIMES = 5,
    TAKES = 5,
    WAIT_S = 3,
    FPS = 15,
    URI_CAP = FILE_PATH_CAP + 32
};

#define SHORTEST_S 0.00025 // the others are 4 times as long, each
#define MIDDLE_S 0.004

static double cpu_s(void)
{
    struct rusage u;
    getrusage(RUSAGE_SELF, &u);
    return (double)(u.ru_utime.tv_sec + u.ru_stime.tv_sec) +
           (double)(u.ru_utime.tv_usec + u.ru_stime.tv_usec) * 1e-6;
}

/* Display value of a scene of 9 stops from left to right, with texture. */
static uint8_t display_code(const struct crf *crf, int x, int y, double time_s)
{
    uint32_t h = (uint32_t)(x / 3) * 2654435761u ^ (uint32_t)(y / 3) * 2246822519u;
    double stops = 9.0 * x / W - 7.0 + (double)(h >> 16 & 255) / 256.0;
    float wanted = (float)(stops + log2(time_s / MIDDLE_S) + 2.0);
    int lo = 0;
    while (lo < 255 && crf->log2x[1][lo + 1] <= wanted)
        lo++;
    return (uint8_t)lo;
}

static err_t write_pictures(const char *dir)
{
    char path[FILE_PATH_CAP], name[32];
    struct crf crf;
    FILE *f;
    uint8_t *px = malloc((size_t)W * H * 3);
    if (!px)
        return err_fail(ERR_NOMEM, "bench: no memory for a picture");
    crf_srgb(&crf);
    err_t e = OK;
    for (int k = 0; k < TIMES && !e; k++) {
        struct image8 im = {W, H, 3, px};
        for (int i = 0; i < W * H; i++)
            memset(px + 3 * i, display_code(&crf, i % W, i / W, SHORTEST_S * pow(4, k)), 3);
        snprintf(name, sizeof name, "train_000_%d.png", k);
        e = file_join(dir, name, path);
        if (!e)
            e = img_write_png(path, &im);
    }
    free(px);
    if (!e)
        e = file_join(dir, "exposure.json", path);
    if (!e)
        e = file_create(path, &f);
    if (e)
        return e;
    for (int k = 0; k < TIMES; k++)
        fprintf(f, "%s\"train_000_%d.png\": %.9g", k ? ", " : "{", k, SHORTEST_S * pow(4, k));
    fputs("}\n", f);
    return file_finish(f, path);
}

static err_t run_turn(struct session *s)
{
    struct pollfd fds[BRACKET_CAMERAS_MAX];
    int64_t deadline;
    int n = session_poll(s, fds, BRACKET_CAMERAS_MAX, &deadline);
    struct timespec wait = {.tv_nsec = 100000000};
    ppoll(fds, (nfds_t)n, &wait, NULL);
    if (atomic_load(&engine_cancel))
        return err_fail(ERR_CANCELLED, "interrupted");
    return session_step(s);
}

/* Turn until the session has a reference frame. */
static err_t settle_session(struct session *s)
{
    int64_t end = clocks_now() + INT64_C(1000000000);
    err_t e = OK;
    while (!e && clocks_now() < end)
        e = run_turn(s);
    return e;
}

static int lost_frames(const struct session *s)
{
    struct bracket_progress p;
    session_progress(s, &p);
    return p.lost;
}

/* Armed, as the daemon is most of its life. */
static err_t wait_armed(struct session *s, struct bench_capture *out)
{
    int64_t begin = clocks_now(), end = begin + WAIT_S * INT64_C(1000000000);
    double cpu = cpu_s();
    int lost = lost_frames(s);
    err_t e = OK;
    while (!e && clocks_now() < end)
        e = run_turn(s);
    out->wait_share = (cpu_s() - cpu) / ((double)(clocks_now() - begin) / 1e9);
    out->lost += lost_frames(s) - lost;
    return e;
}

static err_t one_take(struct session *s, struct store *store, struct bench_capture *out)
{
    struct session_order o = {.mode = SESSION_LIST, .n = 3, .ev = {-2, 0, 2}, .middle_s = MIDDLE_S};
    struct take *t = NULL;
    char id[STORE_ID_CAP];
    int64_t begin = clocks_now();
    double cpu = cpu_s();
    err_t e = session_begin(s, &o);
    while (!e && session_state(s) != SESSION_READY)
        e = run_turn(s);
    int64_t shot = clocks_now();
    out->take_s += (double)(shot - begin) / 1e9;
    out->take_share += cpu_s() - cpu;
    out->lost += lost_frames(s);
    if (!e)
        e = session_collect(s, &t);
    if (!e && t->status != TAKE_COMPLETE)
        e = err_fail(ERR_IO, "bench: %s", t->reason);
    shot = clocks_now();
    if (!e)
        e = store_commit(store, t, id);
    out->store_s += (double)(clocks_now() - shot) / 1e9;
    out->exposures = t ? t->n / out->cameras : 0;
    out->rejected += t ? t->rejected : 0;
    out->frames += t ? t->frames_used : 0;
    out->frames_most = t && t->frames_used > out->frames_most ? t->frames_used : out->frames_most;
    take_free(t);
    return e;
}

static err_t measure_takes(struct session *s, struct store *store, struct bench_capture *out)
{
    err_t e = settle_session(s);
    if (!e)
        e = wait_armed(s, out);
    for (out->takes = 0; out->takes < TAKES && !e; out->takes++) {
        e = settle_session(s);
        if (!e)
            e = one_take(s, store, out);
    }
    out->take_share /= out->take_s;
    out->take_s /= TAKES;
    out->store_s /= TAKES;
    out->frames = (out->frames + TAKES / 2) / TAKES;
    out->rss_mb = engine_peak_rss_mb();
    return e;
}

static err_t run_in(const char *dir, const struct config *cfg, struct bench_capture *out)
{
    char(*uri)[URI_CAP] = calloc((size_t)out->cameras, URI_CAP);
    struct session_config c = {.n = out->cameras,
                               .memory = (size_t)config_memory_mb(cfg) * 1000000};
    char captures[FILE_PATH_CAP];
    struct session *s = NULL;
    struct store *store = NULL;
    if (!uri)
        return err_fail(ERR_NOMEM, "bench: no memory");
    for (int i = 0; i < c.n; i++) { // begun at different times, as cameras of a rig are
        snprintf(uri[i], URI_CAP, "replay:%s,fps=%d,skew=%d", dir, FPS, i * 1000000 / FPS / c.n);
        c.uri[i] = uri[i];
    }
    err_t e = write_pictures(dir);
    if (!e)
        e = file_join(dir, "captures", captures);
    struct store_config sc = {.path = captures, .merge = cfg->store_merge != 0};
    if (!e)
        e = store_open(&sc, &store);
    if (!e)
        e = session_open(&c, &s);
    if (!e)
        e = measure_takes(s, store, out);
    session_close(s);
    store_close(store);
    free(uri);
    return e;
}

err_t bench_capture_run(int cameras, const struct config *cfg, struct bench_capture *out)
{
    char dir[FILE_PATH_CAP];
    *out = (struct bench_capture){.cameras = cameras, .w = W, .h = H, .fps = FPS};
    err_t e = tempdir_make("hdrig-bench", dir);
    if (!e)
        e = run_in(dir, cfg, out);
    tempdir_remove(dir);
    return e;
}

void bench_capture_report(const struct bench_capture *b, struct report *rep)
{
    report_int(rep, "cameras", b->cameras);
    report_int(rep, "width", b->w);
    report_int(rep, "height", b->h);
    report_number(rep, "frames_per_s", b->fps);
    report_int(rep, "exposures", b->exposures);
    report_int(rep, "takes", b->takes);
    report_int(rep, "frames_used", b->frames);
    report_int(rep, "frames_used_most", b->frames_most);
    report_int(rep, "frames_lost", b->lost);
    report_int(rep, "frames_rejected", b->rejected);
    report_number(rep, "cores_waiting", b->wait_share);
    report_number(rep, "cores_taking", b->take_share);
    report_number(rep, "seconds_take", b->take_s);
    report_number(rep, "seconds_store", b->store_s);
    report_number(rep, "peak_rss_mb", b->rss_mb);
}

void bench_capture_print(const struct bench_capture *b)
{
    printf("\n%d cameras, %dx%d px, %.0f frames/s, brackets of %d, %d takes\n", b->cameras, b->w,
           b->h, b->fps, b->exposures, b->takes);
    printf("  waiting        %5.2f cores\n", b->wait_share);
    printf("  taking         %5.2f cores for %.2f s; %d frames per camera, %d at most\n",
           b->take_share, b->take_s, b->frames, b->frames_most);
    printf("  frames         %d lost, %d refused\n", b->lost, b->rejected);
    printf("  storing        %5.2f s in the background\n", b->store_s);
    printf("  memory         %5.0f MB\n", b->rss_mb);
}
