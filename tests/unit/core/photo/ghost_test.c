/* Brackets of simulated worlds in which somebody passes by: nine of ten pixels that differ by three
 * sigma are found, at most two of a hundred wrongly, also of a shaken stand; and the extremes. */
#include "core/photo/ghost.h"
#include "core/photo/ghost_shrink.h"

#include "core/base/num.h"
#include "sim/sensor/sensor.h"
#include "sim/world/passer.h"

#include "tests/unit/expect.h"
#include "tests/unit/some_of.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { S = 192, N = S * S, FRAMES = 3, BORDER = 8 };
enum kind { LINEAR, DISPLAY, MOSAIC, UNKNOWN, KINDS };

static float still[FRAMES][3 * N], seen[FRAMES][3 * N];
static uint8_t mask[FRAMES][N];
static uint16_t px[FRAMES][3 * N];
static struct raw frames[FRAMES];
static double shift[FRAMES][2], time_s[FRAMES];
static struct crf srgb;
static struct ghost_mask masks[MERGE_FRAMES_MAX];
static const struct develop as_is = {1, 1};

static double full(void)
{
    return fmin((4095 - sensor_default.black) / (double)sensor_default.gain,
                (double)sensor_default.full_well);
}

struct bracket {
    enum world_kind world;
    uint64_t seed;
    float share;         // of the passer-by; 0: nobody
    int who;             // bit i: frame i shows it
    double shake, stops; // px; between frames
};

/* Radiance of the frames. Other seeds shake otherwise. */
static void draw_frames(const struct bracket *a)
{
    struct plan p = plan_begin(1);
    struct arena keep = {0}, tmp = {0};
    struct camera cams[4];
    struct world w;
    struct render_world *rendered;
    const struct world_path path = {.n = 4, .spread = 0.3f, .fov_deg = 60};
    const struct render_quality quality = {.samples = 2, .shadow = 2};
    world_plan(&p);
    render_open_plan(&p);
    render_plan(&p, S, S);
    assert_int_equal(arena_init(&keep, "keep", p.keep.peak), OK);
    assert_int_equal(arena_init(&tmp, "tmp", p.tmp.peak), OK);
    const struct run r = {.keep = &keep, .tmp = &tmp};
    assert_int_equal(world_make(&keep, a->seed, a->world, &w), OK);
    world_cameras(&w, &path, a->seed, S, cams);
    assert_int_equal(render_open(&r, &w, &rendered), OK);
    for (int i = 0; i < FRAMES; i++) {
        const double turn = 2.4 * i + (double)a->seed;
        struct camera cam = cams[1];
        const struct render_maps maps = {.radiance = still[i]};
        const struct passer passer = {a->seed, a->share};
        const struct passer_shot shot = {&cam, &quality, (uint64_t)i};
        shift[i][0] = i == 1 ? 0 : a->shake * cos(turn);
        shift[i][1] = i == 1 ? 0 : a->shake * sin(turn);
        cam.cx += (float)shift[i][0];
        cam.cy += (float)shift[i][1];
        assert_int_equal(render_run(&r, rendered, &cam, &quality, a->seed, &maps), OK);
        memcpy(seen[i], still[i], sizeof seen[i]);
        memset(mask[i], 255, sizeof mask[i]);
        if (a->share > 0 && a->who >> i & 1)
            assert_int_equal(passer_draw(&r, rendered, &passer, &shot, seen[i], mask[i]), OK);
    }
    arena_free(&keep);
    arena_free(&tmp);
}

static void set_times(double stops)
{
    static float grey[N];
    memcpy(grey, still[1] + N, sizeof grey);
    const double light = fmax((double)num_median(grey, N), 1e-4);
    for (int i = 0; i < FRAMES; i++)
        time_s[i] =
            0.18 * full() / ((double)sensor_default.electrons * light) * exp2((i - 1) * stops);
}

