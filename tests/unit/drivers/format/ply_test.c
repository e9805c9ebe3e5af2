#include "drivers/format/ply.h"

#include "core/base/bytes.h"
#include "core/base/half.h"
#include "core/kernels/kernels.h"
#include "core/photo/metrics.h"
#include "core/photo/tonemap.h"
#include "core/splat/display.h"
#include "drivers/format/file.h"
#include "firmware/result/draw.h"

#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#define C0 0.28209479177387814

enum { SIZE = 112, SPLATS = 2000 };

static struct arena arena;
static unsigned seed;

static float uniform(float lo, float hi)
{
    seed = seed * 1664525u + 1013904223u;
    return lo + (hi - lo) * (float)(seed >> 8) * 0x1p-24f;
}

/* n splats with values that need all their bits; SH values are halves already. */
static struct scene make(int n, int degree)
{
    struct scene s = {.size = 1, .background = {0.25f, 0, 1e5f}};
    seed = 7;
    arena_free(&arena);
    assert_int_equal(arena_init(&arena, "test", 8 << 20), OK);
    assert_int_equal(gaussians_init(&s.g, &arena, n, degree), OK);
    s.g.n = n;
    for (int p = 0; p < gaussians_planes(degree); p++)
        for (int i = 0; i < n; i++) {
            float v = uniform(-2, 2);
            s.g.plane[p][i] = p < G_SH ? v : half_to_float(half_from_float(v));
        }
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 4; k++)
            s.g.plane[G_QUAT + k][i] = k == i % 4 ? -1 : 0; // unit length, exact in floats
    tonemap_linear(&s.tone, 0.5f, -20, 10, 1.5f);
    return s;
}

static struct gaussians read_back(const char *path, float ev)
{
    struct gaussians g;
    struct gaussians_report report;
    assert_int_equal(splats_read(&ply_format, path, ev, &arena, &g, &report), OK);
    assert_int_equal(report.dropped, 0);
    return g;
}

static void what_is_written_is_read_bit_for_bit(void **state)
{
    (void)state;
    for (int degree = 0; degree <= SH_DEGREE_MAX; degree++) {
        struct scene in = make(21, degree);
        struct splats_info info;
        const char *path = tmpdir_path("scene.ply");
        assert_int_equal(ply_write(path, &in), OK);
        assert_int_equal(splats_peek(&ply_format, path, &info), OK);
        assert_true(info.n == 21 && info.degree == degree && info.has_hdr);
        assert_true(info.ev == display_ev(&in.tone));
        struct gaussians out = read_back(path, 0);
        assert_true(out.n == 21 && out.degree == degree);
        for (int p = 0; p < gaussians_planes(degree); p++)
            assert_memory_equal(out.plane[p], in.g.plane[p], 21 * sizeof(float));
    }
}

static void few_splats_and_none(void **state)
{
    (void)state;
    for (int n = 0; n < 2; n++) {
        struct scene in = make(n, 1);
        const char *path = tmpdir_path("few.ply");
        assert_int_equal(ply_write(path, &in), OK);
        assert_int_equal(read_back(path, 0).n, n);
    }
}

static float f32_at(const struct file_map *m, size_t at)
{
    float v;
    assert_true(at + 4 <= m->n);
    memcpy(&v, m->p + at, 4);
    return v;
}

static size_t header_bytes(const struct file_map *m)
{
    const uint8_t *end = memmem(m->p, m->n, "end_header\n", 11);
    assert_non_null(end);
    return (size_t)(end - m->p) + 11;
}

