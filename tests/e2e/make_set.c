/* make_set OUT SIZE TRAIN TEST [one] - a small data set in the released layout, exact geometry:
 * a room with textures on everything, a lamp, the sun through a window, soft light of the sky and
 * deep shadows. Radiance spans more than four orders of magnitude.
 * World axes are those of the middle camera: x right, y down, z forward; the room is 4 x 2.8 x 6
 * units. Photographs: filmic response (a fit of ACES by K. Narkowicz), shot and read noise, 8 bits.
 * Train views get the 1st, 3rd and 5th exposure, or with `one` one of them in turn; test views get
 * all five and their radiance. The same arguments give the same bytes. */
#include "drivers/format/exrfile.h"
#include "drivers/format/file.h"
#include "drivers/format/img.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

enum { EXPOSURES = 5, SAMPLES = 3 }; // samples per pixel and axis

static const double TIMES[EXPOSURES] = {0.125, 0.35, 1, 2.8, 8};

/* ---- vectors ---- */

struct vec {
    double x, y, z;
};

static struct vec add(struct vec a, struct vec b)
{
    return (struct vec){a.x + b.x, a.y + b.y, a.z + b.z};
}

static struct vec scale(struct vec a, double s)
{
    return (struct vec){a.x * s, a.y * s, a.z * s};
}

static struct vec sub(struct vec a, struct vec b)
{
    return add(a, scale(b, -1));
}

