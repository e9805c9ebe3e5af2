/* One table lists the arguments of every verb. A line is split into words at blanks; a word that is
 * not used is an error. */
#include "sim/device/fault.h"

#include "drivers/format/file.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { WORDS = 8, WORD_CAP = 64 };

static const struct {
    const char *verb, *word; // word: NULL if the verb has none
    bool has_number;
    double lo, hi; // bounds of the number
    bool whole;
} verbs[FAULT_VERBS] = {
    [FAULT_DROP] = {"drop", NULL, true, 1, 1e6, true},
    [FAULT_LOSE] = {"lose", NULL, true, 0, 1, false},
    [FAULT_DUPLICATE] = {.verb = "duplicate"},
    [FAULT_REPEAT] = {.verb = "repeat"},
    [FAULT_ERROR] = {.verb = "error"},
    [FAULT_SHORT] = {"short", NULL, true, 1, 1e9, true},
    [FAULT_CORRUPT] = {"corrupt", NULL, true, 1, 1e9, true},
    [FAULT_TEAR] = {"tear", NULL, true, 0, 1, false},
    [FAULT_LATE] = {"late", NULL, true, 0, 3600, false},
    [FAULT_STALL] = {"stall", NULL, true, 0, 1e6, true},
    [FAULT_EIO] = {.verb = "eio"},
    [FAULT_INDEX] = {.verb = "index"},
    [FAULT_UNPLUG] = {.verb = "unplug"},
    [FAULT_SEQUENCE_STUCK] = {.verb = "sequence", .word = "stuck"},
    [FAULT_SEQUENCE_WRAP] = {.verb = "sequence", .word = "wrap"},
    [FAULT_STAMP_ZERO] = {.verb = "stamp", .word = "zero"},
    [FAULT_STAMP_REALTIME] = {.verb = "stamp", .word = "realtime"},
    [FAULT_STAMP_BACK] = {"stamp", "back", true, 0, 1e6, false},
    [FAULT_STAMP_JUMP] = {"stamp", "jump", true, -1e6, 1e6, false},
    [FAULT_IGNORE] = {"ignore", NULL, true, 0, 1e6, true},
    [FAULT_ROLLOVER] = {"rollover", NULL, true, 2, 1e6, true},
    [FAULT_QUANTUM] = {"quantum", NULL, true, 1e-6, 1, false},
    [FAULT_GAIN] = {"gain", NULL, true, 0.5, 2, false},
    [FAULT_BALANCE] = {"balance", NULL, true, 0.5, 2, false},
    [FAULT_DIGITAL] = {"digital", NULL, true, 1, 16, false},
    [FAULT_REFUSE_ACCESS] = {"refuse", "access", true, 0, 1e6, true},
    [FAULT_REFUSE_BUSY] = {"refuse", "busy", true, 0, 1e6, true},
    [FAULT_REFUSE_RANGE] = {"refuse", "range", true, 0, 1e6, true},
    [FAULT_FORMAT] = {.verb = "format"},
};

/* A line split into words, and its line number for messages. */
struct line {
    const char *what;
    int number, n;
    char word[WORDS][WORD_CAP];
};

static err_t split_words(struct line *l, const char *text, size_t n)
{
    l->n = 0;
    for (size_t i = 0; i < n;) {
        if (strchr(" \t\r", text[i]) && text[i] != '\0') {
            i++;
            continue;
        }
        if (text[i] == '#')
            break;
        size_t k = i;
        while (i < n && text[i] > ' ')
            i++;
        if (i == k)
            return err_fail(ERR_FORMAT, "%s: line %d has byte %d, scripts are printable ASCII",
                            l->what, l->number, (unsigned char)text[i]);
        if (l->n == WORDS || i - k >= WORD_CAP)
            return err_fail(ERR_FORMAT,
                            "%s: line %d has more than %d words or a word of %d bytes or more",
                            l->what, l->number, WORDS, WORD_CAP);
        memcpy(l->word[l->n], text + k, i - k);
        l->word[l->n++][i - k] = '\0';
    }
    return OK;
}

static err_t parse_number(const struct line *l, int i, double lo, double hi, double *out)
{
    if (i >= l->n)
        return err_fail(ERR_FORMAT, "%s: line %d ends before the number after \"%s\"", l->what,
                        l->number, l->word[i - 1]);
    char *end;
    *out = strtod(l->word[i], &end);
    if (*end != '\0' || !(*out >= lo && *out <= hi))
        return err_fail(ERR_FORMAT, "%s: line %d: \"%s\" is not a number in %g..%g", l->what,
                        l->number, l->word[i], lo, hi);
    return OK;
}

