#include "drivers/format/plyrows.h"

#include "core/base/bytes.h"

#include <stdlib.h>
#include <string.h>

enum { WORD_CAP = 64 };

static const struct type {
    const char *name;
    uint8_t bytes;
} types[] = {{"float", 4}, {"float32", 4}, {"ushort", 2}, {"uint16", 2}, {"char", 1}, {"int8", 1},
             {"uchar", 1}, {"uint8", 1},   {"short", 2},  {"int16", 2},  {"int", 4},  {"int32", 4},
             {"uint", 4},  {"uint32", 4},  {"double", 8}, {"float64", 8}};

int plyrows_type(const char *name)
{
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++)
        if (strcmp(types[i].name, name) == 0)
            return (int)i;
    return -1;
}

const char *plyrows_type_name(int type)
{
    return types[type].name;
}

size_t plyrows_type_bytes(int type)
{
    return types[type].bytes;
}

/* ---- text ---- */

static bool is_blank(uint8_t c)
{
    return c == ' ' || (c >= '\t' && c <= '\r');
}

/* The next word from *at on; false if there is none, or none so short. */
static bool take_word(const struct plyrows *r, size_t *at, char word[WORD_CAP])
{
    size_t from = *at, n;
    while (from < r->bytes && is_blank(r->p[from]))
        from++;
    for (n = 0; from + n < r->bytes && !is_blank(r->p[from + n]); n++)
        if (n == WORD_CAP - 1)
            return false;
    memcpy(word, r->p + from, n);
    word[n] = 0;
    *at = from + n;
    return n > 0;
}

/* One number of the row, at `to`. */
static bool put_number(const char *word, int type, uint8_t *to)
{
    char *end;
    if (type / 2 == PLYROWS_TYPE_USHORT / 2) {
        const unsigned long v = strtoul(word, &end, 10);
        bytes_put_u16(to, (uint16_t)v);
        return *end == 0 && *word != '-' && v <= UINT16_MAX;
    }
    const float v = strtof(word, &end);
    if (type / 2 == PLYROWS_TYPE_FLOAT / 2)
        bytes_put_f32(to, v);
    return *end == 0;
}

static err_t read_text(struct plyrows *r)
{
    uint8_t *to = r->now;
    char word[WORD_CAP];
    for (int k = 0; k < r->n_cells; k++) {
        if (!take_word(r, &r->next, word))
            return err_fail(ERR_FORMAT, "%s: row %d of %d has no number %d", r->what, r->at + 1,
                            r->n, k);
        if (!put_number(word, r->type[k], to))
            return err_fail(ERR_FORMAT, "%s: row %d of %d: number %d is \"%s\", expected %s",
                            r->what, r->at + 1, r->n, k, word, types[r->type[k]].name);
        to += types[r->type[k]].bytes;
    }
    r->at++;
    return OK;
}

static void rewind_text(struct plyrows *r)
{
    r->at = -1;
    r->next = 0;
}

/* ---- binary ---- */

static void swap_bytes(struct plyrows *r, const uint8_t *from)
{
    uint8_t *to = r->now;
    for (int k = 0; k < r->n_cells; k++) {
        const size_t n = types[r->type[k]].bytes;
        for (size_t b = 0; b < n; b++)
            to[b] = from[n - 1 - b];
        to += n;
        from += n;
    }
}

/* ---- either ---- */

err_t plyrows_check(struct plyrows *r)
{
    size_t body;
    err_t e = OK;
    memset(r->now, 0, sizeof r->now);
    rewind_text(r);
    if (r->kind == PLYROWS_ASCII) {
        while (r->at < r->n - 1 && !e)
            e = read_text(r);
        rewind_text(r);
    } else if (!bytes_mul((size_t)r->n, r->row, &body) || body > r->bytes) {
        e = err_fail(ERR_FORMAT,
                     "%s: %d splats of %zu bytes, the file has %zu bytes after its header", r->what,
                     r->n, r->row, r->bytes);
    }
    return e;
}

const uint8_t *plyrows_get(struct plyrows *r, int i)
{
    const uint8_t *row = r->p + (size_t)i * r->row;
    if (r->kind == PLYROWS_LITTLE)
        return row;
    if (r->kind == PLYROWS_BIG) {
        swap_bytes(r, row);
        return r->now;
    }
    if (i < r->at)
        rewind_text(r);
    while (r->at < i && read_text(r) == OK)
        ;
    return r->now;
}
