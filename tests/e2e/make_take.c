/* make_take STORE CAMERAS EXPOSURES WIDTH HEIGHT - stores a take of frames of a mosaic, and prints
 * its id and the seconds that it took. Frames are detailed and noisy, so that their pictures are as
 * large as photographs'. */
#include "firmware/store/store.h"

#include "drivers/device/clocks.h"
#include "tests/unit/small_take.h"

static uint32_t noise(uint32_t *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return *seed >> 24;
}

static void expose(struct take_frame *f, const struct camera_info *info)
{
    const int top = (1 << SMALL_BITS) - 1;
    uint32_t seed = (uint32_t)(f->camera * 16 + f->index + 1);
    f->bytes = 2 * (size_t)info->w * (size_t)info->h;
    f->data = malloc(f->bytes);
    for (int i = 0; f->data && i < info->w * info->h; i++) {
        const double x = (double)(i % info->w) / info->w, y = (double)(i / info->w) / info->h;
        const double light = small_radiance(i % info->w, info->w) *
                             (1.2 + sin(40 * x + f->camera) * sin(60 * y) + (i / 7 % 13) / 26.0);
        const double v = SMALL_BLACK + light * small_exposure_s(f->index) * (top - SMALL_BLACK);
        const long code = lrint(fmin(v + noise(&seed) / 24.0, top));
        f->data[2 * i] = (uint8_t)(code & 255);
        f->data[2 * i + 1] = (uint8_t)(code >> 8);
    }
}

static err_t make(char **argv, const int number[4])
{
    const struct store_config cfg = {.path = argv[1]};
    char id[STORE_ID_CAP];
    struct store *s;
    err_t e = store_open(&cfg, &s);
    if (e)
        return e;
    struct take *t = small_take(number[0], number[1], CAMERA_RGGB16);
    for (int i = 0; t && i < t->n; i++) {
        struct camera_info *info = &t->camera[t->frame[i].camera].info;
        info->w = number[2];
        info->h = number[3];
        info->stride = 2 * info->w;
        free(t->frame[i].data);
        expose(&t->frame[i], info);
    }
    const int64_t begin = clocks_now();
    e = t ? store_commit(s, t, id) : err_fail(ERR_NOMEM, "no memory for the take");
    if (!e)
        printf("%s %.3f\n", id, (double)(clocks_now() - begin) * 1e-9);
    take_free(t);
    store_close(s);
    return e;
}

int main(int argc, char **argv)
{
    int number[4];
    for (int i = 0; i < 4; i++)
        number[i] = argc == 6 ? atoi(argv[i + 2]) : 0;
    const bool ok = number[0] > 0 && number[1] > 0 && number[2] > 0 && number[3] > 0;
    err_t e = ok ? make(argv, number)
                 : err_fail(ERR_ARG, "usage: make_take STORE CAMERAS EXPOSURES WIDTH HEIGHT");
    if (e)
        fprintf(stderr, "%s\n", err_text());
    return e != OK;
}
