/* hdrig simulate: photographs of a simulated scene by a rig, as a data set with ground truth. */
#include "firmware/base/engine.h"
#include "firmware/cmd/cmd.h"
#include "firmware/result/outdir.h"

#include "core/base/num.h"
#include "core/base/rig.h"
#include "drivers/format/apriltags.h"
#include "drivers/format/boardpdf.h"
#include "drivers/format/rigfile.h"
#include "sim/train/dataset.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    INPUTS_MAX = RIG_CAMERAS_MAX,
    BOARD_SIDE = BOARD_STRIDE * BOARD_PITCH_CELLS + BOARD_GAP_CELLS
};

struct request {
    const char *out, *views, *kind, *spread, *orbit, *fov, *exposures, *curve, *local, *samples,
        *moving, *flicker, *balance, *lamp_switch;
    const char *rig_path;
    const char *board, *tag, *distance, *before;
    struct target target;
    unsigned char black[BOARD_SIDE * BOARD_SIDE]; // cells of the board
    const char *lens[CMD_TEXTS_MAX];
    struct optics optics[INPUTS_MAX]; // of `lens`, or of the rig
    struct camera rig[INPUTS_MAX];
    bool noise_free, free_hand, walk, depth;
    struct outdir_rules rules;
    struct config cfg;
};

struct state {
    struct engine engine;
    struct outdir out;
};

/* choices: "first|second|..." */
static err_t parse_choice(const char *option, const char *word, const char *choices, int *out)
{
    const size_t n = strlen(word);
    const char *at = choices;
    for (int i = 0; at; i++) {
        if (strcspn(at, "|") == n && strncmp(at, word, n) == 0) {
            *out = i;
            return OK;
        }
        at = strchr(at, '|');
        at += at ? 1 : 0;
    }
    return err_fail(ERR_ARG, "%s: \"%.64s\" is none of %s", option, word, choices);
}

static err_t read_number(const char *name, const char *text, double min, double max, double *out)
{
    return text ? cmd_number(name, text, min, max, out) : OK;
}

static err_t read_whole(const char *name, const char *text, int min, int max, int *out)
{
    return text ? cmd_whole(name, text, min, max, out) : OK;
}

/* Exposure times relative to the metered one, in ascending order. */
static err_t read_exposures(const char *text, struct dataset_request *a)
{
    char *end = NULL;
    a->n_exposures = 0;
    for (const char *at = text;; at = end + 1) {
        double t = strtod(at, &end);
        if (end == at || (*end && *end != ',') || !(t >= 1e-12 && t <= 1e12))
            return err_fail(ERR_ARG, "--exposures: \"%.64s\" is not a list like 0.125,1,8", text);
        if (a->n_exposures == DATASET_EXPOSURES)
            return err_fail(ERR_ARG, "--exposures: more than %d", DATASET_EXPOSURES);
        a->stops[a->n_exposures++] = (float)log2(t);
        if (a->n_exposures > 1 && !(a->stops[a->n_exposures - 1] > a->stops[a->n_exposures - 2]))
            return err_fail(ERR_ARG, "--exposures: %g does not come after a smaller one", t);
        if (!*end)
            return OK;
    }
}

/* Cameras of the rig that name their lens. fov: degrees, of those that name none. */
static err_t read_optics(struct request *rq, double fov, struct sample_scene *a)
{
    err_t e = OK;
    for (int i = 0; i < CMD_TEXTS_MAX && rq->lens[i] && !e; i++) {
        e = optics_parse("--lens", rq->lens[i], a->size, fov, &rq->optics[i]);
        a->n_optics = i + 1;
    }
    a->optics = rq->optics;
    return e;
}

