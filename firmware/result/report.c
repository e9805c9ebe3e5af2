#include "firmware/result/report.h"

#include "drivers/format/json.h"
#include "drivers/format/origin.h"

#include <assert.h>
#include <math.h>

void report_init(struct report *r, FILE *f)
{
    *r = (struct report){.f = f, .empty = true};
}

void report_begin(struct report *r, FILE *f)
{
    report_init(r, f);
    report_open(r, NULL, '{');
    report_text(r, "generator", ORIGIN_GENERATOR);
}

static void new_line(struct report *r)
{
    fprintf(r->f, "\n%*s", 2 * r->depth, "");
}

static void begin_member(struct report *r, const char *key)
{
    if (r->depth > 0) {
        if (!r->empty)
            putc(',', r->f);
        new_line(r);
    }
    r->empty = false;
    if (key) {
        json_put_string(r->f, key);
        fputs(": ", r->f);
    }
}

void report_open(struct report *r, const char *key, char bracket)
{
    assert(r->depth < REPORT_DEPTH);
    begin_member(r, key);
    putc(bracket, r->f);
    r->close[r->depth++] = bracket == '{' ? '}' : ']';
    r->empty = true;
}

void report_close(struct report *r)
{
    assert(r->depth > 0);
    char c = r->close[--r->depth];
    if (!r->empty)
        new_line(r);
    putc(c, r->f);
    r->empty = false;
    if (r->depth == 0)
        putc('\n', r->f);
}

static void put_number(struct report *r, double v)
{
    if (isfinite(v))
        fprintf(r->f, "%.6g", v);
    else
        fputs("null", r->f);
}

void report_number(struct report *r, const char *key, double v)
{
    begin_member(r, key);
    put_number(r, v);
}

void report_row(struct report *r, const char *key, const double *v, int n)
{
    begin_member(r, key);
    putc('[', r->f);
    for (int i = 0; i < n; i++) {
        fputs(i > 0 ? ", " : "", r->f);
        put_number(r, v[i]);
    }
    putc(']', r->f);
}

void report_int(struct report *r, const char *key, long long v)
{
    begin_member(r, key);
    fprintf(r->f, "%lld", v);
}

void report_bool(struct report *r, const char *key, bool v)
{
    begin_member(r, key);
    fputs(v ? "true" : "false", r->f);
}

void report_text(struct report *r, const char *key, const char *text)
{
    begin_member(r, key);
    if (text)
        json_put_string(r->f, text);
    else
        fputs("null", r->f);
}
