/* Sheets of cells in worlds: where they stand, what their texture is, requests that cannot be. */
#include "sim/world/target.h"

#include "core/base/rotation.h"
#include "sim/world/vec.h"

#include "tests/unit/expect.h"

#include <math.h>
#include <string.h>

static const unsigned char black[6] = {1, 0, 1, 0, 1, 0};
static const struct texture_cells cells = {3, 2, black, 0.1f};

static void texture(void **state)
{
    static const float n[3] = {0, 0, 1};
    const struct texture t = {.cells = &cells, .colour = {{0.9f, 0.9f, 0.9f}, {0.1f, 0.1f, 0.1f}}};
    float out[3];
    (void)state;
    for (int i = 0; i < 6; i++) {
        const float p[3] = {0.1f * (float)(i % 3) - 0.1f, 0.1f * (float)(i / 3) - 0.05f, 0};
        texture_eval(&t, p, n, 0.01f, out);
        assert_true(fabsf(out[0] - (black[i] ? 0.1f : 0.9f)) < 1e-5f);
    }
    const float border[3] = {-0.05f, -0.06f, 0}, outside[3] = {0.4f, 0, 0}, far[3] = {NAN, 1e9f, 0};
    texture_eval(&t, border, n, 0.02f, out); // half of a black and a white cell
    assert_true(fabsf(out[1] - 0.5f) < 1e-4f);
    texture_eval(&t, outside, n, 0.02f, out);
    assert_true(out[2] == 0.9f);
    texture_eval(&t, far, n, 1e9f, out);
    assert_true(isfinite(out[0]));
}

static void pose(void **state)
{
    static struct world_solid solids[WORLD_SOLIDS];
    static struct world_material materials[WORLD_MATERIALS];
    struct camera cams[2] = {{.q = {1, 0, 0, 0}}, {.q = {1, 0, 0, 0}, .t = {-0.2f, 0, 0}}};
    (void)state;
    for (uint64_t seed = 0; seed < 50; seed++) {
        struct world w = {.solids = solids, .materials = materials};
        const struct target t = {cells, seed, 0, 1, 2};
        assert_int_equal(target_add(&w, &t, cams, 2), OK);
        assert_int_equal(w.n_solids, 1);
        assert_int_equal(w.n_materials, 1);
        const struct world_solid *s = &w.solids[0];
        double r[9];
        for (int k = 0; k < 9; k++)
            r[k] = (double)s->r[k];
        assert_true(rotation_is(r, 1e-5));
        assert_true(s->t[2] >= 2 * 0.84f && s->t[2] <= 2 * 1.16f && fabsf(s->t[0] - 0.1f) < 0.5f);
        assert_true(r[8] > 0.8 && r[8] < 0.996 && r[0] > 0.6); // tilted and rolled, but readable
        assert_true(s->size[0] == 0.5f * 3 * 0.1f && w.materials[0].albedo.cells == &t.cells);
    }
    struct world w = {.solids = solids, .materials = materials};
    assert_int_equal(target_add(&w, &(struct target){cells, 0, 1, 2, 2}, cams, 2), ERR_ARG);
    assert_int_equal(target_add(&w, &(struct target){cells, 0, 1, 0, 2}, cams, 2), ERR_ARG);
    w.n_solids = WORLD_SOLIDS;
    assert_int_equal(target_add(&w, &(struct target){cells, 0, 0, 1, 2}, cams, 2), ERR_LIMIT);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(texture), cmocka_unit_test(pose)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