static void ordinary_viewers_see_display_colours(void **state)
{
    (void)state;
    for (int degree = 0; degree <= SH_DEGREE_MAX; degree++) {
        int shown = degree < 3 ? degree : 3, rest = (shown + 1) * (shown + 1) - 1;
        size_t coefs = (size_t)((degree + 1) * (degree + 1));
        struct scene s = make(1, degree);
        struct file_map m;
        float log_sh[3 * SH_COEFS_MAX], f[48];
        s.g.plane[G_LOG_SCALE][0] = -1e9f;
        for (int k = 0; k < 4; k++)
            s.g.plane[G_QUAT + k][0] = 3;
        for (size_t j = 0; j < 3 * coefs; j++)
            log_sh[j] = s.g.plane[G_SH + j][0];
        display_from_radiance(log_sh, degree, display_ev(&s.tone), f);
        assert_int_equal(ply_write(tmpdir_path("one.ply"), &s), OK);
        assert_int_equal(file_map(tmpdir_path("one.ply"), 1 << 20, &m), OK);
        size_t row = header_bytes(&m), after = row + 36 + 12 * (size_t)rest;
        assert_true(row < 10000); // some viewers read no more
        assert_int_equal(m.n - row, 17 * 4 + 12 * (size_t)rest + 6 * coefs);
        for (int c = 0; c < 3; c++) {
            assert_true(f32_at(&m, row + 24 + 4 * (size_t)c) == f[c]);
            for (int k = 1; k <= rest; k++)
                assert_true(f32_at(&m, row + 36 + 4 * (size_t)(c * rest + k - 1)) == f[3 * k + c]);
        }
        assert_true(f32_at(&m, after) == s.g.plane[G_LOGIT][0]);
        assert_true(f32_at(&m, after + 4) == GAUSSIANS_LOG_SCALE_MIN);
        assert_true(f32_at(&m, after + 16) == 0.5f); // quaternion of unit length
        file_unmap(&m);
    }
}

static void bad_splats_are_not_written(void **state)
{
    (void)state;
    struct scene s = make(3, 0);
    s.g.plane[G_SH + 1][2] = NAN;
    assert_int_equal(ply_write(tmpdir_path("bad.ply"), &s), ERR_ARG);
    assert_non_null(strstr(err_text(), "splat 2 of 3: plane 12"));
    assert_false(file_is_regular(tmpdir_path("bad.ply")));
    s = make(3, 0);
    for (int k = 0; k < 4; k++)
        s.g.plane[G_QUAT + k][1] = 0;
    assert_int_equal(ply_write(tmpdir_path("bad.ply"), &s), ERR_ARG);
    s = make(3, 0);
    assert_int_equal(ply_write("/dev/full", &s), ERR_LIMIT);
}

/* The same file for a reader that does not know our properties. */
static const char *without_radiance(const char *path)
{
    struct file_map m;
    assert_int_equal(file_map(path, 1 << 24, &m), OK);
    char *copy = malloc(m.n), *at;
    memcpy(copy, m.p, m.n);
    while ((at = memmem(copy, m.n, "ihdr_log_", 9)))
        memcpy(at, "else", 4);
    const char *out = tmpdir_write("colours.ply", copy, m.n);
    free(copy);
    file_unmap(&m);
    return out;
}

/* Radiance of 1e-4 to 1e5, a huge and a tiny splat. */
static void extremes_come_back(void **state)
{
    (void)state;
    struct scene in = make(SPLATS, 0);
    struct splats_info info;
    for (int i = 0; i < SPLATS; i++)
        for (int c = 0; c < 3; c++)
            in.g.plane[G_SH + c][i] = (float)(log(1e-4 * pow(1e9, i / (SPLATS - 1.0))) / C0);
    in.g.plane[G_LOG_SCALE][0] = GAUSSIANS_LOG_SCALE_MIN;
    in.g.plane[G_LOG_SCALE][1] = GAUSSIANS_LOG_SCALE_MAX;
    in.g.plane[G_MU][2] = 1e30f;
    const char *path = tmpdir_path("extreme.ply");
    assert_int_equal(ply_write(path, &in), OK);
    struct gaussians half = read_back(path, 0);
    const char *colours = without_radiance(path);
    assert_int_equal(splats_peek(&ply_format, colours, &info), OK);
    assert_true(!info.has_hdr && info.degree == 0);
    struct gaussians full = read_back(colours, info.ev);
    for (int i = 0; i < SPLATS; i++) {
        double want = C0 * in.g.plane[G_SH + 1][i];
        assert_true(fabs(C0 * half.plane[G_SH + 1][i] - want) < 4.5e-3); // 11 bits of 33 to 64
        assert_true(fabs(C0 * full.plane[G_SH + 1][i] - want) < fmax(3e-8 * exp(-want), 3e-6));
    }
    for (int i = 0; i < 3; i++)
        assert_true(half.plane[G_MU][i] == in.g.plane[G_MU][i] &&
                    half.plane[G_LOG_SCALE][i] == in.g.plane[G_LOG_SCALE][i]);
}

