/* golden prepare SET DIR: the inputs of a golden set as `hdrig reconstruct` wants them, in the
 *   order of its index.json (DIR/images, DIR/exposure.json); prints size and render exposures.
 * golden compare SET DUMP [int8|bf16]: every tensor of a golden set against the dump of a run.
 *   Bars for floats: see FLOAT_RMS; for other precisions 3 times the emulation of the same column.
 *   Of lists of voxels the cells are compared that both have with as many points; pictures pixel by
 *   pixel, where a few may differ because a Gaussian stands at a threshold. Exit code 1 if a bar is
 *   exceeded. */
#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "tests/golden/npy.h"

#include <math.h>
#include <stdbool.h>
#include <sys/stat.h>

/* Bounds for floats: difference in rms over rms of the tensor, and largest difference over its
 * largest value. The second pair is for small differences of large numbers: attention, variance. */
static const double FLOAT_RMS[2] = {2e-5, 1e-4}, FLOAT_MAX[2] = {2e-4, 1e-3};
static const double FACTOR = 3;                 // times the emulation
static const double OUTLIERS[2] = {1e-3, 0.02}; // share of pixels: mask known; not known
/* Where cells differ because points lie on their borders: how many more or less, and the bar in rms
 * of the pictures without their outliers. */
static const double CELLS_APART = 1e-3, PICTURE_RMS = 2e-4;

static void die(const char *what)
{
    fprintf(stderr, "golden: %s\n", what);
    exit(2);
}

static void must(err_t e)
{
    if (e)
        die(err_text());
}

static double number(const struct cJSON *object, const char *key)
{
    double v;
    return json_number(json_member(object, key), &v) ? v : NAN;
}

static const char *text(const struct cJSON *object, const char *key)
{
    const char *s = json_string(json_member(object, key));
    return s ? s : "";
}

/* ---- prepare ---- */

static void copy(const char *from, const char *to)
{
    struct file_map map;
    FILE *f;
    must(file_map(from, 1 << 28, &map));
    must(file_create(to, &f));
    fwrite(map.p, 1, map.n, f);
    must(file_finish(f, to));
    file_unmap(&map);
}

static int prepare(const char *set, const struct cJSON *index, const char *dir)
{
    char path[FILE_PATH_CAP], from[FILE_PATH_CAP], name[300];
    FILE *f;
    must(file_join(dir, "images", path));
    if (mkdir(dir, 0777) != 0 || mkdir(path, 0777) != 0)
        die("the folder for the inputs exists or cannot be made");
    must(file_join(dir, "exposure.json", path));
    must(file_create(path, &f));
    const struct cJSON *file = json_first(json_member(index, "files"));
    const struct cJSON *time = json_first(json_member(index, "exposures"));
    for (int i = 0; file && time; i++, file = json_next(file), time = json_next(time)) {
        double t = 0;
        if (!json_string(file) || !json_number(time, &t))
            die("files or exposures are malformed");
        snprintf(name, sizeof name, "images/%03d_%.200s", i, json_string(file));
        fprintf(f, "%s\"%s\": %.17g", i ? ",\n" : "{", name + 7, t);
        must(file_join(set, json_string(file), from));
        must(file_join(dir, name, path));
        copy(from, path);
    }
    fputs("}\n", f);
    must(file_join(dir, "exposure.json", path));
    must(file_finish(f, path));
    printf("size=%g exposures=", number(index, "image_size"));
    for (time = json_first(json_member(index, "render_exposures")); time; time = json_next(time)) {
        double t = 0;
        (void)json_number(time, &t);
        printf("%.17g%s", t, json_next(time) ? "," : "\n");
    }
    return 0;
}

/* ---- compare ---- */

struct set {
    const char *dir, *dump, *column; // column: of the emulation, NULL for floats
    const struct cJSON *tensors, *dumped;
    bool same_cells;
    size_t cells;
    int32_t *place; // (cells) where each golden cell is in the dump, -1: not there; NULL: not known
    int32_t *mask;  // pixels of the picture at a threshold; NULL if not known
    size_t n_mask;
    int failures;
};