/* Where the rig has its cameras, and their lenses. */
static err_t use_rig(struct request *rq, const struct rig *rig, struct sample_scene *a)
{
    if (rig->n < 2 || rig->n > INPUTS_MAX)
        return err_fail(ERR_ARG, "--rig: %s has %d cameras, allowed are 2 to %d", rq->rig_path,
                        rig->n, INPUTS_MAX);
    err_t e = OK;
    for (int i = 0; i < rig->n && !e; i++) {
        const struct rig_view *v = &rig->views[i];
        const struct camera *c = &v->cam;
        struct optics *o = &rq->optics[i];
        *o = (struct optics){.w = c->w, .h = c->h, .lens = v->lens, .gain = {1, 1, 1}};
        if (!lens_distorts(&v->lens))
            o->lens = (struct lens){
                .fx = (double)c->fx, .fy = (double)c->fy, .cx = (double)c->cx, .cy = (double)c->cy};
        rq->rig[i] = *c;
        if (num_min(c->w, c->h) < OPTICS_SIDE_MIN || num_max(c->w, c->h) > OPTICS_SIDE_MAX)
            return err_fail(ERR_ARG, "--rig: %s is %d x %d px, allowed are %d to %d", v->name, c->w,
                            c->h, OPTICS_SIDE_MIN, OPTICS_SIDE_MAX);
        e = lens_init(&o->lens);
    }
    a->n_views = 2 * rig->n - 1;
    a->rig = rq->rig;
    a->n_optics = rig->n;
    a->optics = rq->optics;
    return e;
}

static err_t read_rig(struct request *rq, struct sample_scene *a)
{
    struct rig rig;
    if (rq->views || rq->lens[0] || rq->fov || rq->orbit)
        return err_fail(ERR_ARG, "--rig says how many cameras there are, and their lenses: no "
                                 "--views, --lens, --fov or --orbit");
    err_t e = rigfile_read(rq->rig_path, &rig);
    if (!e)
        e = use_rig(rq, &rig, a);
    cameras_free(&rig);
    return e;
}

/* The printed board with a white border as wide as a gap. */
static err_t draw_board(const struct boardpdf *b, struct request *rq)
{
    const int cols = BOARD_PITCH_CELLS * b->board.cols + BOARD_GAP_CELLS,
              rows = BOARD_PITCH_CELLS * b->board.rows + BOARD_GAP_CELLS;
    err_t e = OK;
    rq->target.cells =
        (struct texture_cells){cols, rows, rq->black, (float)(b->tag / 1000 / BOARD_CELLS)};
    for (int i = 0; i < b->board.cols * b->board.rows && !e; i++) {
        const int col = i % b->board.cols, row = i / b->board.cols;
        uint8_t cells[APRILTAGS_EDGE][APRILTAGS_EDGE];
        e = apriltags_cells(board_id(col, row), cells);
        for (int k = 0; k < APRILTAGS_EDGE * APRILTAGS_EDGE && !e; k++) {
            const int x = BOARD_PITCH_CELLS * col + BOARD_GAP_CELLS + k % APRILTAGS_EDGE,
                      y = BOARD_PITCH_CELLS * row + BOARD_GAP_CELLS + k / APRILTAGS_EDGE;
            rq->black[y * cols + x] = !cells[k / APRILTAGS_EDGE][k % APRILTAGS_EDGE];
        }
    }
    return e;
}

/* A board, and where it stands. */
static err_t read_board(struct request *rq, struct sample_scene *a)
{
    double tag = 0, distance = 1;
    int first = 1, last = (a->n_views + 1) / 2, end = 0;
    struct boardpdf b;
    if (!rq->board && (rq->tag || rq->distance || rq->before))
        return err_fail(ERR_ARG, "--tag, --distance and --before need --board");
    if (!rq->board)
        return OK;
    err_t e = read_number("--tag", rq->tag, 1, 1000, &tag);
    if (!e)
        e = read_number("--distance", rq->distance, 0.05, 100, &distance);
    if (!e && rq->before &&
        (sscanf(rq->before, "%3d-%3d%n", &first, &last, &end) != 2 || rq->before[end] ||
         first < 1 || last < first || last > (a->n_views + 1) / 2))
        e = err_fail(ERR_ARG, "--before: \"%.32s\" is not like 1-2, of %d cameras", rq->before,
                     (a->n_views + 1) / 2);
    if (!e)
        e = boardpdf_choose(rq->board, tag, &b);
    if (!e)
        e = draw_board(&b, rq);
    rq->target.seed = a->seed;
    rq->target.first = first - 1;
    rq->target.last = last - 1;
    rq->target.distance = (float)distance;
    a->target = &rq->target;
    return e;
}