/* ---- pictures ---- */

static struct scene make_room(int degree)
{
    struct scene s = make(SPLATS, degree);
    for (int i = 0; i < SPLATS; i++) {
        float dark = logf(i % 10 ? 0.02f : 1e-4f), bright = logf(i % 10 ? 8.0f : 1e5f);
        s.g.plane[G_MU + 2][i] = uniform(2, 6);
        for (int k = 0; k < 3; k++)
            s.g.plane[G_LOG_SCALE + k][i] = uniform(-4, -2);
        for (int k = 0; k < 4; k++)
            s.g.plane[G_QUAT + k][i] = uniform(-1, 1);
        for (int c = 0; c < 3; c++)
            s.g.plane[G_SH + c][i] = uniform(dark, bright) / (float)C0;
        for (int p = G_SH + 3; p < gaussians_planes(degree); p++)
            s.g.plane[p][i] = uniform(-0.3f, 0.3f);
    }
    s.background[2] = 0;
    return s;
}

/* Display values at the middle exposure, and the radiance before them. */
static void draw(const struct scene *s, struct image *display, struct image *radiance)
{
    static const struct camera cam = {SIZE,      SIZE,      SIZE,         SIZE,
                                      SIZE / 2., SIZE / 2., {1, 0, 0, 0}, {0, 0, 0}};
    struct kernels kernels;
    struct draw d;
    struct arena tmp;
    atomic_bool cancel = false;
    kernels_init(&kernels, 0);
    assert_int_equal(arena_init(&tmp, "tmp", draw_plan(s->g.cap, SIZE, SIZE)), OK);
    struct run r = {.k = &kernels, .tmp = &tmp, .cancel = &cancel};
    assert_int_equal(draw_init(&d, &tmp, s->g.cap, SIZE, SIZE), OK);
    assert_int_equal(draw_run(&r, &d, s, &cam), OK);
    draw_display(&d, NULL, s->tone.mid_log2t);
    for (int i = 0; i < 3 * SIZE * SIZE; i++) {
        display->px[i] = d.display.px[i];
        radiance->px[i] = d.maps.radiance[i];
    }
    arena_free(&tmp);
}

static float pixels[4][3 * SIZE * SIZE];
static struct image picture[4] = {{SIZE, SIZE, 3, pixels[0]},
                                  {SIZE, SIZE, 3, pixels[1]},
                                  {SIZE, SIZE, 3, pixels[2]},
                                  {SIZE, SIZE, 3, pixels[3]}};

static double psnr(const struct image *a, const struct image *b)
{
    double sum = 0;
    for (int i = 0; i < 3 * SIZE * SIZE; i++)
        sum += ((double)a->px[i] - b->px[i]) * ((double)a->px[i] - b->px[i]);
    return -10 * log10(sum / (3 * SIZE * SIZE));
}