static void photograph(enum kind kind, uint64_t seed)
{
    static uint16_t numbers[3 * N];
    static uint8_t display[3 * N];
    struct curve curve;
    struct sensor sensor = sensor_default;
    const struct run r = {0};
    sensor.cfa = kind == MOSAIC ? SENSOR_RGGB : SENSOR_RGB;
    curve_make(kind == UNKNOWN ? CURVE_FILMIC : CURVE_SRGB, NAN, 1, &curve);
    for (int i = 0; i < FRAMES; i++) {
        const struct sensor_shot shot = {time_s[i], 1, 0, seed, (uint64_t)i};
        const struct image im = {S, S, 3, seen[i]};
        struct sensor_raw raw = {S, S, numbers};
        const bool linear = kind == LINEAR || kind == MOSAIC;
        assert_int_equal(sensor_expose(&r, &sensor, &shot, &im, &raw), OK);
        assert_int_equal(linear ? OK : sensor_develop(&r, &sensor, &shot, &curve, &raw, display),
                         OK);
        for (int k = 0; k < (kind == MOSAIC ? N : 3 * N); k++)
            px[i][k] = kind == MOSAIC ? numbers[k]
                       : linear       ? numbers[k % 3 * N + k / 3]
                                      : display[k];
        frames[i] = (struct raw){S,
                                 S,
                                 kind == MOSAIC ? RAW_RGGB : RAW_RGB,
                                 linear ? sensor.bits : 8,
                                 linear ? sensor.black : 0,
                                 linear,
                                 px[i]};
    }
}

/* own: arena_free */
static int find(const struct crf *crf, int n, struct arena *a)
{
    const struct merge_set set = {frames, n, time_s, crf, &as_is, NULL};
    const int reference = ghost_reference(&set);
    assert_int_equal(arena_init(a, "ghost", ghost_plan(frames, n)), OK);
    assert_int_equal(ghost_run(a, &set, reference, masks), OK);
    return reference;
}

/* Pixels that differ by three sigma, or are the same: how many, and how many of them are marked. */
struct score {
    double differ, found, same, wrong;
};

/* Over their noise, as EMVA 1288 has it; 0 if one of both is clipped. k: pixel of frame i; kr: the
 * same of the reference. */
static double deviations(int i, size_t k, int r, size_t kr)
{
    const double e = (double)sensor_default.electrons, noise = 6.25 + 2;
    double most = 0;
    for (size_t c = 0; c < 3 * N; c += N) {
        const double x = (double)seen[i][c + k], moved = x - (double)still[i][c + k],
                     y = x - moved + (double)seen[r][c + kr] - (double)still[r][c + kr];
        const double a = e * time_s[i], b = e * time_s[r];
        if (fmax(a * x, b * y) > 0.75 * full())
            return 0;
        most = fmax(most, fabs(x - y) /
                              sqrt((a * x + noise) / (a * a) + (b * fmax(y, 0) + noise) / (b * b)));
    }
    return most;
}

static void add_score(int r, double least, struct score *s)
{
    for (int i = 0; i < FRAMES; i++) {
        const int dx = (int)lrint(shift[i][0] - shift[r][0]),
                  dy = (int)lrint(shift[i][1] - shift[r][1]);
        for (int p = 0; p < N && i != r; p++) {
            const int x = p % S, y = p / S, kr = (y - dy) * S + x - dx;
            if (x < BORDER || y < BORDER || x >= S - BORDER || y >= S - BORDER)
                continue;
            const bool marked = ghost_mask_at(&masks[i], x, y);
            const bool is_still = mask[i][p] == 255 && mask[r][kr] == 255;
            s->same += is_still;
            s->wrong += is_still && marked;
            if (is_still || deviations(i, (size_t)p, r, (size_t)kr) < least)
                continue;
            s->differ++;
            s->found += marked;
        }
    }
}

/* px, of the shift of a frame to the reference. */
static double shift_error(int i, int r)
{
    const double x = (double)masks[i].shift[0] - shift[i][0] + shift[r][0],
                 y = (double)masks[i].shift[1] - shift[i][1] + shift[r][1];
    return hypot(x, y);
}