static double dot(struct vec a, struct vec b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static struct vec cross(struct vec a, struct vec b)
{
    return (struct vec){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static struct vec unit(struct vec a)
{
    return scale(a, 1 / sqrt(dot(a, a)));
}

/* ---- textures ---- */

static uint32_t hash(int x, int y, int z, uint32_t seed)
{
    uint32_t h = seed;
    h = (h ^ (uint32_t)x) * 0x9e3779b1u;
    h = (h ^ h >> 15 ^ (uint32_t)y) * 0x85ebca77u;
    h = (h ^ h >> 13 ^ (uint32_t)z) * 0xc2b2ae3du;
    return h ^ h >> 16;
}

static double lattice(int x, int y, int z, uint32_t seed)
{
    return hash(x, y, z, seed) / 4294967295.0;
}

/* Trilinear value noise in 0..1. */
static double noise(struct vec p, uint32_t seed)
{
    int x = (int)floor(p.x), y = (int)floor(p.y), z = (int)floor(p.z);
    double fx = p.x - x, fy = p.y - y, fz = p.z - z, sum = 0;
    for (int k = 0; k < 8; k++) {
        double wx = k & 1 ? fx : 1 - fx, wy = k & 2 ? fy : 1 - fy, wz = k & 4 ? fz : 1 - fz;
        sum += wx * wy * wz * lattice(x + (k & 1), y + (k >> 1 & 1), z + (k >> 2), seed);
    }
    return sum;
}

/* Two octaves: patches that a coarse match finds, grain that a fine one needs. */
static double grain(struct vec p, uint32_t seed)
{
    return 0.6 * noise(scale(p, 3), seed) + 0.4 * noise(scale(p, 11), seed + 1);
}

/* Planks of width `wide` along one axis: a shade of their own, streaks along them, dark joints.
 * u: across, v: along. */
static double planks(double u, double v, double wide, uint32_t seed)
{
    int plank = (int)floor(u / wide);
    double edge = fabs(u / wide - plank - 0.5), own = lattice(plank, 0, 0, seed);
    double streak = noise((struct vec){u * 40, v * 3 + 20 * own, plank}, seed + 1);
    return edge > 0.47 ? 0.15 : 0.45 + 0.35 * own + 0.3 * streak;
}

/* Bricks of 0.3 x 0.12 in mortar. */
static struct vec bricks(double u, double v, double g)
{
    double row = floor(v / 0.12), x = u / 0.3 + 0.5 * fmod(fabs(row), 2), column = floor(x);
    double shade = 0.5 + 0.5 * lattice((int)column, (int)row, 0, 3);
    if (fabs(x - column - 0.5) > 0.46 || fabs(v / 0.12 - row - 0.5) > 0.42)
        return scale((struct vec){0.5, 0.48, 0.44}, 0.7 + 0.3 * g);
    return scale((struct vec){0.5, 0.21, 0.13}, shade * (0.6 + 0.6 * g));
}

/* ---- the scene ---- */

enum material { LAMP, SKY, SHINY, STRIPED, WALL, FLOOR, CEILING, BACK, FRAME, WOOD, BOOK, PICTURE };

struct sphere {
    struct vec centre;
    double radius;
    enum material material;
};

struct box {
    struct vec low, high;
    enum material material;
};

static const struct sphere SPHERE[] = {{{1.2, -0.85, 2.9}, 0.11, LAMP},
                                       {{-0.2, 1.02, 2.45}, 0.38, SHINY},
                                       {{0.95, 0.27, 3.25}, 0.28, STRIPED},
                                       {{0.62, 1.18, 2.4}, 0.22, STRIPED}};
static const struct box BOX[] = {
    {{0.5, 0.55, 2.85}, {1.45, 1.4, 3.65}, WOOD}, // a chest
    {{-1.9, 0.7, 2.9}, {-0.75, 0.8, 3.6}, WOOD},  // a table and its leg
    {{-1.5, 0.8, 3.1}, {-1.1, 1.4, 3.4}, WOOD},      {{-1.65, 0.28, 3.1}, {-1.53, 0.7, 3.5}, BOOK},
    {{-1.53, 0.34, 3.1}, {-1.43, 0.7, 3.5}, BOOK},   {{-1.43, 0.25, 3.1}, {-1.29, 0.7, 3.5}, BOOK},
    {{-1.29, 0.38, 3.1}, {-1.21, 0.7, 3.5}, BOOK},   {{-1.21, 0.31, 3.1}, {-1.08, 0.7, 3.5}, BOOK},
    {{0.05, -0.8, 3.95}, {0.85, -0.2, 4.0}, PICTURE}};
static const struct box ROOM = {{-2.0, -1.4, -2.0}, {2.0, 1.4, 4.0}, WALL};
static const struct box WINDOW = {{-1.5, -1.05, 4.0}, {-0.4, 0.05, 4.0}, SKY}; // in the back wall

enum { SPHERES = sizeof SPHERE / sizeof SPHERE[0], BOXES = sizeof BOX / sizeof BOX[0] };

/* Radiance of lamp and sky; the sun's irradiance / pi and where it stands; light from all sides. */
static const struct vec LAMP_COLOUR = {330, 270, 190}, SKY_COLOUR = {5, 6.5, 9},
                        SUN_COLOUR = {11, 9.5, 7.5}, SUN = {-0.307, -0.768, 0.562},
                        AMBIENT = {0.012, 0.013, 0.016};

struct hit {
    double t;
    struct vec normal;
    enum material material;
    int index; // index of the box
};

static void hit_sphere(const struct sphere *s, struct vec o, struct vec d, struct hit *h)
{
    struct vec m = sub(o, s->centre);
    double b = dot(m, d), c = dot(m, m) - s->radius * s->radius, disc = b * b - c;
    double t = disc > 0 ? -b - sqrt(disc) : -1;
    if (t < 1e-6 || t >= h->t)
        return;
    *h = (struct hit){t, unit(add(m, scale(d, t))), s->material, 0};
}

/* Slabs; from inside (the room) the far face, from outside the near one. */
static bool hit_box(const struct box *b, bool inside, struct vec o, struct vec d, struct hit *h)
{
    const double low[3] = {b->low.x, b->low.y, b->low.z},
                 high[3] = {b->high.x, b->high.y, b->high.z};
    const double from[3] = {o.x, o.y, o.z}, along[3] = {d.x, d.y, d.z};
    double near = -INFINITY, far = INFINITY, side[3] = {0};
    int near_axis = 0, far_axis = 0;
    for (int k = 0; k < 3; k++) {
        double a = (low[k] - from[k]) / along[k], c = (high[k] - from[k]) / along[k];
        double enter = fmin(a, c), leave = fmax(a, c);
        near_axis = enter > near ? k : near_axis;
        far_axis = leave < far ? k : far_axis;
        near = fmax(near, enter);
        far = fmin(far, leave);
    }
    double t = inside ? far : near;
    int axis = inside ? far_axis : near_axis;
    if (near > far || t < 1e-6 || t >= h->t)
        return false;
    side[axis] = along[axis] > 0 ? -1 : 1;
    *h = (struct hit){t, {side[0], side[1], side[2]}, b->material, 0};
    return true;
}

/* Material of the room's shell at p: floor, ceiling, walls, and the window with its bars. */
static enum material shell(struct vec normal, struct vec p)
{
    if (normal.y != 0)
        return normal.y < 0 ? FLOOR : CEILING;
    if (normal.z >= 0 || p.x < WINDOW.low.x || p.x > WINDOW.high.x || p.y < WINDOW.low.y ||
        p.y > WINDOW.high.y)
        return normal.z < 0 ? BACK : WALL;
    double u = fmod(p.x - WINDOW.low.x, 0.55), v = fmod(p.y - WINDOW.low.y, 0.55);
    return fmin(fmin(u, 0.55 - u), fmin(v, 0.55 - v)) < 0.025 ? FRAME : SKY;
}

static struct hit trace(struct vec o, struct vec d)
{
    struct hit h = {.t = INFINITY};
    hit_box(&ROOM, true, o, d, &h);
    h.material = shell(h.normal, add(o, scale(d, h.t)));
    for (int i = 0; i < BOXES; i++)
        if (hit_box(&BOX[i], false, o, d, &h))
            h.index = i;
    for (int i = 0; i < SPHERES; i++)
        hit_sphere(&SPHERE[i], o, d, &h);
    return h;
}

/* A round rug on wooden planks. */
static struct vec floor_colour(struct vec p, double g)
{
    double ring = hypot(p.x - 0.1, (p.z - 2.9) * 1.2) / 0.85;
    if (ring > 1)
        return scale((struct vec){0.5, 0.3, 0.17}, planks(p.x, p.z, 0.22, 11));
    double petal = sin(8 * ring * 3.14159) * cos(12 * atan2(p.z - 2.9, p.x - 0.1));
    return scale(petal > 0 ? (struct vec){0.62, 0.5, 0.3} : (struct vec){0.3, 0.06, 0.1},
                 0.6 + 0.6 * g);
}

/* Coloured discs on squares, as hung in every waiting room. */
static struct vec picture_colour(struct vec p, double g)
{
    double x = (p.x - 0.05) / 0.2, y = (p.y + 0.8) / 0.2;
    int column = (int)floor(x), row = (int)floor(y);
    double r = hypot(x - column - 0.5, y - row - 0.5);
    int disc = r < 0.18 ? 2 : r < 0.36 ? 1 : 0;
    return (struct vec){0.1 + 0.75 * lattice(column, row, disc, 21) * (0.7 + 0.4 * g),
                        0.1 + 0.7 * lattice(column, row, disc, 22) * (0.7 + 0.4 * g),
                        0.1 + 0.7 * lattice(column, row, disc, 23) * (0.7 + 0.4 * g)};
}

static struct vec albedo(const struct hit *h, struct vec p)
{
    double g = grain(p, (uint32_t)h->material * 7 + 1);
    switch (h->material) {
    case FLOOR:
        return floor_colour(p, g);
    case CEILING:
        return scale((struct vec){0.8, 0.78, 0.72}, 0.7 + 0.3 * g);
    case BACK:
        return bricks(p.x, p.y, g);
    case WALL:
        return fmod(fabs(p.z), 0.24) < 0.12 ? scale((struct vec){0.25, 0.42, 0.4}, 0.6 + 0.5 * g)
                                            : scale((struct vec){0.6, 0.62, 0.5}, 0.6 + 0.5 * g);
    case WOOD:
        return scale((struct vec){0.62, 0.4, 0.2}, planks(p.y + 0.3 * p.z, p.x, 0.17, 13));
    case BOOK: {
        double c = lattice(h->index, 1, 0, 31), band = fabs(p.y - 0.45) < 0.03 ? 1.6 : 1;
        return scale(
            (struct vec){0.15 + 0.4 * c, 0.12 + 0.3 * lattice(h->index, 2, 0, 31), 0.5 - 0.4 * c},
            band * (0.6 + 0.5 * g));
    }
    case PICTURE:
        return h->normal.z != 0 ? picture_colour(p, g) : (struct vec){0.1, 0.07, 0.05};
    case STRIPED:
        return fmod(p.y + 9 + 0.03 * sin(20 * p.x), 0.12) < 0.06
                   ? scale((struct vec){0.12, 0.3, 0.5}, 0.5 + 0.8 * g)
                   : scale((struct vec){0.8, 0.72, 0.55}, 0.6 + 0.4 * g);
    case FRAME:
        return (struct vec){0.6, 0.58, 0.52};
    default:
        return scale((struct vec){0.5, 0.16, 0.12}, 0.7 + 0.5 * g);
    }
}

/* Light falls off towards the edges between the room's walls. */
static double corners(struct vec p)
{
    double dark = 1;
    const double gap[5] = {p.x - ROOM.low.x, ROOM.high.x - p.x, p.y - ROOM.low.y, ROOM.high.y - p.y,
                           ROOM.high.z - p.z};
    for (int k = 0; k < 5; k++)
        dark *= 1 - 0.25 * exp(-fabs(gap[k]) / 0.3);
    return dark;
}

/* Direct light of the lamp, of the sun through the window and of point `s` of the sky behind it,
 * all with shadows; a constant from everywhere else. */
static struct vec irradiance(struct vec p, struct vec n, int s)
{
    struct vec start = add(p, scale(n, 1e-4)), sum = scale(AMBIENT, corners(p));
    struct vec to = sub(SPHERE[0].centre, p), l = unit(to);
    double r = SPHERE[0].radius, cosine = dot(n, l);
    if (cosine > 0 && trace(start, l).material == LAMP)
        sum = add(sum, scale(LAMP_COLOUR, cosine * r * r / dot(to, to)));
    cosine = dot(n, SUN);
    if (cosine > 0 && trace(start, SUN).material == SKY)
        sum = add(sum, scale(SUN_COLOUR, cosine));
    struct vec size = sub(WINDOW.high, WINDOW.low), at = WINDOW.low;
    at.x += size.x * (s % SAMPLES + 0.5) / SAMPLES;
    at.y += size.y * (s / SAMPLES + 0.5) / SAMPLES;
    to = sub(at, p);
    l = unit(to);
    cosine = dot(n, l) * l.z;
    if (dot(n, l) > 0 && trace(start, l).t > sqrt(dot(to, to)) - 1e-3)
        sum = add(sum, scale(SKY_COLOUR, cosine * size.x * size.y / (3.14159 * dot(to, to))));
    return sum;
}

/* s: which of the samples of a pixel. */
static struct vec radiance(struct vec o, struct vec d, int s)
{
    struct hit h = trace(o, d);
    struct vec p = add(o, scale(d, h.t)), to = sub(SPHERE[0].centre, p);
    if (h.material == LAMP)
        return LAMP_COLOUR;
    if (h.material == SKY)
        return scale(SKY_COLOUR, 0.7 + 0.3 * (WINDOW.high.y - p.y) + 0.3 * grain(p, 41));
    struct vec light = irradiance(p, h.normal, s), a = albedo(&h, p);
    struct vec out = {a.x * light.x, a.y * light.y, a.z * light.z};
    if (h.material == SHINY) {
        double gloss = 0.02 * pow(fmax(0, dot(h.normal, unit(sub(unit(to), d)))), 60);
        out = add(out, scale(LAMP_COLOUR, gloss));
    }
    return out;
}

/* ---- cameras ---- */

/* View i of n: a sunflower on an ellipse of 1.3 x 0.7 units, all looking at one point. */
static struct camera place(int i, int n, bool test, int size)
{
    double r = sqrt((i + 0.5) / n) * (test ? 0.75 : 1),
           turn = i * 2.399963229728653 + (test ? 1.3 : 0);
    struct vec eye = {0.65 * r * cos(turn), 0.35 * r * sin(turn), 0.1 * r * cos(2 * turn)};
    struct vec z = unit(sub((struct vec){0, 0.2, 2.8}, eye)),
               x = unit(cross((struct vec){0, 1, 0}, z)), y = cross(z, x);
    double w = 0.5 * sqrt(1 + x.x + y.y + z.z),
           f = 0.85 * size; // the trace is near 3: no other branch is needed
    return (struct camera){.w = size,
                           .h = size,
                           .fx = (float)f,
                           .fy = (float)f,
                           .cx = 0.5f * (float)size,
                           .cy = 0.5f * (float)size,
                           .q = {(float)w, (float)((z.y - y.z) / (4 * w)),
                                 (float)((x.z - z.x) / (4 * w)), (float)((y.x - x.y) / (4 * w))},
                           .t = {(float)-dot(x, eye), (float)-dot(y, eye), (float)-dot(z, eye)}};
}

/* Rows of the rotation of a unit quaternion. */
static void rows(const float q[4], struct vec out[3])
{
    double w = (double)q[0], x = (double)q[1], y = (double)q[2], z = (double)q[3];
    out[0] = (struct vec){1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)};
    out[1] = (struct vec){2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)};
    out[2] = (struct vec){2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)};
}