static void pictures_of_the_file_are_those_of_the_scene(void **state)
{
    (void)state;
    for (int degree = 0; degree <= SH_DEGREE_MAX; degree += 2) {
        struct scene s = make_room(degree);
        const char *path = tmpdir_path("room.ply");
        draw(&s, &picture[0], &picture[1]);
        assert_int_equal(ply_write(path, &s), OK);
        s.g = read_back(path, 0);
        draw(&s, &picture[2], &picture[3]);
        double db = psnr(&picture[0], &picture[2]), worst = 0;
        for (int i = 0; i < 3 * SIZE * SIZE; i++)
            worst = fmax(worst, fabs(pixels[3][i] / (double)pixels[1][i] - 1));
        print_message("SH degree %d: %.1f dB, radiance within %.2f %%\n", degree, db, 100 * worst);
        assert_true(db >= 70);
        assert_true(worst < 0.005);
    }
}

/* ---- files of other programs ---- */

/* Headers and rows as other programs write them; row: what stands in a row, one letter a float:
 * Position, Normal (0), f_Dc, f_Rest, Opacity, Scale, Quaternion, B a byte, T a double. */
struct foreign {
    const char *head, *row;
    int degree;
};

struct writer {
    char header[8192];
    uint8_t row[1024];
    size_t header_bytes, row_bytes;
};

static float value_of(char kind, int k)
{
    static const float dc[3] = {0, (float)(0.5 / C0), -9}; // display 0.5, 1, below black
    switch (kind) {
    case 'P':
        return (float)(k + 1);
    case 'D':
        return dc[k];
    case 'R':
        return (float)(k + 1) / 1000;
    case 'O':
        return 0.5f;
    case 'S':
        return (float)(-1 - k);
    case 'Q':
        return k == 0;
    default:
        return 0;
    }
}

static void put_property(struct writer *w, const char *type, const char *name)
{
    w->header_bytes += (size_t)sprintf(w->header + w->header_bytes, "property %s %s\n", type, name);
}

static void put_numbers(struct writer *w, char kind, const char *prefix, int n)
{
    static const char *const axes[] = {"x", "y", "z", "nx", "ny", "nz"};
    for (int k = 0; k < n; k++) {
        char name[32];
        float v = value_of(kind, k);
        snprintf(name, sizeof name, "%s%d", prefix, k);
        const char *axis = kind == 'P' ? axes[k] : kind == 'N' ? axes[3 + k] : name;
        put_property(w, k % 2 ? "float32" : "float", kind == 'O' ? "opacity" : axis);
        memcpy(w->row + w->row_bytes, &v, 4);
        w->row_bytes += 4;
    }
}

static size_t make_foreign(const struct foreign *f, char *out)
{
    struct writer w = {0};
    int rest = 3 * (f->degree + 1) * (f->degree + 1) - 3;
    for (const char *c = f->row; *c; c++)
        switch (*c) {
        case 'P':
            put_numbers(&w, *c, "", 3);
            break;
        case 'N':
            put_numbers(&w, *c, "", 3);
            break;
        case 'D':
            put_numbers(&w, *c, "f_dc_", 3);
            break;
        case 'R':
            put_numbers(&w, *c, "f_rest_", rest);
            break;
        case 'O':
            put_numbers(&w, *c, "", 1);
            break;
        case 'S':
            put_numbers(&w, *c, "scale_", 3);
            break;
        case 'Q':
            put_numbers(&w, *c, "rot_", 4);
            break;
        case 'B':
            put_property(&w, "uchar", "label");
            w.row[w.row_bytes++] = 9;
            break;
        default:
            put_property(&w, "double", "time");
            w.row_bytes += 8;
        }
    char *p = out + sprintf(out, "%s%.*send_header\n", f->head, (int)w.header_bytes, w.header);
    memcpy(p, w.row, w.row_bytes);
    return (size_t)(p - out) + w.row_bytes;
}

#define HEAD "ply\nformat binary_little_endian 1.0\n"
#define ASCII "ply\nformat ascii 1.0\n"

