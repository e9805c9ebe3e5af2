/* inih splits the lines; this file checks the values. Our own reader counts the lines and refuses
 * what inih would cut without a word: long lines and zero bytes. */
#include "firmware/config.h"

#include <errno.h>
#include <ini.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

struct key {
    const char *name;
    size_t offset;                 // of an int in struct config
    int min, max, multiple, value; // multiple: of which the value must be; value: the default,
                                   // which may lie outside
    const char *help;
};

#define FIELD(f) offsetof(struct config, f)

static const struct key keys[] = {
    {"threads", FIELD(threads), 0, 64, 1, 0, "worker threads, 0 = one per core"},
    {"max_memory_mb", FIELD(max_memory_mb), 64, 1048576, 1, 4000, "refuse jobs that need more, MB"},
    {"size", FIELD(size), 56, 1792, 14, 0,
     "edge of the square working pictures, px; 0 = that of the model, else 448"},
    {"seed", FIELD(seed), 0, 2147483647, 1, 0, "start of the random numbers"},
    {"refine.steps", FIELD(refine_steps), 0, 100000, 1, 1000, "steps of refinement, 0 = none"},
    {"refine.sh_degree_max", FIELD(refine_sh_degree_max), 0, 4, 1, 4,
     "highest degree of the spherical harmonics"},
    {"refine.gaussians_max", FIELD(refine_gaussians_max), 1000, 4000000, 1, 200000,
     "most Gaussians in a refined scene"},
    {"cameras.polish", FIELD(cameras_polish), 0, 1, 1, 1,
     "bundle adjustment of cameras that are not known; 0 = as the network says"},
    {"cameras.fov_deg", FIELD(cameras_fov_deg), 0, 150, 1, 0,
     "horizontal field of view of cameras that are not known; 0 = to be found"},
    {"start.stereo", FIELD(start_stereo), 0, 1, 1, 1,
     "refinement starts from 1 stereo, 0 the network's Gaussians"},
    {"net.float_parts", FIELD(net_float_parts), 0, 15, 1, 0,
     "int8 parts in floats: 1 blocks, 2 attention, 4 heads, 8 special tokens"},
};

enum { N_KEYS = sizeof keys / sizeof keys[0], QUOTE_MAX = 100 };

static int *field(struct config *c, const struct key *k)
{
    return (int *)(void *)((char *)c + k->offset);
}

void config_defaults(struct config *c)
{
    memset(c, 0, sizeof *c);
    for (int i = 0; i < N_KEYS; i++)
        *field(c, &keys[i]) = keys[i].value;
}

err_t config_set(struct config *c, const char *where, const char *key, const char *value)
{
    const struct key *k = NULL;
    for (int i = 0; i < N_KEYS && !k; i++)
        if (strcmp(keys[i].name, key) == 0)
            k = &keys[i];
    if (!k)
        return err_fail(ERR_ARG, "%s: unknown key \"%.*s\"", where, QUOTE_MAX, key);
    char *end;
    errno = 0;
    long long n = strtoll(value, &end, 10);
    if (end == value || *end)
        return err_fail(ERR_ARG, "%s: %s: \"%.*s\" is not a whole number", where, k->name,
                        QUOTE_MAX, value);
    if (n != k->value && (errno || n < k->min || n > k->max))
        return err_fail(ERR_ARG, "%s: %s: %.*s is not in %d..%d", where, k->name, QUOTE_MAX, value,
                        k->min, k->max);
    if (n % k->multiple)
        return err_fail(ERR_ARG, "%s: %s: %lld is not a multiple of %d", where, k->name, n,
                        k->multiple);
    *field(c, k) = (int)n;
    return OK;
}

err_t config_assign(struct config *c, const char *text)
{
    char key[64];
    const char *equal = strchr(text, '=');
    size_t len = equal ? (size_t)(equal - text) : 0;
    while (len > 0 && text[len - 1] == ' ')
        len--;
    if (len == 0 || len >= sizeof key)
        return err_fail(ERR_ARG, "--set: \"%.*s\" is not key=value", QUOTE_MAX, text);
    memcpy(key, text, len);
    key[len] = 0;
    return config_set(c, "--set", key, equal + 1);
}

