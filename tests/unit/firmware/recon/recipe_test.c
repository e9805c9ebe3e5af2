/* What a job does, for every combination of what decides it: whether cameras come with the
 * photographs, which network there is, and the settings. */
#include "firmware/recon/recipe.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS = 3, SIZE = 70 };

/* The network: none, one that comes with the program and is asked for cameras alone, one with
 * cameras and depth, one with Gaussians too. */
static const char networks[] = "-cdg";

static struct shot shots[VIEWS];

static struct capture capture(bool known)
{
    for (int i = 0; i < VIEWS; i++)
        shots[i] = (struct shot){.exposure = 1, .has_camera = known};
    return (struct capture){VIEWS, shots};
}

static struct job_config config(char network, const char *settings)
{
    static struct network net;
    net.net.d = (struct net_dims){.gauss = network != 'd', .size = 224};
    return (struct job_config){
        .size = SIZE,
        .network = network == '-' ? NULL : &net,
        .cameras_only = network == 'c',
        .polish = strchr(settings, 'p') != NULL,
        .stereo = strchr(settings, 's') != NULL,
        .refine = {.steps = strchr(settings, 'r') != NULL, .degree_max = 2, .gaussians_max = 1000}};
}

/* A recipe in six letters: cameras (Given, Bundle, Network), depth (Stereo, Network), Gaussians
 * (Seeds, Network); then what is done: n network asked, b bundle adjustment, m must place,
 * c correct, f forward, r refine. */
static const char *told(const struct recipe *r)
{
    static char text[16];
    const bool done[] = {r->network, r->bundle, r->must_place, r->correct, r->forward, r->refine};
    const char *letters = "nbmcfr";
    int n = 0;
    text[n++] = "GB  N"[r->cameras];
    text[n++] = "  S N"[r->depth];
    text[n++] = "   sN"[r->gaussians];
    text[n++] = ' ';
    for (int i = 0; i < 6; i++)
        if (done[i])
            text[n++] = letters[i];
    text[n] = 0;
    return text;
}

/* Columns: settings without r, with r (refinement has steps). Rows: cameras (k known, u unknown),
 * network, then p polish, s start from stereo, t tapped. */
static const struct row {
    const char *what, *still, *steps;
} rows[] = {
    /* no network: only whether cameras are known matters */
    {"k-   ", "GSs r", "GSs r"},
    {"k-p  ", "GSs r", "GSs r"},
    {"k-s  ", "GSs r", "GSs r"},
    {"k-ps ", "GSs r", "GSs r"},
    {"u-   ", "BSs bmr", "BSs bmr"},
    {"u-p  ", "BSs bmr", "BSs bmr"},
    {"u-s  ", "BSs bmr", "BSs bmr"},
    {"u-ps ", "BSs bmr", "BSs bmr"},
    /* cameras alone: not asked for known ones, and never for depth, which no bundle would scale */
    {"kc   ", "GSs r", "GSs r"},
    {"kcp  ", "GSs r", "GSs r"},
    {"kcs  ", "GSs r", "GSs r"},
    {"kcps ", "GSs r", "GSs r"},
    {"uc   ", "NSs nr", "NSs nr"},
    {"ucp  ", "BSs nbmr", "BSs nbmr"},
    {"ucs  ", "NSs nr", "NSs nr"},
    {"ucps ", "BSs nbmr", "BSs nbmr"},
    /* cameras and depth */
    {"kd   ", "GNs nr", "GNs nr"},
    {"kdp  ", "GNs nr", "GNs nr"},
    {"kds  ", "GSs r", "GSs r"},
    {"kdps ", "GSs r", "GSs r"},
    {"ud   ", "NNs nr", "NNs nr"},
    {"udp  ", "BNs nbr", "BNs nbr"},
    {"uds  ", "NSs nr", "NSs nr"},
    {"udps ", "BSs nbr", "BSs nbr"},
    /* Gaussians: without steps the forward pass is the scene, whatever stereo could do */
    {"kg   ", "GNN nf", "GNN nr"},
    {"kgp  ", "GNN nbcf", "GNN nbcr"},
    {"kgs  ", "GNN nf", "GSs r"},
    {"kgps ", "GNN nbcf", "GSs r"},
    {"ug   ", "NNN nf", "NNN nr"},
    {"ugp  ", "BNN nbcf", "BNN nbcr"},
    {"ugs  ", "NNN nf", "NSs nr"},
    {"ugps ", "BNN nbcf", "BSs nbr"},
    /* dumped is the network's own: no bundle adjustment, no stereo; known cameras are kept */
    {"k-t  ", "GSs r", "GSs r"},
    {"k-pt ", "GSs r", "GSs r"},
    {"k-st ", "GSs r", "GSs r"},
    {"k-pst", "GSs r", "GSs r"},
    {"u-t  ", "BSs bmr", "BSs bmr"},
    {"u-pt ", "BSs bmr", "BSs bmr"},
    {"u-st ", "BSs bmr", "BSs bmr"},
    {"u-pst", "BSs bmr", "BSs bmr"},
    {"kct  ", "GSs r", "GSs r"},
    {"kcpt ", "GSs r", "GSs r"},
    {"kcst ", "GSs r", "GSs r"},
    {"kcpst", "GSs r", "GSs r"},
    {"uct  ", "NSs nr", "NSs nr"},
    {"ucpt ", "NSs nr", "NSs nr"},
    {"ucst ", "NSs nr", "NSs nr"},
    {"ucpst", "NSs nr", "NSs nr"},
    {"kdt  ", "GNs nr", "GNs nr"},
    {"kdpt ", "GNs nr", "GNs nr"},
    {"kdst ", "GNs nr", "GNs nr"},
    {"kdpst", "GNs nr", "GNs nr"},
    {"udt  ", "NNs nr", "NNs nr"},
    {"udpt ", "NNs nr", "NNs nr"},
    {"udst ", "NNs nr", "NNs nr"},
    {"udpst", "NNs nr", "NNs nr"},
    {"kgt  ", "GNN nf", "GNN nr"},
    {"kgpt ", "GNN nf", "GNN nr"},
    {"kgst ", "GNN nf", "GNN nr"},
    {"kgpst", "GNN nf", "GNN nr"},
    {"ugt  ", "NNN nf", "NNN nr"},
    {"ugpt ", "NNN nf", "NNN nr"},
    {"ugst ", "NNN nf", "NNN nr"},
    {"ugpst", "NNN nf", "NNN nr"},
};