static void foreign_files_are_taken_as_srgb(void **state)
{
    (void)state;
    static const struct foreign files[] = {
        {HEAD "element vertex 1\n", "PNDROSQ", 3}, // Inria
        {HEAD "comment Exported from Brush\ncomment Vertical axis: y\n"
              "comment SplatRenderMode: default\nelement vertex 1\n",
         "PSORQD", 4},
        {HEAD "comment generated by SuperSplat\nelement vertex 1\n", "PQSDOR", 2},
        {"ply\r\nformat binary_little_endian 1.0\r\ncomment ihdr is no number\r\n"
         "element vertex 1\r\n",
         "TQOBSDRP", 1},
        {HEAD "element vertex 1\n", "PDOSQ", 0},
    };
    for (size_t i = 0; i < sizeof files / sizeof files[0]; i++) {
        char file[8192];
        int degree = files[i].degree, coefs = (degree + 1) * (degree + 1);
        struct gaussians g;
        struct gaussians_report report;
        struct splats_bytes b = {"f", file, make_foreign(&files[i], file)};
        float sh[3 * SH_COEFS_MAX], want[3 * SH_COEFS_MAX];
        for (int c = 0; c < 3; c++) {
            sh[c] = value_of('D', c);
            for (int k = 1; k < coefs; k++)
                sh[3 * k + c] = value_of('R', c * (coefs - 1) + k - 1);
        }
        make(1, 0);
        display_to_radiance(sh, degree, 2, want);
        assert_int_equal(ply_format.parse(&b, 2, &arena, &g, &report), OK);
        assert_true(g.n == 1 && g.degree == degree);
        assert_true(g.plane[G_MU][0] == 1 && g.plane[G_MU + 2][0] == 3);
        assert_true(g.plane[G_LOG_SCALE + 2][0] == -3 && g.plane[G_LOGIT][0] == 0.5f);
        assert_true(g.plane[G_QUAT][0] == 1 && g.plane[G_QUAT + 1][0] == 0);
        for (int j = 0; j < 3 * coefs; j++)
            assert_true(g.plane[G_SH + j][0] == want[j]);
    }
}

/* ---- text, and the other byte order ---- */

/* The binary file `m` of floats, then ushorts, as another kind. */
static size_t transcode(const struct file_map *m, const char *kind, int n_floats, char *out)
{
    static const char was[] = "binary_little_endian";
    const char *text = (const char *)m->p;
    const size_t head = header_bytes(m), at = (size_t)((char *)memmem(text, head, was, 20) - text);
    char *p = out + sprintf(out, "%.*s%s%.*s", (int)at, text, kind, (int)(head - at - 20),
                            text + at + 20);
    struct bytes b = bytes_of(m->p + head, m->n - head);
    const size_t row = (size_t)atoi(strstr(text, "element vertex ") + 15);
    const size_t each = b.left / row;
    while (b.left > 0) {
        const bool is_float = (b.left - 1) % each >= each - 4 * (size_t)n_floats;
        uint8_t big[4];
        const size_t bytes = is_float ? 4 : 2;
        for (size_t k = 0; k < bytes; k++)
            big[k] = b.p[bytes - 1 - k];
        if (kind[0] == 'a' && is_float)
            p += sprintf(p, "%.9g ", (double)bytes_f32(&b));
        else if (kind[0] == 'a')
            p += sprintf(p, "%u%c", bytes_u16(&b), b.left % each ? '\t' : '\n');
        else
            p = (char *)memcpy(p, big, bytes) + (bytes_take(&b, bytes) ? bytes : 0);
    }
    return (size_t)(p - out);
}

static void other_encodings_are_the_same_file(void **state)
{
    (void)state;
    static const char *const kinds[] = {"ascii", "binary_big_endian"};
    for (int degree = 0; degree <= SH_DEGREE_MAX; degree++) {
        struct scene in = make(21, degree);
        struct file_map m;
        const int shown = degree < 3 ? degree : 3;
        const char *path = tmpdir_path("little.ply");
        assert_int_equal(ply_write(path, &in), OK);
        assert_int_equal(file_map(path, 1 << 20, &m), OK);
        char *copy = malloc(8 * m.n);
        for (size_t k = 0; k < 2; k++) {
            const size_t n = transcode(&m, kinds[k], 14 + 3 * (shown + 1) * (shown + 1), copy);
            const struct splats_bytes file = {"other", copy, n};
            struct splats_info info;
            struct gaussians g;
            struct gaussians_report report;
            assert_int_equal(ply_format.peek(&file, &info), OK);
            assert_true(info.n == 21 && info.has_hdr && !info.hdr_stale);
            assert_int_equal(ply_format.parse(&file, 0, &arena, &g, &report), OK);
            for (int p = 0; p < gaussians_planes(degree); p++)
                assert_memory_equal(g.plane[p], in.g.plane[p], 21 * sizeof(float));
        }
        free(copy);
        file_unmap(&m);
    }
}