static err_t read_scene(struct request *rq, struct dataset_request *a)
{
    double spread = 0.3, orbit = 0, fov = 60;
    int views = 9, samples = 6;
    err_t e = read_whole("--views", rq->views, 2, rq->walk ? SAMPLE_VIEWS : INPUTS_MAX, &views);
    if (!e)
        e = read_number("--spread", rq->spread, 0, 1, &spread);
    if (!e)
        e = read_number("--orbit", rq->orbit, 1, 180, &orbit);
    if (!e)
        e = read_number("--fov", rq->fov, 20, 120, &fov);
    if (!e)
        e = read_whole("--samples", rq->samples, 1, 8, &samples);
    a->sample = (struct sample_scene){.seed = (uint64_t)rq->cfg.seed,
                                      .kind = WORLD_ANY,
                                      .n_views = rq->walk ? views : 2 * views - 1,
                                      .size = rq->cfg.size > 0 ? rq->cfg.size : 448,
                                      .spread = (float)spread,
                                      .fov_deg = (float)fov,
                                      .jitter = rq->free_hand,
                                      .orbit_deg =
                                          (float)orbit / 2, // a view is held out between two inputs
                                      .walk = rq->walk,
                                      .quality = {.samples = samples}};
    /* with more rays per pixel, each needs fewer for its shadows */
    a->sample.quality.shadow = samples < 4 ? 4 / samples : 1;
    if (!e)
        e = rq->rig_path ? read_rig(rq, &a->sample) : read_optics(rq, fov, &a->sample);
    if (!e && rq->kind)
        e = parse_choice("--kind", rq->kind, WORLD_WORDS, &a->sample.kind);
    if (!e)
        e = read_board(rq, &a->sample);
    if (!e && orbit > 0 && a->sample.kind != WORLD_PARK)
        e = err_fail(ERR_ARG, "--orbit: only --kind park has room all around");
    if (!e && rq->walk && (a->sample.kind != WORLD_PARK || rq->rig_path || rq->board || rq->orbit))
        e = err_fail(ERR_ARG,
                     "--walk: only in --kind park, and not with --rig, --board or --orbit");
    return e;
}

static err_t read_request(struct request *rq, struct dataset_request *a)
{
    int family = CURVE_FILMIC, local = LOCAL_TONE_NONE;
    double moving = 0, flicker = 0, balance = 0, lit = 0;
    err_t e = read_scene(rq, a);
    if (!e)
        e = read_exposures(rq->exposures ? rq->exposures : "0.015625,0.0625,0.25,1,4", a);
    if (!e && rq->curve)
        e = parse_choice("--curve", rq->curve, CURVE_WORDS, &family);
    if (!e && rq->local)
        e = parse_choice("--local-tone", rq->local, LOCAL_TONE_WORDS, &local);
    if (!e)
        e = read_number("--moving", rq->moving, PASSER_SHARE_MIN, PASSER_SHARE_MAX, &moving);
    if (!e)
        e = read_number("--flicker", rq->flicker, 0, DATASET_FLICKER_MAX, &flicker);
    if (!e)
        e = read_number("--white-balance", rq->balance, 0, DATASET_FLICKER_MAX, &balance);
    if (!e)
        e = read_number("--lamp-switch", rq->lamp_switch, 0, 1, &lit);
    if (e)
        return e;
    a->passer = (struct passer){a->sample.seed, (float)moving};
    a->flicker = (float)flicker;
    a->balance = (float)balance;
    a->lit = (float)lit;
    a->sample.switched = rq->lamp_switch ? SAMPLE_OFF : SAMPLE_NO_SWITCH;
    a->noise = !rq->noise_free;
    a->local = (enum local_tone)local;
    a->input_truth = rq->depth;
    curve_make((enum curve_family)family, NAN, a->sample.seed, &a->curve);
    return OK;
}