struct pair {
    const struct cJSON *entry;
    const char *name;
    bool ints;
    size_t n, n_whole, n_got; // golden values; of the whole tensor there; in the dump
    void *want, *got;         // 4-byte values
    uint32_t *at;             // (n) index of each golden value in the whole, NULL: all
};

static const struct cJSON *find(const struct cJSON *tensors, const char *name)
{
    for (const struct cJSON *t = json_first(tensors); t; t = json_next(t))
        if (strcmp(text(t, "name"), name) == 0)
            return t;
    return NULL;
}

static void *load(const char *dir, const char *file, size_t *n)
{
    char path[FILE_PATH_CAP];
    must(file_join(dir, file, path));
    return npy_read(path, n);
}

static double value(const struct pair *p, const void *array, size_t i)
{
    return p->ints ? ((const int32_t *)array)[i] : (double)((const float *)array)[i];
}

/* Value of the dump that belongs to golden value i; what it is itself where there is none. */
static double got(const struct set *s, const struct pair *p, size_t i)
{
    size_t at = p->at ? p->at[i] : i;
    if (!s->same_cells && strncmp(p->name, "vox.", 4) == 0) {
        size_t width = p->n_whole / s->cells;
        int32_t row = s->place[at / width];
        if (row < 0)
            return value(p, p->want, i);
        at = (size_t)row * width + at % width;
    }
    return value(p, p->got, at);
}

static void close_pair(struct pair *p)
{
    free(p->want);
    free(p->got);
    free(p->at);
}

/* false: the dump has no such tensor, or another shape. */
static bool open_pair(const struct set *s, const struct cJSON *entry, struct pair *p)
{
    bool list = strncmp(text(entry, "name"), "vox.", 4) == 0; // lists of any length
    const struct cJSON *mine = find(s->dumped, text(entry, "name"));
    size_t n;
    *p = (struct pair){.entry = entry,
                       .name = text(entry, "name"),
                       .ints = strcmp(text(entry, "dtype"), "int32") == 0};
    const struct cJSON *a = json_first(json_member(entry, "shape"));
    const struct cJSON *b = json_first(json_member(mine, "shape"));
    double x = 0, y = 0;
    bool same = mine && strcmp(text(entry, "dtype"), text(mine, "dtype")) == 0;
    for (; same && (a || b); a = json_next(a), b = json_next(b))
        same = a && b && json_number(a, &x) && json_number(b, &y) &&
               ((x <= y && x >= y) || (list && x > 100 && y > 100));
    if (!same)
        return false;
    p->want = load(s->dir, text(entry, "file"), &p->n);
    p->got = load(s->dump, text(mine, "file"), &p->n_got);
    if (*text(entry, "index_file"))
        p->at = load(s->dir, text(entry, "index_file"), &n);
    p->n_whole = (size_t)number(entry, "numel");
    if ((p->n_got != p->n_whole && !list) || (p->at ? n != p->n : p->n != p->n_whole))
        die("a file has another number of values than its index says");
    for (size_t i = 0; p->at && i < n; i++)
        if (p->at[i] >= p->n_whole)
            die("an index file points beyond its tensor");
    return true;
}

struct figures {
    double rel_rms, max; // over the rms and the largest value of the golden values
    double mean, rms;    // over whole tensors: difference relative to the golden rms
    double outliers;     // share of pixels beyond the bar, pictures only
};

static void whole(const struct pair *p, struct figures *f)
{
    double sum = 0, square = 0, n = (double)p->n_got;
    for (size_t i = 0; i < p->n_got; i++) {
        double v = value(p, p->got, i);
        sum += v;
        square += v * v;
    }
    double rms = sqrt(number(p->entry, "sumsq") / n);
    f->mean = fabs(sum / n - number(p->entry, "mean")) / fmax(rms, 1e-30);
    f->rms = fabs(sqrt(square / n) - rms) / fmax(rms, 1e-30);
}