/* ---- radiance and display colours that differ ---- */

/* A written file, to be changed as other programs change it. */
static struct splats_bytes written(const struct scene *s, uint8_t **copy)
{
    struct file_map m;
    assert_int_equal(ply_write(tmpdir_path("both.ply"), s), OK);
    assert_int_equal(file_map(tmpdir_path("both.ply"), 1 << 24, &m), OK);
    *copy = malloc(m.n);
    assert_non_null(*copy);
    memcpy(*copy, m.p, m.n);
    struct splats_bytes file = {"both", *copy, m.n};
    file_unmap(&m);
    return file;
}

/* Harmonics about `middle`, those of view dependence about 0. */
static struct scene make_colours(int n, int degree, float ev, float middle, const float spread[2])
{
    struct scene s = make(n, degree);
    display_tonemap(ev, &s.tone);
    for (int p = G_SH; p < gaussians_planes(degree); p++)
        for (int i = 0; i < n; i++)
            s.g.plane[p][i] =
                (p < G_SH + 3 ? middle : 0) + spread[p >= G_SH + 3] * sinf((float)(31 * i + 7 * p));
    return s;
}

/* Number k of every `nth` row. */
static void change(const struct splats_bytes *file, uint8_t *copy, int k, int nth,
                   float (*how)(float))
{
    uint8_t *at = memmem(copy, file->n, "end_header\n", 11);
    const char *count = memmem(copy, file->n, "element vertex ", 15);
    assert_true(at && count);
    size_t rows = (size_t)atoi(count + 15), row = (file->n - (size_t)(at + 11 - copy)) / rows;
    for (size_t i = 0; i < rows; i += (size_t)nth) {
        struct bytes b = bytes_of(at + 11 + i * row + 4 * (size_t)k, 4);
        bytes_put_f32(at + 11 + i * row + 4 * (size_t)k, how(bytes_f32(&b)));
    }
}

static float minus(float v)
{
    return -v;
}

static float brighter(float v)
{
    return v + 0.3f;
}

static void drop_ev(const struct splats_bytes *file, uint8_t *copy)
{
    uint8_t *at = memmem(copy, file->n, "ihdr ev", 7);
    assert_non_null(at);
    *at = 'X';
}

enum change { UNTOUCHED, TURNED, RECOLOURED, CHANGES };

/* Half a turn about z, or half of the splats get brighter. */
static void touch(enum change what, int degree, const struct splats_bytes *file, uint8_t *copy)
{
    int bands = (degree + 1) * (degree + 1);
    for (int k = 1; what == TURNED && k < bands; k++)
        for (int c = 0; c < 3 && splats_sign(G_SH + 3 * k, 1 | 2) < 0; c++)
            change(file, copy, 8 + c * (bands - 1) + k, 1, minus);
    if (what == RECOLOURED)
        change(file, copy, 7, 2, brighter);
}