static void somebody_is_found(void **state)
{
    static const struct bracket scenes[] = {
        {WORLD_ROOM, 1, 0, 0, 0, 4},      {WORLD_ROOM, 2, 0.02f, 1, 0, 4},
        {WORLD_YARD, 11, 0.05f, 5, 1, 4}, {WORLD_ROOM, 3, 0.05f, 2, 0, 2},
        {WORLD_YARD, 12, 0.2f, 4, 3, 3},  {WORLD_ROOM, 4, 0.2f, 1, 3, 4},
    };
    struct score sum[KINDS] = {0};
    double off = 0;
    (void)state;
    for (size_t k = 0; k < sizeof scenes / sizeof scenes[0]; k += (size_t)some_of(3)) {
        draw_frames(&scenes[k]);
        set_times(scenes[k].stops);
        for (int kind = 0; kind < KINDS; kind++) {
            struct score one = {0};
            struct arena a;
            photograph((enum kind)kind, scenes[k].seed);
            const int r = find(kind == DISPLAY ? &srgb : NULL, FRAMES, &a);
            assert_true(masks[r].share == 0);
            for (int i = 0; i < FRAMES && k < 4; i++) // brighter frames of later ones are white
                off = fmax(off, shift_error(i, r));
            add_score(r, kind == LINEAR || kind == MOSAIC ? 3 : 6, &one);
            arena_free(&a);
            print_message("world %zu kind %d: found %.3f of %.0f, wrong %.4f, off %.2f\n", k, kind,
                          one.found / fmax(one.differ, 1), one.differ, one.wrong / one.same, off);
            sum[kind].differ += one.differ;
            sum[kind].found += one.found;
            sum[kind].same += one.same;
            sum[kind].wrong += one.wrong;
        }
    }
    assert_true(off < 0.6);
    for (int kind = 0; kind < KINDS; kind++) {
        print_message("kind %d: found %.3f, wrong %.4f\n", kind, sum[kind].found / sum[kind].differ,
                      sum[kind].wrong / sum[kind].same);
        assert_true(sum[kind].differ > 2000);
        assert_true(sum[kind].found > 0.9 * sum[kind].differ);
        assert_true(sum[kind].wrong < 0.02 * sum[kind].same);
    }
}

/* ---- extremes ---- */

static void fill(int i, int code)
{
    for (int k = 0; k < 3 * N; k++)
        px[i][k] = (uint16_t)code;
}

static void nothing_to_tell(void **state)
{
    struct arena a;
    (void)state;
    draw_frames(&(struct bracket){WORLD_ROOM, 1, 0, 0, 0, 4});
    set_times(4);
    photograph(DISPLAY, 1);
    for (int black = 0; black < 2; black++) { // all clipped, all black
        for (int i = 0; i < FRAMES; i++)
            fill(i, black ? 0 : 255);
        find(NULL, FRAMES, &a);
        for (int i = 0; i < FRAMES; i++)
            assert_true(masks[i].share == 0);
        arena_free(&a);
    }
    photograph(LINEAR, 1);
    memcpy(px[2], px[1], sizeof px[2]); // identical ones
    time_s[2] = time_s[1];
    find(NULL, FRAMES, &a);
    assert_true(masks[0].share < 0.005 && masks[1].share == 0 && masks[2].share == 0);
    arena_free(&a);
    assert_int_equal(find(NULL, 1, &a), 0); // a single one
    assert_true(masks[0].share == 0);
    arena_free(&a);
    frames[0].w = frames[0].h = 1; // of one pixel
    frames[1] = frames[0];
    find(NULL, 2, &a);
    assert_int_equal(masks[0].cols * masks[0].rows, 1);
    arena_free(&a);
}

static void far_apart(void **state)
{
    struct arena a;
    (void)state;
    draw_frames(&(struct bracket){WORLD_ROOM, 1, 0.2f, 2, 0, 12});
    for (int kind = 0; kind < KINDS; kind++) { // 12 and 24 stops: black and white beside a picture
        set_times(12);
        photograph((enum kind)kind, 1);
        const int r = find(kind == DISPLAY ? &srgb : NULL, FRAMES, &a);
        for (int i = 0; i < FRAMES; i++)
            assert_true(i == r || masks[i].share < 0.3);
        arena_free(&a);
    }
}