enum { ROWS = sizeof rows / sizeof rows[0] };

static void every_combination(void **state)
{
    (void)state;
    bool seen[2][4][8] = {{{false}}};
    for (int i = 0; i < ROWS; i++) {
        const char *what = rows[i].what;
        const bool known = what[0] == 'k', tapped = strchr(what, 't') != NULL;
        const int network = (int)(strchr(networks, what[1]) - networks);
        const int set = (strchr(what, 'p') != NULL) + 2 * (strchr(what, 's') != NULL) + 4 * tapped;
        const struct capture c = capture(known);
        assert_false(seen[known][network][set]);
        seen[known][network][set] = true;
        for (int steps = 0; steps < 2; steps++) {
            char settings[8];
            snprintf(settings, sizeof settings, "%s%s", what + 2, steps ? "r" : "");
            const struct job_config cfg = config(what[1], settings);
            const struct recipe r = recipe_choose(&c, &cfg, tapped);
            const char *want = steps ? rows[i].steps : rows[i].still;
            if (strcmp(told(&r), want) != 0)
                fail_msg("%s, %d steps: %s, not %s", what, steps, told(&r), want);
        }
    }
    assert_int_equal(ROWS, 2 * 4 * 8); // hence all of them
}

/* What follows from the sources, in words that planning and running rely on. */
static void what_always_holds(void **state)
{
    (void)state;
    for (int i = 0; i < ROWS; i++)
        for (int steps = 0; steps < 2; steps++) {
            const bool known = rows[i].what[0] == 'k', tapped = strchr(rows[i].what, 't') != NULL;
            char settings[8];
            snprintf(settings, sizeof settings, "%s%s", rows[i].what + 2, steps ? "r" : "");
            const struct job_config cfg = config(rows[i].what[1], settings);
            const struct capture c = capture(known);
            const struct recipe r = recipe_choose(&c, &cfg, tapped);
            assert_true(r.gaussians != RECIPE_NETWORK || r.depth == RECIPE_NETWORK);
            assert_true(r.network || (r.cameras != RECIPE_NETWORK && r.depth == RECIPE_STEREO));
            assert_true(!r.network || cfg.network);
            assert_true(r.bundle || r.cameras != RECIPE_BUNDLE);
            assert_true(!r.correct || (r.bundle && r.gaussians == RECIPE_NETWORK));
            assert_true(r.refine != r.forward);
            assert_true(r.refinement.poses == (r.cameras == RECIPE_BUNDLE));
            assert_int_equal(r.forward, recipe_forward(&cfg));
            assert_int_equal(r.places, VIEWS);
            assert_int_equal(r.gaussians_max, r.forward ? VIEWS * SIZE * SIZE : 1000);
            assert_int_equal(r.degree_max, r.forward ? SH_DEGREE_MAX : 2);
        }
}