struct source {
    struct config *c;
    const char *name, *text;
    size_t size, at;
    int line;     // number of the line read last, from 1
    int bad_line; // first refused one, 0 = none
    err_t code;   // why
};

static void refuse(struct source *s, err_t code)
{
    s->code = code;
    s->bad_line = s->line;
}

/* The ini_reader: one line like fgets, NULL at the end and after an error. */
static char *next_line(char *out, int cap, void *ctx)
{
    struct source *s = ctx;
    if (s->at == s->size || s->bad_line)
        return NULL;
    s->line++;
    const char *start = s->text + s->at;
    const char *newline = memchr(start, '\n', s->size - s->at);
    size_t len = newline ? (size_t)(newline - start) + 1 : s->size - s->at;
    if (len >= (size_t)cap) {
        refuse(s, err_fail(ERR_FORMAT, "%s:%d: line of %zu bytes, at most %d", s->name, s->line,
                           len, cap - 1));
        return NULL;
    }
    if (memchr(start, 0, len)) {
        refuse(s, err_fail(ERR_FORMAT, "%s:%d: zero byte", s->name, s->line));
        return NULL;
    }
    memcpy(out, start, len);
    out[len] = 0;
    s->at += len;
    return out;
}

static int handle_pair(void *ctx, const char *section, const char *key, const char *value)
{
    struct source *s = ctx;
    char where[256];
    snprintf(where, sizeof where, "%s:%d", s->name, s->line);
    err_t e = *section ? err_fail(ERR_FORMAT, "%s: key inside [%.*s], sections are not used", where,
                                  QUOTE_MAX, section)
                       : config_set(s->c, where, key, value);
    if (e)
        refuse(s, ERR_FORMAT);
    return e == OK;
}

err_t config_parse(struct config *c, const char *name, const char *text, size_t size)
{
    struct config new = *c;
    struct source s = {.c = &new, .name = name, .text = text, .size = size};
    if (size > CONFIG_FILE_MAX)
        return err_fail(ERR_FORMAT, "%s: more than %d bytes", name, CONFIG_FILE_MAX);
    int line = ini_parse_stream(next_line, &s, handle_pair, &s);
    if (line > 0 && (!s.bad_line || line < s.bad_line))
        return err_fail(ERR_FORMAT, "%s:%d: not \"key = value\"", name, line);
    if (s.bad_line)
        return s.code;
    *c = new;
    return OK;
}

err_t config_read(struct config *c, const char *path)
{
    char text[CONFIG_FILE_MAX + 1]; // one more byte shows that the file is too long
    FILE *f = fopen(path, "rb");
    if (!f)
        return err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    size_t n = fread(text, 1, sizeof text, f);
    bool bad = ferror(f) != 0;
    fclose(f);
    if (bad)
        return err_fail(ERR_IO, "%s: cannot be read", path);
    return config_parse(c, path, text, n);
}

err_t config_load(struct config *c, const char *dir)
{
    static const char *const layers[] = {"defaults.conf", "board.conf", "hdrig.conf"};
    struct config new = *c;
    for (size_t i = 0; i < sizeof layers / sizeof layers[0]; i++) {
        char path[512];
        if (snprintf(path, sizeof path, "%s/%s", dir, layers[i]) >= (int)sizeof path)
            return err_fail(ERR_ARG, "%.*s...: path longer than %zu bytes", QUOTE_MAX, dir,
                            sizeof path - 1);
        if (access(path, F_OK) != 0 && errno == ENOENT)
            continue;
        err_t e = config_read(&new, path);
        if (e)
            return e;
    }
    *c = new;
    return OK;
}

err_t config_print(const struct config *c, FILE *out)
{
    struct config copy = *c;
    for (int i = 0; i < N_KEYS; i++) {
        const struct key *k = &keys[i];
        fprintf(out, "# %s (%d..%d, default %d)\n%s = %d\n", k->help, k->min, k->max, k->value,
                k->name, *field(&copy, k));
    }
    return fflush(out) || ferror(out)
               ? err_fail(ERR_IO, "config: cannot be written: %s", strerror(errno))
               : OK;
}
