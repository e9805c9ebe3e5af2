/* The plan of a job's memory against what the job takes: real jobs of several kinds and sizes, on
 * photographs of a simulated room. Arenas have twice the room of the plan; each peak must stay
 * within its plan, and the plan within 10 % of the peak, but for what a closer look for cameras
 * takes where it is not needed. */
#include "core/sfm/pose.h"
#include "firmware/base/engine.h"
#include "firmware/recon/dump.h"
#include "firmware/recon/job.h"
#include "firmware/result/draw.h"
#include "sim/world/render.h"

#include "tests/unit/some_of.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { PLACES = 4, STEPS_OF_EXPOSURE = 3, PHOTO = 128, TIMES = 4, THREADS = 2, MEMORY_MB = 8000 };

static const double SLACK = 1.10;
static const float FAR_SPREAD = 0.8f;

struct kind {
    const char *name;
    int size, steps, degree, gaussians;
    bool unknown;  // cameras
    bool brackets; // three exposures of each place, else one
    bool network, cameras_only, polish, stereo, dump;
    bool large; // photographs that are larger than what cameras and depth are found in
    bool far;   // apart: cameras of all are only found by a closer look
    bool spare; // one is planned and not needed
};

static const struct kind kinds[] = {
    {"known", 112, 20, 2, 20000, .polish = true},
    {"known, no steps", 168, 0, 1, 30000, .polish = true},
    {"known, few splats, brackets", 112, 20, 2, 1000, .brackets = true, .polish = true},
    {"unknown", 112, 20, 2, 20000, .unknown = true, .polish = true},
    {"unknown, no steps", 168, 0, 0, 2000, .unknown = true, .polish = true, .spare = true},
    {"unknown, far apart", 112, 0, 0, 2000, .unknown = true, .polish = true, .far = true},
    {"unknown, brackets", 112, 20, 2, 20000, .unknown = true, .brackets = true, .polish = true,
     .spare = true},
    {"larger photographs", 500, 20, 2, 20000, .polish = true, .large = true},
    {"larger photographs, unknown, brackets", 500, 0, 2, 20000, .unknown = true, .brackets = true,
     .polish = true, .large = true, .spare = true},
    {"network for cameras", 112, 20, 2, 20000, .unknown = true, .network = true,
     .cameras_only = true, .polish = true, .stereo = true},
    {"network for cameras, views larger than its own", 252, 0, 0, 100, .unknown = true,
     .network = true, .cameras_only = true, .polish = true, .stereo = true, .spare = true},
    {"network for depth", 112, 20, 2, 20000, .network = true, .cameras_only = true, .polish = true},
    {"network for depth, brackets of larger photographs", 500, 0, 2, 20000, .brackets = true,
     .network = true, .cameras_only = true, .polish = true, .large = true},
    {"network, no steps", 112, 0, 2, 20000, .unknown = true, .network = true, .polish = true},
    {"network, no steps, known", 168, 0, 2, 20000, .network = true, .polish = true},
    {"network alone", 112, 0, 2, 20000, .unknown = true, .network = true},
    {"network, dumped", 56, 0, 2, 20000, .unknown = true, .network = true, .dump = true},
    {"network, dumped and refined", 56, 5, 0, 1000, .unknown = true, .network = true, .dump = true},
    {"network and stereo", 112, 20, 2, 20000, .unknown = true, .network = true, .polish = true,
     .stereo = true},
    {"network and refinement", 112, 20, 2, 20000, .unknown = true, .network = true, .polish = true},
    {"network and refinement, brackets", 112, 20, 1, 2000, .unknown = true, .brackets = true,
     .network = true, .polish = true},
};

enum { KINDS = sizeof kinds / sizeof kinds[0], SHOTS = PLACES * STEPS_OF_EXPOSURE };

static struct shot photographs[2][SHOTS]; // near, far; exposures of a place one after another
static struct image8 enlarged[SHOTS];     // the near ones TIMES as large
static struct network network;

/* ---- photographs ---- */

static void develop(const float *radiance, double exposure, uint8_t *px)
{
    for (size_t i = 0; i < PHOTO * PHOTO; i++)
        for (size_t c = 0; c < 3; c++) {
            double v = (double)radiance[c * PHOTO * PHOTO + i] * exposure;
            px[3 * i + c] = (uint8_t)lrint(255 * pow(fmin(v, 1), 1 / 2.2));
        }
}

static void enlarge(const struct image8 *in, struct image8 *out)
{
    *out = (struct image8){in->w * TIMES, in->h * TIMES, 3,
                           malloc((size_t)(TIMES * TIMES) * 3 * PHOTO * PHOTO)};
    assert_non_null(out->px);
    for (int y = 0; y < out->h; y++)
        for (int x = 0; x < out->w; x++)
            memcpy(out->px + 3 * (y * out->w + x), in->px + 3 * (y / TIMES * in->w + x / TIMES), 3);
}

static void photograph(const struct camera *cam, const float *radiance, int place, bool far)
{
    for (int k = 0; k < STEPS_OF_EXPOSURE; k++) {
        struct shot *s = &photographs[far][place * STEPS_OF_EXPOSURE + k];
        snprintf(s->name, sizeof s->name, "view_%d_%d.png", place, k);
        s->exposure = 0.2 * pow(4, k);
        s->has_camera = true;
        s->cam = *cam;
        s->again = k > 0;
        s->image = (struct image8){PHOTO, PHOTO, 3, malloc(PHOTO * PHOTO * 3)};
        assert_non_null(s->image.px);
        develop(radiance, s->exposure, s->image.px);
        if (!far)
            enlarge(&s->image, &enlarged[place * STEPS_OF_EXPOSURE + k]);
    }
}