/* Another world in each frame: most of what can be told differs. */
static void everything_moved(void **state)
{
    static float others[2][3 * N];
    struct arena a;
    (void)state;
    for (int i = 0; i < 2; i++) {
        draw_frames(&(struct bracket){WORLD_ROOM, 20 + (uint64_t)i, 0, 0, 0, 0});
        memcpy(others[i], seen[1], sizeof others[i]);
    }
    set_times(2);
    memcpy(seen[0], others[0], sizeof seen[0]);
    for (int kind = 0; kind < UNKNOWN; kind++) {
        photograph((enum kind)kind, 1);
        const int r = find(kind == DISPLAY ? &srgb : NULL, FRAMES, &a);
        assert_true(masks[r == 0 ? 1 : 0].share > 0.6);
        arena_free(&a);
    }
}

static void too_little_memory(void **state)
{
    const struct merge_set set = {frames, FRAMES, time_s, NULL, &as_is, NULL};
    struct arena a;
    (void)state;
    photograph(MOSAIC, 1);
    const size_t need = ghost_plan(frames, FRAMES);
    for (size_t size = 64; size < need; size += need / 5) {
        assert_int_equal(arena_init(&a, "ghost", size), OK);
        assert_int_equal(ghost_run(&a, &set, 1, masks), ERR_NOMEM);
        arena_free(&a);
    }
}

static void large_frames_shrink(void **state)
{
    (void)state;
    uint16_t v[9 * 8 * 3];
    struct raw r = {9, 8, RAW_RGB, 8, 0, false, v};
    for (int i = 0; i < 9 * 8 * 3; i++)
        v[i] = (uint16_t)(i / 3 % 9 + 10 * (i / 27) + 100 * (i % 3 == 2));
    v[3 * 9 + 1] = 250; // clipped: green of (0, 1)
    ghost_shrink_frame(&r, 2);
    assert_true(r.w == 4 && r.h == 4);
    for (int i = 0; i < 4 * 4 * 3; i++) {
        const int x = i / 3 % 4, y = i / 12;
        const int mean = 2 * x + 20 * y + 5 + 100 * (i % 3 == 2); // and a half
        assert_int_equal(v[i], i == 1 ? 250 : mean);
    }
    struct raw m = {8, 8, RAW_GBRG, 12, 0, true, v};
    for (int i = 0; i < 64; i++)
        v[i] = (uint16_t)(1000 * (i % 2) + 500 * (i / 8 % 2) + i % 8 / 2 + 4 * (i / 16));
    ghost_shrink_frame(&m, 2);
    assert_true(m.w == 4 && m.h == 4);
    for (int i = 0; i < 16; i++) {
        const int x = i % 4, y = i / 4;
        assert_int_equal(v[i], 1000 * (x % 2) + 500 * (y % 2) + 2 * (x / 2) + 8 * (y / 2) + 2);
    }
    ghost_shrink_frame(&m, 1);
    assert_true(m.w == 4);
    struct ghost_mask large = {
        .cell = 4, .cols = 2, .rows = 1, .moved = (uint8_t[]){0, 1}, .shift = {1, -1}};
    ghost_shrink_undo(&large, 3);
    assert_true(!ghost_mask_at(&large, 14, 0) && ghost_mask_at(&large, 15, 0));
    assert_true(ghost_mask_at(&large, 26, 8) && !ghost_mask_at(&large, 27, 0));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(large_frames_shrink), cmocka_unit_test(somebody_is_found),
        cmocka_unit_test(nothing_to_tell),     cmocka_unit_test(far_apart),
        cmocka_unit_test(everything_moved),    cmocka_unit_test(too_little_memory)};
    crf_srgb(&srgb);
    srgb.known = true;
    return cmocka_run_group_tests(tests, NULL, NULL);
}