static void photograph(const struct camera *cam, struct image *out)
{
    struct vec r[3], eye = {0};
    size_t pixels = (size_t)cam->w * (size_t)cam->h;
    rows(cam->q, r);
    for (int k = 0; k < 3; k++)
        eye = sub(eye, scale(r[k], (double)cam->t[k]));
    for (size_t i = 0; i < pixels; i++) {
        struct vec sum = {0};
        for (int s = 0; s < SAMPLES * SAMPLES; s++) {
            double u = (double)(i % (size_t)cam->w) + (s % SAMPLES + 0.5) / SAMPLES;
            double v = (double)(i / (size_t)cam->w) + (s / SAMPLES + 0.5) / SAMPLES;
            double x = (u - (double)cam->cx) / (double)cam->fx,
                   y = (v - (double)cam->cy) / (double)cam->fy;
            struct vec d = unit(add(add(scale(r[0], x), scale(r[1], y)), r[2]));
            sum = add(sum, scale(radiance(eye, d, s), 1.0 / (SAMPLES * SAMPLES)));
        }
        out->px[i] = (float)sum.x;
        out->px[pixels + i] = (float)sum.y;
        out->px[2 * pixels + i] = (float)sum.z;
    }
}

/* Display value of an exposure: ACES filmic and gamma 2.2. */
static double respond(double x)
{
    double y = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14);
    return pow(fmin(fmax(y, 0), 1), 1 / 2.2);
}