static void check_touched(enum change what, int degree, int n, bool told)
{
    static const float glossy[2] = {16, 1.2f}; // gloss from a hundredth to a hundred
    struct scene s = make_colours(n, degree, 2.5f, 0, glossy);
    int shown = degree < 3 ? degree : 3;
    bool stale = what == RECOLOURED || (what == TURNED && degree > 0);
    uint8_t *copy;
    struct splats_info info;
    struct gaussians g;
    struct gaussians_report report;
    struct splats_bytes file = written(&s, &copy);
    if (!told)
        drop_ev(&file, copy);
    touch(what, shown, &file, copy);
    assert_int_equal(ply_format.peek(&file, &info), OK);
    assert_true(fabsf(info.ev - 2.5f) < 0.1f); // recoloured ones count for it too
    if (info.hdr_stale != stale || info.has_hdr == stale)
        fail_msg("degree %d, change %d, ev told %d: stale %d", degree, (int)what, told, !stale);
    assert_int_equal(info.degree, stale ? shown : degree);
    assert_int_equal(ply_format.parse(&file, info.ev, &arena, &g, &report), OK);
    assert_true(g.n == n && g.degree == info.degree);
    free(copy);
}

static void colours_that_were_turned_are_believed(void **state)
{
    (void)state;
    for (int degree = 0; degree <= 4; degree++)
        for (int what = UNTOUCHED; what < CHANGES; what++) {
            check_touched((enum change)what, degree, 300, true);
            check_touched((enum change)what, degree, 300, false);
        }
    for (int degree = 0; degree <= 4; degree++)
        check_touched(UNTOUCHED, degree, 1, false);
}

/* However extreme, with and without its ev, and if two thirds are blacker than black. */
static void check_untouched(int degree, float middle, int ev)
{
    static const float spread[2] = {3, 3};
    struct scene s = make_colours(200, degree, (float)ev, middle, spread);
    struct splats_info info;
    uint8_t *copy;
    for (int p = G_SH; p < gaussians_planes(degree) && ev % 3 == 0; p++)
        for (int i = 0; i < s.g.n; i++)
            s.g.plane[p][i] = i % 3 == 0 ? s.g.plane[p][i] : p < G_SH + 3 ? -300 : 0;
    struct splats_bytes file = written(&s, &copy);
    if (ev % 2)
        drop_ev(&file, copy);
    assert_int_equal(ply_format.peek(&file, &info), OK);
    if (!info.has_hdr || info.hdr_stale)
        fail_msg("degree %d, harmonic %g, ev %d", degree, (double)middle, ev);
    free(copy);
}

static void nothing_else_is_taken_for_turned(void **state)
{
    (void)state;
    static const float middle[] = {-200, -60, -30, 0, 40, 57, 200};
    static const int evs[] = {-9, -4, 3, 6};
    for (int degree = 0; degree <= 4; degree++)
        for (size_t m = 0; m < sizeof middle / sizeof middle[0]; m++)
            for (size_t i = 0; i < sizeof evs / sizeof evs[0]; i++)
                check_untouched(degree, middle[m], evs[i]);
}

static err_t parse_text(const char *text)
{
    struct gaussians g;
    struct gaussians_report report;
    struct splats_info info;
    struct splats_bytes b = {"f", text, strlen(text)};
    err_t e = ply_format.parse(&b, 0, &arena, &g, &report);
    assert_int_equal(ply_format.peek(&b, &info), e);
    assert_true(e == OK || g.plane[0] == NULL);
    return e;
}

