/* A file is read as a list of lines "key = value" by one table of keys: the first three name the
 * device and must be those of `info`, so that a file that was copied or renamed is refused; all
 * but those of the curve must be there, none twice. The curve is 256 numbers a line.
 * The name of a file is UNIT_WxH_FORMAT.conf; bytes of the unit that would not do in a name are
 * written %XX. */
#include "firmware/capture/calib.h"

#include "core/base/num.h"
#include "drivers/format/partial.h"
#include "firmware/capture/take.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum {
    BYTES_MAX = 1 << 16, // size of a file
    CODES = 256,
    QUOTE = 40,
    DELAY_MAX = 32,    // frames, of struct bracket_camera
    DELAY_UNKNOWN = 8, // the same
};

enum kind { TEXT, WHOLE, NUMBER, CURVE };

enum key {
    UNIT,
    SIZE,
    FORMAT,
    WHEN,
    DELAY_LO,
    DELAY_HI,
    TIME_MIN,
    TIME_MAX,
    TOLERANCE,
    CRF_ERROR, // from here on: all or none
    CRF_RED,
    CRF_GREEN,
    CRF_BLUE,
    KEYS
};

static const struct {
    const char *name;
    enum kind kind;
    double lo, hi;
} keys[KEYS] = {
    [UNIT] = {"unit", TEXT, 0, 0},
    [SIZE] = {"size", TEXT, 0, 0},
    [FORMAT] = {"format", TEXT, 0, 0},
    [WHEN] = {"when_s", WHOLE, 0, 1e15},
    [DELAY_LO] = {"delay_lo", WHOLE, 0, DELAY_MAX},
    [DELAY_HI] = {"delay_hi", WHOLE, 0, DELAY_MAX},
    [TIME_MIN] = {"time_min_s", NUMBER, 1e-9, 1000},
    [TIME_MAX] = {"time_max_s", NUMBER, 1e-9, 1000},
    [TOLERANCE] = {"tolerance", NUMBER, 0.01, 1}, // as in struct bracket_camera
    [CRF_ERROR] = {"crf.error", NUMBER, 0, 10},
    [CRF_RED] = {"crf.red", CURVE, -40, 0},
    [CRF_GREEN] = {"crf.green", CURVE, -40, 0},
    [CRF_BLUE] = {"crf.blue", CURVE, -40, 0},
};

/* ---- names ---- */

static void escape_unit(const char *s, char *out, size_t cap)
{
    size_t at = 0;
    for (const char *p = s; *p && at + 4 < cap; p++) {
        unsigned char c = (unsigned char)*p;
        bool plain = c > 0x20 && c < 0x7f && c != '/' && c != '%' && !(c == '.' && p == s);
        at += (size_t)snprintf(out + at, cap - at, plain ? "%c" : "%%%02X", c);
    }
    out[at] = 0;
}

static err_t build_path(const char *dir, const struct camera_info *info, char path[FILE_PATH_CAP])
{
    char unit[3 * CAMERA_UNIT_CAP + 4], name[sizeof unit + 64];
    const char *format = take_format(info->format);
    if (!*info->unit || !format)
        return err_fail(ERR_ARG,
                        "%s: the camera reports no unit name, so its calibration cannot be stored",
                        dir);
    escape_unit(info->unit, unit, sizeof unit);
    snprintf(name, sizeof name, "%s_%dx%d_%s.conf", unit, info->w, info->h, format);
    if (strlen(name) > 255)
        return err_fail(ERR_ARG, "%s: the file name has %zu bytes, at most 255 are allowed", name,
                        strlen(name));
    return file_join(dir, name, path);
}

/* ---- reading ---- */

struct reader {
    const char *what;
    int line;
    int seen[KEYS]; // line of each key, 0: not yet
    const struct camera_info *info;
    struct calib *out;
    double value[KEYS];
};

