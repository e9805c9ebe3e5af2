#include "firmware/recon/testview.h"

#include "drivers/format/img.h"

struct one {
    const struct imageset *set;
    int i;
    bool lensed;
};

static err_t decode_one(void *ctx, int i, struct image8 *out)
{
    const struct one *from = ctx;
    (void)i;
    return from->lensed ? imageset_decode_taken(from->set, from->i, out)
                        : imageset_decode(from->set, from->i, out);
}

static err_t decode_its_mask(void *ctx, int i, struct image8 *out)
{
    const struct one *from = ctx;
    (void)i;
    return imageset_decode_mask(from->set, from->i, from->lensed, out);
}

err_t testview_read(const struct run *r, const struct imageset *set, int i, bool lensed,
                    struct prep_size size, struct views *out)
{
    struct shot s = set->capture.shots[i];
    const struct capture one = {1, &s};
    struct one ctx = {set, i, lensed};
    const struct prep_source source = {
        .decode = decode_one, .release = img_free, .ctx = &ctx, .decode_mask = decode_its_mask};
    s.has_camera = s.has_camera && !lensed;
    if (lensed) {
        s.image.w = s.taken_w;
        s.image.h = s.taken_h;
    }
    return prep_read(r, &one, &source, size, out);
}

void testview_plan(struct plan *p, const struct capture *c, size_t most, int edge)
{
    uint8_t *masked;
    if (arena_alloc(&p->keep, most, 1, &masked))
        plan_refuse(p);
    prep_plan(p, 1, most, prep_largest(c), edge);
}