static void develop(const struct image *hdr, double time, uint32_t seed, struct image8 *out)
{
    size_t pixels = (size_t)hdr->w * (size_t)hdr->h;
    for (size_t i = 0; i < 3 * pixels; i++) {
        double x = (double)hdr->px[(i % 3) * pixels + i / 3] * time, bell = -3;
        for (int k = 0; k < 6; k++) // six uniform numbers make a bell of variance 1/2
            bell += lattice((int)i, k, 0, seed);
        x += bell * 1.41 * sqrt(4e-4 * x + 1e-6);
        out->px[i] = (uint8_t)(255 * respond(fmax(x, 0)) + 0.5);
    }
}

/* ---- files ---- */

struct set {
    const char *dir;
    int size;
    FILE *exposures, *images;
    struct image hdr;
    struct image8 ldr;
    int n_entries, n_images;
    bool one; // exposure per train view
};

static err_t write_photo(struct set *s, const char *kind, int i, int exposure)
{
    char name[64], path[FILE_PATH_CAP];
    develop(&s->hdr, TIMES[exposure], hash(i, exposure, kind[1], 77), &s->ldr);
    snprintf(name, sizeof name, "images/%s_ldr_%03d_%d.png", kind, i, exposure);
    fprintf(s->exposures, "%s\n \"%s\": %.9g", s->n_entries++ ? "," : "", name + 7,
            TIMES[exposure]);
    err_t e = file_join(s->dir, name, path);
    return e ? e : img_write_png(path, &s->ldr);
}