static err_t parse_number(const struct reader *r, enum key k, char **at, double *out)
{
    char *from = *at;
    double v = strtod(from, at);
    if (*at == from)
        return err_fail(ERR_FORMAT, "%s:%d: %s: \"%.*s\" is not a number", r->what, r->line,
                        keys[k].name, QUOTE, from);
    if (!(v >= keys[k].lo && v <= keys[k].hi) || (keys[k].kind == WHOLE && v != floor(v)))
        return err_fail(ERR_FORMAT, "%s:%d: %s: %g is not %sin %g..%g", r->what, r->line,
                        keys[k].name, v, keys[k].kind == WHOLE ? "a whole number " : "", keys[k].lo,
                        keys[k].hi);
    *out = v;
    return OK;
}

static err_t parse_curve(struct reader *r, enum key k, char *text)
{
    float *x = r->out->crf.log2x[k - CRF_RED];
    for (int i = 0; i < CODES; i++) {
        double v;
        err_t e = parse_number(r, k, &text, &v);
        if (e)
            return e;
        x[i] = (float)v;
        if (i > 0 && !(x[i] > x[i - 1]))
            return err_fail(ERR_FORMAT, "%s:%d: %s: number %d of %d does not rise", r->what,
                            r->line, keys[k].name, i + 1, CODES);
    }
    if (x[CODES - 1] != 0.0f)
        return err_fail(ERR_FORMAT, "%s:%d: %s: the last number is %g and must be 0", r->what,
                        r->line, keys[k].name, (double)x[CODES - 1]);
    return *text ? err_fail(ERR_FORMAT, "%s:%d: %s: more than %d numbers", r->what, r->line,
                            keys[k].name, CODES)
                 : OK;
}

static err_t check_device(const struct reader *r, enum key k, const char *value)
{
    char size[32];
    const char *want = k == UNIT ? r->info->unit : take_format(r->info->format);
    snprintf(size, sizeof size, "%dx%d", r->info->w, r->info->h);
    if (k == SIZE)
        want = size;
    if (strcmp(value, want) == 0)
        return OK;
    return err_fail(ERR_FORMAT, "%s:%d: %s is \"%.*s\", but the camera has \"%s\"", r->what,
                    r->line, keys[k].name, QUOTE, value, want);
}

/* Removes the blanks on both sides. */
static char *trim_blanks(char *s)
{
    s += strspn(s, " \t");
    size_t n = strlen(s);
    while (n > 0 && (s[n - 1] == ' ' || s[n - 1] == '\t' || s[n - 1] == '\r'))
        n--;
    s[n] = 0;
    return s;
}

static err_t parse_value(struct reader *r, const char *name, char *value)
{
    int k = 0;
    while (k < KEYS && strcmp(keys[k].name, name) != 0)
        k++;
    if (k == KEYS)
        return err_fail(ERR_FORMAT, "%s:%d: unknown key \"%.*s\"", r->what, r->line, QUOTE, name);
    if (r->seen[k])
        return err_fail(ERR_FORMAT, "%s:%d: %s is given again, it is in line %d", r->what, r->line,
                        name, r->seen[k]);
    r->seen[k] = r->line;
    if (keys[k].kind == TEXT)
        return check_device(r, k, value);
    if (keys[k].kind == CURVE)
        return parse_curve(r, k, value);
    err_t e = parse_number(r, k, &value, &r->value[k]);
    value = trim_blanks(value);
    if (!e && *value)
        e = err_fail(ERR_FORMAT, "%s:%d: %s: \"%.*s\" after the number", r->what, r->line, name,
                     QUOTE, value);
    return e;
}

static err_t parse_line(struct reader *r, char *line)
{
    line = trim_blanks(line);
    char *equal = strchr(line, '=');
    if (!*line || *line == '#')
        return OK;
    if (!equal)
        return err_fail(ERR_FORMAT, "%s:%d: the line is not \"key = value\"", r->what, r->line);
    *equal = 0;
    return parse_value(r, trim_blanks(line), trim_blanks(equal + 1));
}