static int open_all(void **state)
{
    struct engine en;
    struct world w;
    struct render_world *scene;
    struct camera cams[PLACES];
    const struct render_quality quick = {.samples = 1, .shadow = 1};
    const struct world_path path[] = {{PLACES, 0.2f, 60, false, 0, false},
                                      {PLACES, FAR_SPREAD, 60, false, 0, false}};
    struct render_maps maps = {.radiance = malloc(3 * PHOTO * PHOTO * sizeof(float))};
    (void)state;
    assert_non_null(maps.radiance);
    assert_int_equal(engine_open(&en, THREADS), OK);
    struct plan p = plan_begin(THREADS);
    world_plan(&p);
    render_open_plan(&p);
    render_plan(&p, PHOTO, PHOTO);
    assert_int_equal(engine_reserve(&en, 0, p.keep.peak, p.tmp.peak, MEMORY_MB), OK);
    assert_int_equal(world_make(&en.keep, 11, WORLD_ROOM, &w), OK);
    assert_int_equal(render_open(&en.run, &w, &scene), OK);
    for (int i = 0; i < 2 * PLACES; i++) {
        if (i % PLACES == 0)
            world_cameras(&w, &path[i / PLACES], 11, PHOTO, cams);
        assert_int_equal(render_run(&en.run, scene, &cams[i % PLACES], &quick, 11, &maps), OK);
        photograph(&cams[i % PLACES], maps.radiance, i % PLACES, i >= PLACES);
    }
    engine_close(&en);
    free(maps.radiance);
    assert_int_equal(network_open("build/small.hdrig", "int8", 0, &network), OK);
    return 0;
}

static int close_all(void **state)
{
    (void)state;
    for (int i = 0; i < SHOTS; i++)
        free(photographs[0][i].image.px), free(photographs[1][i].image.px), free(enlarged[i].px);
    network_close(&network);
    return 0;
}

/* ---- jobs ---- */

/* Without brackets, places have the middle exposure and the long one in turn. */
static struct capture choose(const struct kind *k, struct shot *shots)
{
    int n = 0;
    for (int i = 0; i < SHOTS; i++) {
        const int place = i / STEPS_OF_EXPOSURE, step = i % STEPS_OF_EXPOSURE;
        if (!k->brackets && step != 1 + place % 2)
            continue;
        shots[n] = photographs[k->far][i];
        shots[n].again = k->brackets && step > 0;
        if (k->large) {
            shots[n].image = enlarged[i];
            shots[n].cam = pose_scaled(&shots[n].cam, enlarged[i].w, enlarged[i].h);
        }
        shots[n++].has_camera = !k->unknown;
    }
    return (struct capture){n, shots};
}

static void ignore(void *ctx, const struct tap_tensor *t)
{
    (void)ctx;
    (void)t;
}

static struct job_config config(const struct kind *k)
{
    return (struct job_config){.size = k->size,
                               .refine = {.steps = k->steps,
                                          .degree_max = k->degree,
                                          .gaussians_max = k->gaussians,
                                          .seed = 1},
                               .network = k->network ? &network : NULL,
                               .cameras_only = k->cameras_only,
                               .polish = k->polish,
                               .stereo = k->stereo};
}

static bool compare(const char *arena, size_t plan, size_t peak, bool spare)
{
    const bool good = peak <= plan && (spare || (double)plan <= SLACK * (double)peak);
    print_message("    %-4s plan %9zu kB, peak %9zu kB, %6.1f %%%s\n", arena, plan / 1000,
                  peak / 1000, 100 * ((double)plan / (double)peak - 1), good ? "" : "  <-");
    return good;
}

static bool run_job(const struct kind *k)
{
    static struct job_result result;
    static struct shot shots[SHOTS];
    const struct capture c = choose(k, shots);
    const struct job_config cfg = config(k);
    const struct tap tap = {ignore, NULL};
    struct engine en;
    struct job_memory need;
    struct draw draw;
    assert_int_equal(engine_open(&en, THREADS), OK);
    en.run.tap = k->dump ? &tap : NULL;
    assert_int_equal(job_plan(&c, &cfg, THREADS, k->dump, NULL, &need), OK);
    assert_int_equal(engine_reserve(&en, 0, 2 * need.keep, 2 * need.tmp, MEMORY_MB), OK);
    err_t e = job_run(&en.run, &c, &cfg, &result);
    if (!e)
        e = draw_init(&draw, &en.tmp, result.scene.g.cap, k->size, k->size); // to publish it
    progress_end(&en.progress);
    print_message("%s (%d photographs, %d px, %d steps)%s\n", k->name, c.n, k->size, k->steps,
                  e ? err_text() : "");
    bool good = compare("keep", need.keep, en.keep.peak, k->spare);
    good = compare("tmp", need.tmp, en.tmp.peak, false) && good;
    good = good && (result.cameras.edge > k->size) == k->far;
    /* stereo is not sure everywhere */
    good = good && (result.completed > 0) == (k->network && (k->cameras_only || k->stereo));
    engine_close(&en);
    return good && !e;
}

static void every_plan_is_what_its_job_takes(void **state)
{
    int bad = 0;
    (void)state;
    for (int i = 0; i < KINDS; i += some_of(5))
        bad += !run_job(&kinds[i]);
    assert_int_equal(bad, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(every_plan_is_what_its_job_takes)};
    return cmocka_run_group_tests(tests, open_all, close_all);
}
