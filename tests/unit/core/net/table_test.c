/* The table against the lists of the released model (tests/data/net/full.txt: name, shape, used)
 * and of the small one of the golden data. */
#include "core/net/table.h"

#include "tests/unit/core/net/tiny_net.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

struct reading {
    FILE *f;
    int n;
    bool has_used;
    size_t used; // elements
};

static err_t compare(void *ctx, const struct tensor_spec *t)
{
    struct reading *r = ctx;
    char line[512], name[128], shape[64], used[32], mine[64];
    assert_non_null(fgets(line, sizeof line, r->f));
    assert_true(sscanf(line, "%127s %63s %31s", name, shape, used) >= 2);
    int n = 0;
    for (int k = 0; k < t->rank; k++)
        n += snprintf(mine + n, sizeof mine - (size_t)n, k ? "x%d" : "%d", t->shape[k]);
    assert_string_equal(t->name, name);
    assert_string_equal(mine, shape);
    if (r->has_used) // div_term can be computed, so nobody reads it
        assert_int_equal(t->used, used[0] == 'y' && !strstr(name, "div_term"));
    r->n++;
    r->used += t->used ? table_count(t) : 0;
    return OK;
}

static struct reading compare_with(const char *path, const struct net_dims *d, bool has_used)
{
    struct reading r = {.f = fopen(path, "r"), .has_used = has_used};
    assert_non_null(r.f);
    assert_int_equal(table_check(d), OK);
    assert_int_equal(table_walk(d, compare, &r), OK);
    assert_int_equal(fgetc(r.f), EOF);
    fclose(r.f);
    return r;
}

static void every_tensor_of_the_release_is_there_in_order(void **state)
{
    (void)state;
    struct reading full = compare_with("tests/data/net/full.txt", &table_full, true);
    assert_int_equal(full.n, 1456);
    assert_true(full.used == 1201892146 - 64);
    struct reading mini = compare_with("tests/data/net/mini.txt", &table_mini, false);
    assert_int_equal(mini.n, 500);
}

struct search {
    const char *name;
    struct tensor_spec t;
    int found, n, exact;
};

static err_t search(void *ctx, const struct tensor_spec *t)
{
    struct search *s = ctx;
    s->n++;
    s->exact += t->exact;
    if (strcmp(t->name, s->name) == 0) {
        s->t = *t;
        s->found++;
    }
    return OK;
}

static struct search find(const struct net_dims *d, const char *name)
{
    struct search s = {.name = name};
    assert_int_equal(table_walk(d, search, &s), OK);
    return s;
}