static void report_optics(const struct request *rq, struct report *rep)
{
    if (rq->rig_path)
        report_text(rep, "rig", rq->rig_path);
    if (!rq->lens[0])
        return;
    report_open(rep, "cameras", '[');
    for (int i = 0; i < CMD_TEXTS_MAX && rq->lens[i]; i++) {
        const struct optics *o = &rq->optics[i];
        const double vignette[2] = {(double)o->vignette[0], (double)o->vignette[1]};
        const double gain[3] = {(double)o->gain[0], (double)o->gain[1], (double)o->gain[2]};
        report_open(rep, NULL, '{');
        report_int(rep, "camera", i + 1);
        report_text(rep, "lens", rq->lens[i]);
        report_row(rep, "vignette", vignette, 2);
        report_bool(rep, "cos4", o->cos4);
        report_row(rep, "gain", gain, 3);
        report_close(rep);
    }
    report_close(rep);
}

/* Marks the folder as a result, and tells how it was made. */
static err_t write_report(const struct request *rq, const struct dataset_request *a,
                          struct outdir *o)
{
    struct report rep;
    err_t e = outdir_report_open(o, &rep);
    if (e)
        return e;
    report_int(&rep, "seed", (long long)a->sample.seed);
    report_text(&rep, "kind", rq->kind ? rq->kind : "any");
    report_int(&rep, "views", a->sample.n_views);
    report_int(&rep, "size", a->sample.size);
    report_number(&rep, "spread", (double)a->sample.spread);
    if (rq->orbit)
        report_number(&rep, "orbit_deg", 2 * (double)a->sample.orbit_deg);
    report_bool(&rep, "walk", a->sample.walk != 0);
    report_number(&rep, "fov_deg", (double)a->sample.fov_deg);
    report_optics(rq, &rep);
    if (rq->board) {
        report_text(&rep, "board", rq->board);
        report_number(&rep, "cell_m", (double)rq->target.cells.size);
    }
    report_bool(&rep, "free_hand", a->sample.jitter != 0);
    report_int(&rep, "samples", a->sample.quality.samples);
    if (rq->moving)
        report_number(&rep, "moving", (double)a->passer.share);
    if (rq->flicker)
        report_number(&rep, "flicker_stops", (double)a->flicker);
    if (rq->balance)
        report_number(&rep, "white_balance_stops", (double)a->balance);
    if (rq->lamp_switch)
        report_number(&rep, "lamp_switch", (double)a->lit);
    report_bool(&rep, "noise", a->noise);
    if (rq->local)
        report_text(&rep, "local_tone", rq->local);
    report_text(&rep, "curve", rq->curve ? rq->curve : "filmic");
    return outdir_report_close(o, &rep);
}

static err_t write_dataset(const struct request *rq, const struct dataset_request *a,
                           struct state *st)
{
    const int held_out = a->sample.walk ? 0 : a->sample.n_views / 2;
    err_t e = engine_open(&st->engine, rq->cfg.threads);
    struct plan p = plan_begin(pool_size(st->engine.pool));
    dataset_plan(&p, a);
    if (!e)
        e = engine_reserve(&st->engine, 0, p.keep.peak, p.tmp.peak, config_memory_mb(&rq->cfg));
    if (!e)
        e = outdir_open(rq->out, &rq->rules, &st->out);
    if (!e)
        e = outdir_reserve(&st->out, dataset_bytes(a));
    if (!e)
        e = dataset_write(&st->engine.run, a, st->out.partial.dir);
    if (!e)
        e = write_report(rq, a, &st->out);
    if (e && st->out.partial.dir[0])
        e = outdir_reason(&st->out, e);
    if (!e)
        e = outdir_commit(&st->out);
    progress_end(&st->engine.progress);
    if (!e)
        printf("%s: %d input views at %d exposures, %d held out at %d\n", rq->out,
               a->sample.n_views - held_out, a->n_exposures < 3 ? a->n_exposures : 3, held_out,
               a->n_exposures);
    return e;
}

static int simulate(const struct cmd_usage *usage, struct request *rq, int argc, char **argv)
{
    static struct state st;
    static struct dataset_request request;
    int code;
    if (!cmd_parse(usage, argc, argv, &rq->cfg, &code))
        return code;
    if (!rq->out)
        return cmd_misuse(usage, "--out is needed");
    if (read_request(rq, &request) != OK)
        return cmd_misuse(usage, err_text());
    code = cmd_finish(usage->name, write_dataset(rq, &request, &st));
    outdir_close(&st.out);
    engine_close(&st.engine);
    return code;
}