static err_t finish_reading(const struct reader *r)
{
    bool has_crf = false;
    for (int k = CRF_ERROR; k < KEYS; k++)
        has_crf = has_crf || r->seen[k];
    for (int k = 0; k < (has_crf ? KEYS : CRF_ERROR); k++)
        if (!r->seen[k])
            return err_fail(ERR_FORMAT, "%s:%d: ends without %s", r->what, r->line, keys[k].name);
    if (r->value[DELAY_LO] > r->value[DELAY_HI] || r->value[TIME_MIN] > r->value[TIME_MAX])
        return err_fail(
            ERR_FORMAT,
            "%s:%d: delay %g..%g frames, time %g..%g s: the lower bound is "
            "above the upper one",
            r->what, r->seen[r->value[DELAY_LO] > r->value[DELAY_HI] ? DELAY_HI : TIME_MAX],
            r->value[DELAY_LO], r->value[DELAY_HI], r->value[TIME_MIN], r->value[TIME_MAX]);
    r->out->delay_lo = (int)r->value[DELAY_LO];
    r->out->delay_hi = (int)r->value[DELAY_HI];
    r->out->time_min_s = r->value[TIME_MIN];
    r->out->time_max_s = r->value[TIME_MAX];
    r->out->tolerance = r->value[TOLERANCE];
    r->out->when_s = (int64_t)r->value[WHEN];
    r->out->has_crf = r->out->crf.known = has_crf;
    r->out->crf.error = (float)r->value[CRF_ERROR];
    return OK;
}

/* text: n bytes and a 0; is changed. */
static err_t parse_text(struct reader *r, char *text, size_t n)
{
    err_t e = OK;
    if (memchr(text, 0, n))
        return err_fail(ERR_FORMAT, "%s: the text has a zero byte at %zu", r->what, strlen(text));
    for (char *next = text; next && !e;) {
        char *line = next;
        next = strchr(line, '\n');
        if (next)
            *next++ = 0;
        r->line++;
        e = parse_line(r, line);
    }
    return e ? e : finish_reading(r);
}

/* Fills in the values that the device reports about itself. */
static void set_from_info(const struct camera_info *info, struct calib *out)
{
    bool linear = info->format >= CAMERA_GREY16;
    memset(out, 0, sizeof *out);
    out->delay_lo = info->exposure_delay < 0 ? 0 : num_min(info->exposure_delay, DELAY_MAX);
    out->delay_hi = info->exposure_delay < 0 ? DELAY_UNKNOWN : out->delay_lo;
    out->time_min_s = info->time_min_s;
    out->time_max_s = info->time_max_s;
    out->tolerance = linear ? BRACKET_TOLERANCE_LINEAR : BRACKET_TOLERANCE_DISPLAY;
}

err_t calib_parse(const char *what, const char *text, size_t n, const struct camera_info *info,
                  struct calib *out)
{
    struct reader r = {.what = what, .info = info, .out = out};
    set_from_info(info, out);
    if (n > BYTES_MAX)
        return err_fail(ERR_FORMAT, "%s: the file has %zu bytes, at most %d are read", what, n,
                        BYTES_MAX);
    char *copy = malloc(n + 1);
    if (!copy)
        return err_fail(ERR_NOMEM, "%s: no memory for %zu bytes", what, n);
    if (n > 0)
        memcpy(copy, text, n);
    copy[n] = 0;
    err_t e = parse_text(&r, copy, n);
    free(copy);
    if (e)
        set_from_info(info, out);
    return e;
}

err_t calib_load(const char *dir, const struct camera_info *info, struct calib *out, bool *found)
{
    char path[FILE_PATH_CAP];
    struct file_map m;
    *found = false;
    set_from_info(info, out);
    err_t e = build_path(dir, info, path);
    if (e || (access(path, F_OK) != 0 && errno == ENOENT))
        return e;
    e = file_map(path, BYTES_MAX, &m);
    if (e)
        return e;
    e = calib_parse(path, (const char *)m.p, m.n, info, out);
    file_unmap(&m);
    *found = !e;
    return e;
}

/* ---- writing ---- */