static err_t check_whole(const struct line *l, int i, double v)
{
    if (v != floor(v))
        return err_fail(ERR_FORMAT, "%s: line %d: %s is not a whole number", l->what, l->number,
                        l->word[i]);
    return OK;
}

static err_t parse_when(const struct line *l, struct fault *out)
{
    double v = 0.0;
    if (l->n < 4 || strcmp(l->word[0], "at") != 0)
        return err_fail(ERR_FORMAT, "%s: line %d is not \"at frame|time WHEN VERB ...\"", l->what,
                        l->number);
    out->by_time = strcmp(l->word[1], "time") == 0;
    if (!out->by_time && strcmp(l->word[1], "frame") != 0)
        return err_fail(ERR_FORMAT, "%s: line %d: \"%s\" is neither frame nor time", l->what,
                        l->number, l->word[1]);
    err_t e = parse_number(l, 2, 0.0, 1e9, &v);
    if (!e && !out->by_time)
        e = check_whole(l, 2, v);
    if (e)
        return e;
    out->frame = out->by_time ? 0 : (int64_t)v;
    out->time_ns = out->by_time ? (int64_t)llround(v * 1e9) : 0;
    return OK;
}

/* Find the verb and its fixed word; *at is the index of the next word. */
static err_t find_verb(const struct line *l, enum fault_verb *verb, int *at)
{
    bool known = false;
    for (int v = 0; v < FAULT_VERBS; v++) {
        if (strcmp(l->word[3], verbs[v].verb) != 0)
            continue;
        known = true;
        bool word = verbs[v].word;
        if (word && (l->n < 5 || strcmp(l->word[4], verbs[v].word) != 0))
            continue;
        *verb = (enum fault_verb)v;
        *at = word ? 5 : 4;
        return OK;
    }
    if (known)
        return err_fail(ERR_FORMAT, "%s: line %d: \"%s\" does not take \"%s\"", l->what, l->number,
                        l->word[3], l->n > 4 ? l->word[4] : "");
    return err_fail(ERR_FORMAT, "%s: line %d: no fault is called \"%s\"", l->what, l->number,
                    l->word[3]);
}

static err_t parse_line(const struct line *l, struct fault *out)
{
    int at = 0;
    memset(out, 0, sizeof *out);
    err_t e = parse_when(l, out);
    if (!e)
        e = find_verb(l, &out->verb, &at);
    if (!e && verbs[out->verb].has_number) {
        e = parse_number(l, at, verbs[out->verb].lo, verbs[out->verb].hi, &out->number);
        if (!e && verbs[out->verb].whole)
            e = check_whole(l, at, out->number);
        at++;
    }
    if (!e && out->verb == FAULT_DROP && at < l->n && strcmp(l->word[at], "nogap") == 0) {
        out->nogap = true;
        at++;
    }
    if (!e && at < l->n)
        return err_fail(ERR_FORMAT, "%s: line %d: unexpected word \"%s\" at the end", l->what,
                        l->number, l->word[at]);
    return e;
}

err_t fault_parse(const char *what, const char *text, size_t n, struct fault_script *out)
{
    struct line l = {.what = what, .number = 1};
    err_t e = OK;
    out->n = 0;
    for (size_t i = 0; !e && i < n; l.number++) {
        size_t k = i;
        while (i < n && text[i] != '\n' && text[i] != ';')
            i++;
        e = split_words(&l, text + k, i - k);
        i++;
        if (e || l.n == 0)
            continue;
        if (out->n == FAULT_MAX)
            e = err_fail(ERR_FORMAT, "%s: line %d: there are more than %d faults", what, l.number,
                         FAULT_MAX);
        else
            e = parse_line(&l, &out->v[out->n++]);
    }
    if (e)
        out->n = 0;
    return e;
}

err_t fault_read(const char *script, struct fault_script *out)
{
    struct file_map m;
    out->n = 0;
    if (strncmp(script, "at ", 3) == 0)
        return fault_parse("faults", script, strlen(script), out);
    err_t e = file_map(script, FAULT_TEXT_MAX, &m);
    if (e)
        return e;
    e = fault_parse(script, (const char *)m.p, m.n, out);
    file_unmap(&m);
    return e;
}