static void no_more_gaussians_than_pixels(void **state)
{
    (void)state;
    const struct capture c = capture(true);
    struct job_config cfg = config('-', "r");
    cfg.refine.gaussians_max = 1 << 20;
    struct recipe r = recipe_choose(&c, &cfg, false);
    assert_int_equal(r.gaussians_max, VIEWS * SIZE * SIZE);
    assert_int_equal(r.refinement.gaussians_max, VIEWS * SIZE * SIZE);
    shots[2].again = true; // another exposure of the second place
    r = recipe_choose(&c, &cfg, false);
    assert_int_equal(r.gaussians_max, 2 * SIZE * SIZE);
}

static void sizes(void **state)
{
    (void)state;
    struct shot all[VIEWS] = {0};
    struct capture c = {VIEWS, all};
    struct job_config cfg = config('-', "psr");
    for (int i = 0; i < VIEWS; i++)
        all[i].image = (struct image8){.w = 300, .h = 1000 + i};
    assert_int_equal(recipe_size(&cfg, &c), cfg.size); // as asked
    cfg.size = RECIPE_SIZE_FULL;
    assert_int_equal(recipe_size(&cfg, &c), 1000 + VIEWS - 1);
    cfg.size = RECIPE_SIZE_AUTO;
    assert_int_equal(recipe_size(&cfg, &c), 1000 + VIEWS - 1);
    all[0].image.w = 100000000 / 300;
    assert_int_equal(recipe_size(&cfg, &c), RECIPE_AUTO_MAX);
    cfg.size = RECIPE_SIZE_FULL;
    assert_int_equal(recipe_size(&cfg, &c), 4080); // what is drawn at once
    for (int i = 0; i < VIEWS; i++)
        all[i].image = (struct image8){.w = 300, .h = 200};
    cfg.size = RECIPE_SIZE_AUTO;
    assert_int_equal(recipe_size(&cfg, &c), 448);
    cfg.square = true;
    assert_int_equal(recipe_size(&cfg, &c), 448);
    cfg = config('g', "psr"); // stereo sees the scene
    cfg.size = RECIPE_SIZE_AUTO;
    assert_int_equal(recipe_size(&cfg, &c), 448);
    cfg = config('g', "pr");
    cfg.size = RECIPE_SIZE_AUTO;
    assert_int_equal(recipe_size(&cfg, &c), 224);
    cfg = config('g', "ps");
    cfg.size = RECIPE_SIZE_AUTO;
    assert_int_equal(recipe_size(&cfg, &c), 224);
    cfg = config('c', "p");
    cfg.size = RECIPE_SIZE_AUTO;
    assert_int_equal(recipe_size(&cfg, &c), 448);
}

/* Cameras of test photographs: none is known, whatever the scene starts from. */
static void cameras_alone(void **state)
{
    (void)state;
    for (const char *n = networks; *n; n++)
        for (int polish = 0; polish < 2; polish++) {
            const struct job_config cfg = config(*n, polish ? "pr" : "r");
            const struct recipe r = recipe_of_cameras(&cfg);
            assert_int_equal(r.network, *n != '-');
            assert_int_equal(r.bundle, *n == '-' || polish);
        }
}

/* Whether the cameras are where the calibration has them. */
static void rigs_are_checked(void **state)
{
    static const int sizes[] = {2, 3, 100, 128, 129};
    static struct shot many[129];
    const struct job_config cfg = config('-', "s");
    (void)state;
    for (int i = 0; i < 129; i++)
        many[i] = (struct shot){.exposure = 1, .has_camera = true, .calibrated = true};
    for (int i = 0; i < 5; i++) {
        const struct capture c = {sizes[i], many};
        assert_int_equal(recipe_choose(&c, &cfg, false).check, i > 0 && i < 4);
    }
    many[99].calibrated = false;
    assert_false(recipe_choose(&(struct capture){100, many}, &cfg, false).check);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(rigs_are_checked),
                                       cmocka_unit_test(every_combination),
                                       cmocka_unit_test(what_always_holds),
                                       cmocka_unit_test(no_more_gaussians_than_pixels),
                                       cmocka_unit_test(sizes),
                                       cmocka_unit_test(cameras_alone)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