static double largest(const struct pair *p)
{
    return fmax(fabs(number(p->entry, "min")), fabs(number(p->entry, "max")));
}

/* Values whose pixel is in the mask may be off by 1/255 of the largest; of pictures, values beyond
 * the bar are counted instead of entering the sums. */
static struct figures measure(const struct set *s, const struct pair *p, bool picture, double bar)
{
    struct figures f = {0};
    double diff = 0, norm = 0, off = 0, top = fmax(largest(p), 1e-30);
    size_t channels = picture && s->mask ? p->n_got / s->n_mask : 1;
    for (size_t i = 0; i < p->n; i++) {
        double want = value(p, p->want, i), d = fabs(got(s, p, i) - want);
        size_t pixel = (p->at ? p->at[i] : i) / channels;
        double slack = picture && s->mask && s->mask[pixel] ? top / 255 : 0;
        norm += want * want;
        if (picture && !(d <= bar * top + slack)) {
            off++;
            continue;
        }
        d = fmax(d - slack, 0);
        diff += d * d;
        f.max = d / top <= f.max ? f.max : d / top; // takes NaN
    }
    f.rel_rms = sqrt(diff / fmax(norm, 1e-60));
    f.outliers = off / (double)p->n;
    whole(p, &f);
    return f;
}

static bool delicate(const char *name)
{
    return strstr(name, "weighted_var") || strstr(name, "attn") || strstr(name, "sensitivity");
}

/* Bars of a tensor; rms is NAN if the set has none for this precision. */
static void bars(const struct set *s, const struct pair *p, double *rms, double *max)
{
    int loose = delicate(p->name);
    *rms = FLOAT_RMS[loose];
    *max = FLOAT_MAX[loose];
    if (strncmp(p->name, "render.", 7) == 0 && !s->same_cells)
        *rms = PICTURE_RMS;
    if (!s->column)
        return;
    *rms = fmax(FACTOR * number(json_member(p->entry, s->column), "rel_rms"), *rms);
    if (isnan(number(json_member(p->entry, s->column), "rel_rms")))
        *rms = NAN;
    *max = INFINITY;
}

static const char *judge(const struct set *s, const struct pair *p, struct figures *f)
{
    bool picture = strncmp(p->name, "render.", 7) == 0 && !s->column;
    double rms, max;
    bars(s, p, &rms, &max);
    *f = measure(s, p, picture, max);
    if (isnan(rms))
        return "-";
    bool good = f->rel_rms <= rms && f->max <= max;
    if (!picture && (s->same_cells || strncmp(p->name, "vox.", 4) != 0))
        good = good && f->mean <= rms && f->rms <= rms;
    else if (picture)
        good = good && f->outliers <= OUTLIERS[!s->mask || !s->same_cells];
    return good ? "ok" : "FAILED";
}

static void compare_tensor(struct set *s, const struct cJSON *entry)
{
    const char *name = text(entry, "name");
    struct pair p;
    struct figures f;
    if (strcmp(name, "render.near_threshold_mask") == 0)
        return;
    if (strncmp(name, "vox.", 4) == 0 && !s->same_cells &&
        (!s->place || strcmp(name, "vox.index") == 0))
        return;
    if (!open_pair(s, entry, &p)) {
        printf("%-30s FAILED: not dumped, or of another shape\n", name);
        s->failures++;
        return;
    }
    const char *verdict = judge(s, &p, &f);
    printf("%-30s %9.2e %9.2e %9.2e %9.2e ", name, f.rel_rms, f.max, f.mean, f.rms);
    if (f.outliers > 0)
        printf("%.2g %% outliers ", 100 * f.outliers);
    puts(verdict);
    s->failures += strcmp(verdict, "FAILED") == 0;
    close_pair(&p);
}

static int order(const int32_t *a, const int32_t *b)
{
    for (int k = 0; k < 3; k++)
        if (a[k] != b[k])
            return a[k] < b[k] ? -1 : 1;
    return 0;
}