static void roles_follow_from_names_and_shapes(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        enum tensor_role role;
        bool exact;
        int repeat;
    } known[] = {
        {"encoder.aggregator.patch_embed.mask_token", ROLE_PLAIN, false, 1},
        {"encoder.aggregator.patch_embed.pos_embed", ROLE_PLAIN, false, 1},
        {"encoder.aggregator.patch_embed.patch_embed.proj.weight", ROLE_CONV, true, 1},
        {"encoder.aggregator.patch_embed.patch_embed.proj.bias", ROLE_PLAIN, false, 1},
        {"encoder.aggregator.frame_blocks.3.attn.qkv.weight", ROLE_LINEAR, false, 1},
        {"encoder.aggregator.frame_blocks.3.attn.q_norm.weight", ROLE_PLAIN, false, 1},
        {"encoder.aggregator.global_blocks.0.ls2.gamma", ROLE_PLAIN, false, 1},
        {"encoder.camera_head.trunk.0.mlp.fc2.weight", ROLE_LINEAR, false, 1},
        {"encoder.camera_head.embed_pose.weight", ROLE_LINEAR, true, 1},
        {"encoder.camera_head.poseLN_modulation.1.weight", ROLE_LINEAR, false, 1},
        {"encoder.camera_head.pose_branch.fc1.weight", ROLE_LINEAR, true, 1},
        {"encoder.depth_head.projects.0.weight", ROLE_CONV, false, 1},
        {"encoder.depth_head.resize_layers.0.weight", ROLE_CONV_T, false, 1},
        {"encoder.depth_head.resize_layers.0.bias", ROLE_PLAIN, false, 16},
        {"encoder.depth_head.resize_layers.1.weight", ROLE_CONV_T, false, 1},
        {"encoder.depth_head.resize_layers.1.bias", ROLE_PLAIN, false, 4},
        {"encoder.depth_head.resize_layers.3.weight", ROLE_CONV, false, 1},
        {"encoder.depth_head.scratch.output_conv2.0.weight", ROLE_CONV, false, 1},
        {"encoder.depth_head.scratch.output_conv2.2.weight", ROLE_CONV, true, 1},
        {"encoder.hdr_head.guide_encoder.0.weight", ROLE_CONV, true, 1},
        {"encoder.hdr_head.regression.ln.weight", ROLE_PLAIN, false, 1},
        {"encoder.hdr_head.regression.exp_film.2.weight", ROLE_LINEAR, true, 1},
        {"encoder.hdr_head.sensitivity_conv.0.weight", ROLE_CONV, false, 1},
        {"encoder.hdr_head.sensitivity_conv.2.weight", ROLE_CONV, true, 1},
        {"encoder.hdr_conv.0.weight", ROLE_CONV, true, 1},
        {"encoder.hdr_conv.2.weight", ROLE_CONV, true, 1},
        {"encoder.generate_tonemapper.enc.0.weight", ROLE_CONV, false, 1},
        {"encoder.generate_tonemapper.exp_proj.weight", ROLE_LINEAR, true, 1},
        {"encoder.generate_tonemapper.out.0.weight", ROLE_LINEAR, true, 1},
        {"encoder.generate_tonemapper.out.2.weight", ROLE_LINEAR, true, 1},
    };
    for (size_t k = 0; k < sizeof known / sizeof known[0]; k++) {
        struct search s = find(&table_full, known[k].name);
        assert_int_equal(s.found, 1);
        assert_int_equal(s.t.role, known[k].role);
        assert_int_equal(s.t.exact, known[k].exact);
        assert_int_equal(s.t.repeat, known[k].repeat);
        assert_int_equal(s.exact, 26);
    }
}

static void older_networks_are_parts_of_it(void **state)
{
    (void)state;
    struct net_dims splat = table_full, vggt = table_full;
    splat.appearance = false;
    assert_int_equal(table_check(&splat), OK);
    struct search s = find(&splat, "encoder.gaussian_param_head.input_merger.0.weight");
    assert_int_equal(s.n, 1456 - 37 - 4 - 10);
    assert_true(s.found == 1 && s.t.used && s.t.exact);
    assert_int_equal(find(&splat, "encoder.hdr_conv.0.weight").found, 0);
    assert_false(find(&table_full, s.name).t.used);
    vggt.appearance = vggt.gauss = false;
    vggt.gs_feat = vggt.hdr = 0;
    memset(vggt.gs_oc, 0, sizeof vggt.gs_oc);
    assert_int_equal(table_check(&vggt), OK);
    assert_int_equal(find(&vggt, "").n, 2 + 344 + 432 + 432 + 69 + 62);
}

static void a_completion_branch_comes_last(void **state)
{
    static const struct {
        const char *name;
        int shape[3];
        bool exact;
    } known[] = {
        {"encoder.complete.down.0.weight", {32, 15, 3}, true},
        {"encoder.complete.down.1.weight", {48, 32, 3}, true},
        {"encoder.complete.down.5.weight", {128, 128, 3}, false},
        {"encoder.complete.stay.3.1.weight", {96, 96, 3}, false},
        {"encoder.complete.up.0.weight", {32, 48, 1}, false},
        {"encoder.complete.join.0.weight", {32, 32, 3}, true},
        {"encoder.complete.join.4.weight", {128, 128, 3}, false},
        {"encoder.complete.out.weight", {3, 32, 3}, true},
    };
    struct net_dims d = table_full;
    (void)state;
    d.complete = true;
    assert_int_equal(table_check(&d), OK);
    for (size_t k = 0; k < sizeof known / sizeof known[0]; k++) {
        const struct search s = find(&d, known[k].name);
        assert_int_equal(s.n, 1456 + 2 * (6 + 7 + 5 + 5 + 1));
        assert_int_equal(s.found, 1);
        assert_true(s.t.rank == 4 && s.t.role == ROLE_CONV && s.t.used);
        assert_int_equal(s.t.exact, known[k].exact);
        for (int i = 0; i < 4; i++)
            assert_int_equal(s.t.shape[i], known[k].shape[i < 3 ? i : 2]);
    }
    assert_int_equal(find(&d, "encoder.complete.stay.0.0.weight").found, 0);
    assert_int_equal(find(&table_full, "encoder.complete.out.weight").found, 0);
}

