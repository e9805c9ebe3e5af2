#include "firmware/daemon/collect.h"

#include "core/base/log.h"
#include "drivers/format/json.h"

#include <stdarg.h>
#include <stdio.h>

static void set_line(struct collect *c, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

static void set_line(struct collect *c, const char *format, ...)
{
    va_list list;
    va_start(list, format);
    vsnprintf(c->line, sizeof c->line, format, list);
    va_end(list);
}

static const char *plural_s(int n)
{
    return n == 1 ? "" : "s";
}

err_t collect_look(struct collect *c)
{
    err_t e = places_open(c->store, &c->places);
    int n = c->places.n;
    if (!e && n > 0)
        set_line(c, "%d place%s so far", n, plural_s(n));
    else if (!e)
        set_line(c, "no place yet");
    return e;
}

err_t collect_room(const struct collect *c)
{
    if (!c->on || (c->places.n + 1) * c->cameras <= PLACES_MAX)
        return OK;
    return err_fail(ERR_LIMIT, "%d places: a scene takes no more than %d views; end the session",
                    c->places.n, PLACES_MAX);
}

void collect_take(const struct collect *c, struct take *t)
{
    t->is_place = c->on;
    if (!c->on)
        return;
    snprintf(t->session, sizeof t->session, "%s", c->places.id);
    t->balance = c->places.balance;
}

static err_t check_open(const struct collect *c)
{
    return c->places.n > 0 ? OK
                           : err_fail(ERR_ARG, "no session is open: a capture of a rig of one "
                                               "camera begins one (session.collect)");
}

static bool is_too_few(const struct collect *c)
{
    return c->places.n * c->cameras < PLACES_MIN;
}

err_t collect_scene(struct collect *c)
{
    const int n = c->places.n;
    err_t e = check_open(c);
    if (!e && is_too_few(c))
        e = err_fail(ERR_ARG, "%d place so far, a scene needs at least %d", n, PLACES_MIN);
    if (!e && !c->jobs)
        e = err_fail(ERR_ARG, "%d place%s so far; job.run is 0: nothing is reconstructed", n,
                     plural_s(n));
    return e ? e : jobs_add(c->jobs, c->places.id);
}

err_t collect_end(struct collect *c, bool later)
{
    const struct places p = c->places;
    const bool too_few = is_too_few(c);
    c->ending = later;
    if (later) {
        set_line(c, "ends when the running capture is stored");
        return OK;
    }
    err_t e = check_open(c);
    if (!e && c->jobs && !too_few) // before the end: a power cut between leaves both
        e = jobs_add(c->jobs, p.id);
    if (!e)
        e = places_end(c->store, p.id);
    if (e)
        return e;
    c->places = (struct places){0};
    if (too_few)
        set_line(c, "ended with %d place: no scene, which needs at least %d", p.n, PLACES_MIN);
    else
        set_line(c, "ended with %d place%s: %s", p.n, plural_s(p.n),
                 c->jobs ? "being reconstructed" : "job.run is 0, nothing is reconstructed");
    log_info("session %s %s", p.id, c->line);
    return OK;
}

void collect_write(const struct collect *c, FILE *out)
{
    fprintf(out, "{\"collect\": %s, \"id\": \"%s\", \"places\": %d, \"line\": ",
            c->on ? "true" : "false", c->places.id, c->places.n);
    json_put_string(out, c->line);
    fputs("}", out);
}