static void print_calib(FILE *f, const struct camera_info *info, const struct calib *c)
{
    fprintf(f, "# measured by hdrig calibrate\nunit = %s\nsize = %dx%d\nformat = %s\n", info->unit,
            info->w, info->h, take_format(info->format));
    fprintf(f, "when_s = %lld\ndelay_lo = %d\ndelay_hi = %d\n", (long long)c->when_s, c->delay_lo,
            c->delay_hi);
    fprintf(f, "time_min_s = %.17g\ntime_max_s = %.17g\ntolerance = %.17g\n", c->time_min_s,
            c->time_max_s, c->tolerance);
    if (!c->has_crf || !c->crf.known)
        return;
    fprintf(f, "crf.error = %.9g\n", (double)c->crf.error);
    for (int i = 0; i < 3; i++) {
        fprintf(f, "%s =", keys[CRF_RED + i].name);
        for (int k = 0; k < CODES; k++)
            fprintf(f, " %.9g", (double)c->crf.log2x[i][k]);
        putc('\n', f);
    }
}

/* Checks that the calibration can be read back, before it is written. */
static err_t check_readable(const char *path, const struct camera_info *info, const struct calib *c)
{
    char *text = NULL;
    size_t n = 0;
    struct calib back;
    FILE *f = open_memstream(&text, &n);
    if (!f)
        return err_fail(ERR_NOMEM, "%s: no memory to write the calibration", path);
    print_calib(f, info, c);
    err_t e = fclose(f) == 0 ? calib_parse(path, text, n, info, &back)
                             : err_fail(ERR_NOMEM, "%s: no memory to write the calibration", path);
    free(text);
    return e == ERR_FORMAT ? ERR_ARG : e;
}

static err_t write_file(const struct camera_info *info, const struct calib *c, const char *path)
{
    FILE *f;
    err_t e = file_create(path, &f);
    if (e)
        return e;
    print_calib(f, info, c);
    return file_finish(f, path);
}

err_t calib_check_place(const char *dir)
{
    char parent[FILE_PATH_CAP];
    const char *at = dir; // or where it will be made
    if (!file_exists(dir)) {
        err_t e = file_parent(dir, parent);
        if (e)
            return e;
        at = parent;
    }
    if (!file_is_dir(at))
        return err_fail(ERR_IO, "calibrations cannot be written to %s: %s is not a folder", dir,
                        at);
    if (access(at, W_OK | X_OK) != 0)
        return err_fail(ERR_IO, "calibrations cannot be written to %s: %s", dir, strerror(errno));
    return OK;
}

err_t calib_save(const char *dir, const struct camera_info *info, const struct calib *c)
{
    char path[FILE_PATH_CAP], now[FILE_PATH_CAP];
    struct partial p;
    err_t e = build_path(dir, info, path);
    if (!e)
        e = check_readable(path, info, c);
    if (e)
        return e;
    (void)mkdir(dir, 0777); // partial_open says what is wrong
    e = partial_open(path, &p);
    if (!e)
        e = partial_path(&p, path, now);
    if (!e)
        e = write_file(info, c, now);
    if (!e)
        e = partial_show(&p, path);
    partial_close(&p);
    return e;
}

/* ---- use ---- */

void calib_camera(const struct camera_info *info, const struct calib *c, struct bracket_camera *out)
{
    struct calib own;
    set_from_info(info, &own);
    if (!c)
        c = &own;
    double lo = fmax(info->time_min_s, c->time_min_s), hi = fmin(info->time_max_s, c->time_max_s);
    bool empty = lo > hi; // the range of the device has changed: use the range it reports
    *out = (struct bracket_camera){.period_s = info->period_s,
                                   .time_min_s = empty ? info->time_min_s : lo,
                                   .time_max_s = empty ? info->time_max_s : hi,
                                   .time_step_s = info->time_step_s,
                                   .delay_lo = c->delay_lo,
                                   .delay_hi = c->delay_hi,
                                   .stamp = info->stamp,
                                   .reports = info->reports,
                                   .chooses = info->chooses,
                                   .tolerance = c->tolerance};
}