static err_t write_radiance(const struct set *s, const struct camera *c, int i)
{
    char name[64], path[FILE_PATH_CAP];
    struct exrfile_extra extra = {.half = true, .cam = c};
    snprintf(name, sizeof name, "images_hdr/test_hdr_%03d.exr", i);
    err_t e = file_join(s->dir, name, path);
    return e ? e : exrfile_write(path, &s->hdr, &extra, NULL);
}

/* Exposures of train view i: the middle, the shortest and the longest in turn, or all three. */
static bool is_train_exposure(const struct set *s, int i, int k)
{
    static const int turn[3] = {2, 0, 4};
    return s->one ? k == turn[i % 3] : k % 2 == 0;
}

static err_t write_view(struct set *s, bool test, int i, int n)
{
    const char *kind = test ? "test" : "train";
    struct camera c = place(i, n, test, s->size);
    err_t e = OK;
    int n_photos = 0;
    photograph(&c, &s->hdr);
    for (int k = 0; k < EXPOSURES && !e; k++) {
        if (!test && !is_train_exposure(s, i, k))
            continue;
        if (n_photos++ == 0)
            fprintf(s->images, "%d %.9g %.9g %.9g %.9g %.9g %.9g %.9g 1 %s_ldr_%03d_%d.png\n\n",
                    ++s->n_images, (double)c.q[0], (double)c.q[1], (double)c.q[2], (double)c.q[3],
                    (double)c.t[0], (double)c.t[1], (double)c.t[2], kind, i, k);
        e = write_photo(s, kind, i, k);
    }
    return e || !test ? e : write_radiance(s, &c, i);
}