/* Both lists are sorted by cell. count, p: with all values. Returns how many cells match. */
static size_t match(struct set *s, const struct pair *p, const struct pair *count)
{
    const int32_t *want = p->want, *mine = p->got, *points = count->want, *own = count->got;
    size_t matched = 0, k = 0;
    s->place = malloc(s->cells * sizeof *s->place);
    if (!s->place)
        die("no memory");
    for (size_t i = 0; i < s->cells; i++) {
        while (k < p->n_got / 3 && order(mine + 3 * k, want + 3 * i) < 0)
            k++;
        bool same =
            k < p->n_got / 3 && order(mine + 3 * k, want + 3 * i) == 0 && own[k] == points[i];
        s->place[i] = same ? (int32_t)k : -1;
        matched += same;
    }
    return matched;
}

/* Cells of both lists; in floats nearly all must match. */
static void compare_cells(struct set *s)
{
    const struct cJSON *entry = find(s->tensors, "vox.index");
    struct pair p, count;
    if (!entry)
        return;
    if (!open_pair(s, entry, &p) || !open_pair(s, find(s->tensors, "vox.count"), &count)) {
        printf("cells: not dumped: FAILED\n");
        s->failures++;
        return;
    }
    s->cells = count.n_whole;
    s->same_cells = true; // to compare place by place
    if (p.n_got == p.n_whole) {
        struct figures f = measure(s, &p, false, 0);
        s->same_cells = f.max <= 0 && f.mean <= 1e-12 && f.rms <= 1e-12;
    } else {
        s->same_cells = false;
    }
    double want = (double)s->cells, have = (double)count.n_got, matched = NAN;
    bool close = fabs(want - have) <= CELLS_APART * want || s->column;
    printf("cells: %.0f, golden %.0f", have, want);
    if (!s->same_cells && !p.at) {
        matched = (double)match(s, &p, &count);
        close = close && (s->column || matched >= (1 - CELLS_APART) * want);
        printf(", %.0f match", matched);
    }
    puts(s->same_cells ? ", the same" : close ? "" : " FAILED");
    s->failures += !close;
    close_pair(&p);
    close_pair(&count);
}

static int compare(struct set *s)
{
    const struct cJSON *mask = find(s->tensors, "render.near_threshold_mask");
    if (mask && !*text(mask, "index_file"))
        s->mask = load(s->dir, text(mask, "file"), &s->n_mask);
    compare_cells(s);
    printf("%-30s %9s %9s %9s %9s\n", "", "rel_rms", "max", "mean", "rms");
    for (const struct cJSON *t = json_first(s->tensors); t; t = json_next(t))
        compare_tensor(s, t);
    free(s->mask);
    free(s->place);
    printf("%d beyond their bars\n", s->failures);
    return s->failures > 0;
}

static struct cJSON *read_index(const char *dir)
{
    char path[FILE_PATH_CAP];
    struct cJSON *doc;
    must(file_join(dir, "index.json", path));
    must(json_read(path, &doc));
    return doc;
}

int main(int argc, char **argv)
{
    if (argc < 4)
        die("usage: golden prepare SET DIR | golden compare SET DUMP [int8|bf16]");
    struct cJSON *index = read_index(argv[2]);
    int code;
    if (strcmp(argv[1], "prepare") == 0) {
        code = prepare(argv[2], index, argv[3]);
    } else {
        struct cJSON *dump = read_index(argv[3]);
        const char *kind = argc > 4 ? argv[4] : "fp32";
        struct set s = {.dir = argv[2],
                        .dump = argv[3],
                        .column = strcmp(kind, "int8") == 0   ? "int8_w8a8_all_emulation_deviation"
                                  : strcmp(kind, "bf16") == 0 ? "bf16_release_emulation_deviation"
                                                              : NULL,
                        .tensors = json_member(index, "tensors"),
                        .dumped = json_member(dump, "tensors")};
        code = compare(&s);
        json_free(dump);
    }
    json_free(index);
    return code;
}