static void hostile_headers_are_refused(void **state)
{
    (void)state;
    static const struct {
        const char *text, *sentence;
        err_t code;
    } wrong[] = {
        {"", "no end", ERR_FORMAT},
        {"plz\n", "not a PLY", ERR_FORMAT},
        {"ply\nformat ascii 2.0\n", "ascii 2.0", ERR_UNSUPPORTED},
        {"ply\nformat binary_pdp_endian 1.0\n", "pdp_endian", ERR_UNSUPPORTED},
        {ASCII "element vertex 2\nproperty float x\nend_header\n1\n", "row 1 of 2 has no number 0",
         ERR_FORMAT},
        {ASCII "element vertex 1\nproperty float x\nend_header\n1.5.2\n",
         "number 0 is \"1.5.2\", expected float", ERR_FORMAT},
        {ASCII "element vertex 1\nproperty int x\nproperty ushort y\nend_header\n-7 65536\n",
         "number 1 is \"65536\", expected ushort", ERR_FORMAT},
        {ASCII "element vertex 1\nproperty uint16 y\nend_header\n-1\n", "\"-1\"", ERR_FORMAT},
        {ASCII "element vertex 1\nproperty float x\nend_header\n"
               "1.00000000000000000000000000000000000000000000000000000000000000000000000000\n",
         "no number 0", ERR_FORMAT},
        {HEAD "end_header\n", "lacks", ERR_FORMAT},
        {HEAD "element vertex -1\n", "\"-1\"", ERR_FORMAT},
        {HEAD "element vertex 99999999999999999999\n", "999 splats", ERR_FORMAT},
        {HEAD "element face 1\n", "face", ERR_UNSUPPORTED},
        {HEAD "element vertex 1\nproperty float128 x\n", "float128", ERR_FORMAT},
        {HEAD "element vertex 1\nproperty list uchar int x\n", "lists", ERR_UNSUPPORTED},
        {HEAD "element vertex 1\nproperty float x y z a\n", "words", ERR_FORMAT},
        {HEAD "element vertex 1\nproperty float x\nproperty int x\n", "twice", ERR_FORMAT},
        {HEAD "element vertex 0\nelement vertex 0\n", "two vertex", ERR_FORMAT},
        {HEAD "element vertex 2\nproperty float x\nend_header\n1234567", "2 splats of 4 bytes",
         ERR_FORMAT},
        {HEAD "element vertex 0\nproperty int x\nend_header\n", "x is int", ERR_FORMAT},
        {HEAD "element vertex 0\nend_header\n", "no property x", ERR_FORMAT},
        {HEAD "element vertex 0\nproperty float f_rest_0\nend_header\n", "SH degree",
         ERR_UNSUPPORTED},
        {HEAD "nonsense\n", "nonsense", ERR_FORMAT},
        {HEAD "comment ihdr ev nan\n", "ev \"nan\"", ERR_FORMAT},
        {HEAD "comment ihdr ev 1e9\n", "ev \"1e9\"", ERR_FORMAT},
    };
    make(1, 0);
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        assert_int_equal(parse_text(wrong[i].text), wrong[i].code);
        assert_non_null(strstr(err_text(), wrong[i].sentence));
    }
}

static void every_cut_is_refused(void **state)
{
    (void)state;
    struct scene in = make(2, 1);
    struct gaussians g;
    struct gaussians_report report;
    struct file_map m;
    assert_int_equal(ply_write(tmpdir_path("cut.ply"), &in), OK);
    assert_int_equal(file_map(tmpdir_path("cut.ply"), 1 << 20, &m), OK);
    for (size_t n = 0; n < m.n; n++) {
        char *copy = malloc(n + 1);
        memcpy(copy + 1, m.p, n);
        assert_int_equal(
            ply_format.parse(&(struct splats_bytes){"f", copy + 1, n}, 0, &arena, &g, &report),
            ERR_FORMAT);
        free(copy);
    }
    file_unmap(&m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_written_is_read_bit_for_bit),
        cmocka_unit_test(few_splats_and_none),
        cmocka_unit_test(ordinary_viewers_see_display_colours),
        cmocka_unit_test(extremes_come_back),
        cmocka_unit_test(pictures_of_the_file_are_those_of_the_scene),
        cmocka_unit_test(bad_splats_are_not_written),
        cmocka_unit_test(foreign_files_are_taken_as_srgb),
        cmocka_unit_test(other_encodings_are_the_same_file),
        cmocka_unit_test(colours_that_were_turned_are_believed),
        cmocka_unit_test(nothing_else_is_taken_for_turned),
        cmocka_unit_test(hostile_headers_are_refused),
        cmocka_unit_test(every_cut_is_refused),
    };
    tmpdir_make();
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    arena_free(&arena);
    tmpdir_remove();
    return failed;
}
