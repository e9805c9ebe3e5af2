#include "drivers/format/physcam.h"

#include "core/base/num.h"
#include "drivers/format/pixels.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define FILM_DIAGONAL 43.2666 // mm, of 36 x 24: CIPA DC-008 4.6.5, FocalLengthIn35mmFilm
#define STRIP 1.55            // aspect from which a photograph is less than its sensor
#define AGREES 1.25           // ratio of two focal lengths of which one may be rounded, cropped

/* Orientations that mirror have no quarter turn; such photographs share no lens with others. */
static int quarter_turns(int orientation)
{
    static const int turns[9] = {0, 0, 0, 2, 0, 0, 1, 0, 3};
    return turns[orientation];
}

static bool is_mirrored(int orientation)
{
    return orientation == 2 || orientation == 4 || orientation == 5 || orientation == 7;
}

/* Px of the photograph as taken. The equivalent focal length is that of the whole sensor, which has
 * 4:3 or 3:2: a wider photograph is a strip of it, most often of 4:3. Resolution is exact where it
 * is right: where the other does not contradict. */
static double expected_focal(const struct img_camera *camera, int longer, int shorter)
{
    const bool strip = longer > STRIP * shorter;
    const double diagonal = hypot(longer, strip ? 0.75 * longer : shorter);
    const double film = camera->focal_35mm > 0 && camera->focal_35mm < 10000
                            ? camera->focal_35mm / FILM_DIAGONAL * diagonal
                            : 0;
    const double plane = camera->focal_plane * longer;
    const bool agree = plane < AGREES * film && film < AGREES * plane;
    return plane > 0 && (agree || !(film > 0)) ? plane : film;
}

err_t physcam_read(const char *path, enum physcam_rule rule, struct shot *s)
{
    const int longer = num_max(s->taken_w, s->taken_h), shorter = num_min(s->taken_w, s->taken_h);
    struct img_camera camera;
    err_t e = pixels_camera(path, &camera);
    if (e)
        return e;
    s->turned = quarter_turns(camera.orientation);
    s->focal_px = expected_focal(&camera, longer, shorter);
    /* without EXIF a portrait may be a crop, which has another lens than a landscape */
    const bool turns = camera.name[0] && rule == PHYSCAM_EXIF;
    if (rule == PHYSCAM_EACH)
        snprintf(s->camera_id, NAME_CAP, "%s", s->name);
    else
        snprintf(s->camera_id, NAME_CAP, "%dx%d%s %.90s", turns ? longer : s->taken_w,
                 turns ? shorter : s->taken_h, is_mirrored(camera.orientation) ? " mirrored" : "",
                 turns ? camera.name : "");
    return OK;
}