static struct request rq;

static const struct cmd_option options[] = {
    {"out", "DIR", "folder of the data set; a former one is replaced", NULL, &rq.out, NULL},
    CMD_FORCE(rq.rules),
    CMD_KEY("seed", "N", "seed", "which world"),
    {"views", "N", "inputs, 2..128; a view is held out between two (9)", NULL, &rq.views, NULL},
    {"kind", "K",
     "room, yard, dark, plain, mirror or park (default: the seed chooses room or yard)", NULL,
     &rq.kind, NULL},
    {"spread", "X", "0 all cameras in one place .. 1 around the subject (0.3)", NULL, &rq.spread,
     NULL},
    {"orbit", "DEG", "in a park: input views all around the subject, DEG degrees apart, 1..180",
     NULL, &rq.orbit, NULL},
    {"walk", NULL, "in a park: 2..256 views around the subject, all inputs", NULL, NULL, &rq.walk},
    {"depth", NULL, "write radiance and depth of the input views, too", NULL, NULL, &rq.depth},
    {"fov", "DEG", "field of view, 20..120 (60)", NULL, &rq.fov, NULL},
    {"lens", "SPEC...",
     "a camera: k1=-0.25,k2=0.05 (k1 k2 p1 p2) or fisheye,k1=.. (k1..k4), fov=70 size=800x600 "
     "v2=-0.3 v4=0.05 cos4 gain=1.1 wb=1.05/1/0.97; several take turns",
     NULL, rq.lens, NULL},
    {"rig", "PATH", "the cameras of a rig: rig.json, cameras.json, COLMAP; brought into place",
     NULL, &rq.rig_path, NULL},
    {"board", "P",
     "a board of tags before the cameras, as hdrig rig board prints it on " BOARDPDF_PAPERS
     "; lengths of --rig are metres then",
     NULL, &rq.board, NULL},
    {"tag", "MM", "edge of a tag of the board", NULL, &rq.tag, NULL},
    {"distance", "M", "of the board from the cameras (1)", NULL, &rq.distance, NULL},
    {"before", "A-B", "cameras that the board stands before (all)", NULL, &rq.before, NULL},
    {"free-hand", NULL, "vary height, target and roll of the cameras", NULL, NULL, &rq.free_hand},
    {"exposures", "LIST", "exposure times, relative to the metered one (0.015625,0.0625,0.25,1,4)",
     NULL, &rq.exposures, NULL},
    {"curve", "C", "linear, srgb, gamma, filmic, agx, log or random (filmic)", NULL, &rq.curve,
     NULL},
    {"local-tone", "L",
     "what a telephone does to its pictures before the curve: none, base, clahe or fusion "
     "(none)",
     NULL, &rq.local, NULL},
    {"moving", "SHARE",
     "somebody passes by in a third of the inputs' photographs and covers that share of them, "
     "0.002..0.3; truth/masks says where",
     NULL, &rq.moving, NULL},
    {"flicker", "STOPS",
     "the light of each of the inputs' photographs is up to STOPS brighter or darker, 0..3; "
     "truth/light.json says how much",
     NULL, &rq.flicker, NULL},
    {"white-balance", "STOPS",
     "red and blue of each input are up to STOPS brighter or darker beside green, as by automatic "
     "white balance, 0..3; truth/red.json and blue.json say how much",
     NULL, &rq.balance, NULL},
    {"lamp-switch", "SHARE",
     "a lamp, outdoors the sun, is on in that share of the inputs only, 0..1; truth/lamp.json "
     "says in which",
     NULL, &rq.lamp_switch, NULL},
    {"noise-free", NULL, "no noise", NULL, NULL, &rq.noise_free},
    {"samples", "N", "rays per pixel and axis, 1..8 (6)", NULL, &rq.samples, NULL},
    CMD_SIZE,
    CMD_THREADS,
    CMD_MEMORY,
};

int cmd_simulate_run(int argc, char **argv)
{
    const struct cmd_usage usage = {
        "simulate", "--out DIR ",
        "A procedural world, photographed by a simulated rig, in the released data layout.",
        options, sizeof options / sizeof options[0]};
    return simulate(&usage, &rq, argc, argv);
}