/* Every source is met once, and the product computes what the convolution does. */
static void sources_are_a_permutation(void **state)
{
    (void)state;
    static const struct tensor_spec specs[] = {
        {.role = ROLE_LINEAR, .rank = 2, .shape = {5, 7, 1, 1}},
        {.role = ROLE_CONV, .rank = 4, .shape = {5, 3, 2, 4}},
        {.role = ROLE_CONV_T, .rank = 4, .shape = {3, 5, 2, 2}},
    };
    for (int k = 0; k < 3; k++) {
        const struct tensor_spec *t = &specs[k];
        struct product_shape p = table_product(t);
        int seen[120] = {0}, inputs = p.segs * p.seg;
        assert_int_equal((size_t)p.n * (size_t)inputs, table_count(t));
        for (int o = 0; o < p.n; o++)
            for (int i = 0; i < inputs; i++)
                seen[table_source(t, o, i)]++;
        for (size_t i = 0; i < table_count(t); i++)
            assert_int_equal(seen[i], 1);
    }
    const int *s = specs[1].shape;
    for (int ky = 0; ky < s[2]; ky++)
        for (int kx = 0; kx < s[3]; kx++)
            for (int c = 0; c < s[1]; c++)
                assert_int_equal(table_source(&specs[1], 4, (ky * s[3] + kx) * s[1] + c),
                                 ((4 * s[1] + c) * s[2] + ky) * s[3] + kx);
    assert_int_equal(table_product(&specs[1]).segs, s[2]);
    s = specs[2].shape;
    for (int a = 0; a < s[2]; a++)
        for (int b = 0; b < s[3]; b++)
            for (int o = 0; o < s[1]; o++)
                assert_int_equal(table_source(&specs[2], (a * s[3] + b) * s[1] + o, 1),
                                 ((1 * s[1] + o) * s[2] + a) * s[3] + b);
}

#define WRONG(member, value, sentence)                                                             \
    do {                                                                                           \
        struct net_dims d = tiny_net;                                                              \
        d.member = value;                                                                          \
        assert_int_equal(table_check(&d), ERR_FORMAT);                                             \
        assert_non_null(strstr(err_text(), sentence));                                             \
    } while (0)

static void dimensions_are_checked(void **state)
{
    (void)state;
    assert_int_equal(table_check(&tiny_net), OK);
    WRONG(embed, 0, "embed is 0");
    WRONG(embed, 24, "embed is 24, allowed are multiples of 16 up to 4096");
    WRONG(embed, 1 << 30, "embed is 1073741824");
    WRONG(heads, 4, "heads is 4: heads of 8");
    WRONG(heads, 0, "heads is 0");
    WRONG(dino_heads, 3, "dino_heads is 3");
    WRONG(cam_heads, -1, "cam_heads is -1");
    WRONG(embed, 256, "heads is 1: heads of 256");
    WRONG(dino_depth, 65, "dino_depth is 65");
    WRONG(depth, 5, "the last is 3, it must be depth - 1 = 4");
    WRONG(depth, 3, "entry 3 is 3");
    WRONG(keep[1], 0, "entry 1 is 0");
    WRONG(keep[0], -1, "entry 0 is -1");
    WRONG(qk_layer, 4, "qk_layer is 4, allowed are 0..3");
    WRONG(cam_depth, 0, "cam_depth is 0");
    WRONG(depth_feat, 12, "depth_feat is 12");
    WRONG(depth_oc[2], 6, "depth_oc is 6");
    WRONG(gs_oc[3], 0, "gs_oc is 0");
    WRONG(gs_feat, 16, "hdr is 4, must be gs_feat / 2 = 8");
    WRONG(gauss, false, "appearance is true without gauss");
    WRONG(size, 60, "size is 60");
    WRONG(voxel, 0, "voxel is 0");
    WRONG(voxel, NAN, "voxel is nan");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_tensor_of_the_release_is_there_in_order),
        cmocka_unit_test(roles_follow_from_names_and_shapes),
        cmocka_unit_test(older_networks_are_parts_of_it),
        cmocka_unit_test(a_completion_branch_comes_last),
        cmocka_unit_test(sources_are_a_permutation),
        cmocka_unit_test(dimensions_are_checked),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