static err_t open_text(const char *dir, const char *name, char path[FILE_PATH_CAP], FILE **f)
{
    err_t e = file_join(dir, name, path);
    return e ? e : file_create(path, f);
}

static err_t write_views(struct set *s, int train, int test)
{
    char exposures[FILE_PATH_CAP], images[FILE_PATH_CAP];
    err_t e = open_text(s->dir, "exposure.json", exposures, &s->exposures);
    if (!e)
        e = open_text(s->dir, "sparse/0/images.txt", images, &s->images);
    if (e)
        return e;
    putc('{', s->exposures);
    for (int i = 0; i < train + test && !e; i++)
        e = i < train ? write_view(s, false, i, train) : write_view(s, true, i - train, test);
    fputs("\n}\n", s->exposures);
    if (!e)
        e = file_finish(s->images, images);
    return e ? e : file_finish(s->exposures, exposures);
}

static err_t write_camera(const struct set *s)
{
    char path[FILE_PATH_CAP];
    FILE *f;
    struct camera c = place(0, 1, false, s->size);
    err_t e = open_text(s->dir, "sparse/0/cameras.txt", path, &f);
    if (e)
        return e;
    fprintf(f, "1 PINHOLE %d %d %.9g %.9g %.9g %.9g\n", c.w, c.h, (double)c.fx, (double)c.fy,
            (double)c.cx, (double)c.cy);
    return file_finish(f, path);
}

static err_t make_folders(const char *dir)
{
    static const char *const names[] = {"", "images", "images_hdr", "sparse", "sparse/0"};
    char path[FILE_PATH_CAP];
    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        err_t e = file_join(dir, names[i], path);
        if (e)
            return e;
        if (mkdir(path, 0777) != 0 && errno != EEXIST)
            return err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    }
    return OK;
}

int main(int argc, char **argv)
{
    int number[3] = {0};
    bool one = argc == 6 && strcmp(argv[5], "one") == 0;
    for (int k = 0; k < 3 && (argc == 5 || one); k++)
        number[k] = atoi(argv[2 + k]);
    if (number[0] < 16 || number[0] > 2048 || number[1] < 1 || number[1] > 999 || number[2] < 0 ||
        number[2] > 999) {
        fprintf(stderr, "usage: make_set OUT SIZE TRAIN TEST [one]\n");
        return 2;
    }
    struct set s = {.dir = argv[1], .size = number[0], .one = one};
    size_t values = 3 * (size_t)s.size * (size_t)s.size;
    s.hdr = (struct image){s.size, s.size, 3, malloc(values * sizeof(float))};
    s.ldr = (struct image8){s.size, s.size, 3, malloc(values)};
    err_t e =
        s.hdr.px && s.ldr.px ? make_folders(s.dir) : err_fail(ERR_NOMEM, "no memory for a picture");
    if (!e)
        e = write_camera(&s);
    if (!e)
        e = write_views(&s, number[1], number[2]);
    if (e)
        fprintf(stderr, "make_set: %s\n", err_text());
    free(s.hdr.px);
    free(s.ldr.px);
    return e ? 1 : 0;
}
