#include "firmware/daemon/triggers.h"

#include "core/base/log.h"

#include <stdlib.h>

enum { RETRY_S = 2 }; // for missing devices

struct source {
    const struct trigger_ops *ops; // NULL: not set
    const char *uri;
    void *st;
    bool open, told; // told: its absence is in the log
    int64_t retry_ns;
};

struct triggers {
    struct triggers_config cfg;
    struct source source[CONFIG_TRIGGERS];
    int64_t press_ns; // the last one that was not dropped
    struct triggers_count count;
};

err_t triggers_open(const struct triggers_config *cfg, struct triggers **out)
{
    struct triggers *t = calloc(1, sizeof *t);
    err_t e = t ? OK : err_fail(ERR_NOMEM, "triggers: no memory");
    *out = NULL;
    if (t) {
        t->cfg = *cfg;
        t->press_ns = INT64_MIN / 2;
    }
    for (int i = 0; i < CONFIG_TRIGGERS && !e; i++) {
        struct source *s = &t->source[i];
        s->uri = cfg->uri[i];
        if (!*s->uri)
            continue;
        e = cfg->find(s->uri, &s->ops);
        if (!e && !(s->st = malloc(s->ops->state_bytes)))
            e = err_fail(ERR_NOMEM, "trigger.%d: no memory", i + 1);
    }
    if (e) {
        triggers_close(t);
        return e;
    }
    *out = t;
    return OK;
}

void triggers_close(struct triggers *t)
{
    for (int i = 0; t && i < CONFIG_TRIGGERS; i++) {
        if (t->source[i].open)
            t->source[i].ops->close(t->source[i].st);
        free(t->source[i].st);
    }
    free(t);
}

int triggers_poll(const struct triggers *t, struct pollfd *fds, int cap)
{
    int n = 0;
    for (int i = 0; i < CONFIG_TRIGGERS && n < cap; i++)
        if (t->source[i].open)
            fds[n++] =
                (struct pollfd){.fd = t->source[i].ops->fd(t->source[i].st), .events = POLLIN};
    return n;
}

/* err: ERR_ARG: a retry does not help. */
static err_t open_source(const struct triggers *t, struct source *s, int64_t now)
{
    if (!s->ops || s->open || now < s->retry_ns)
        return OK;
    s->retry_ns = now + RETRY_S * INT64_C(1000000000);
    err_t e = s->ops->open(s->st, s->uri);
    s->open = e == OK;
    if (e == ERR_ARG)
        return e;
    if (!e && t->cfg.hold_ms > 0 && s->ops->lengths)
        s->ops->lengths(s->st);
    if (e && !s->told)
        log_warn("trigger %s: %s; trying again", s->uri, err_text());
    if (!e && s->told)
        log_info("trigger %s: available again", s->uri);
    s->told = !s->open;
    return OK;
}

static void read_source(struct triggers *t, struct source *s)
{
    struct trigger_event ev;
    err_t e = OK;
    while (s->open && (e = s->ops->next(s->st, &ev)) == OK) {
        t->count.lost_edges += ev.lost;
        if (ev.lost)
            log_warn("trigger %s: the kernel lost %u edges", s->uri, ev.lost);
        if (ev.time_ns - t->press_ns < t->cfg.lockout_ms * INT64_C(1000000)) {
            t->count.locked_out++;
            continue;
        }
        t->press_ns = ev.time_ns;
        t->cfg.press(t->cfg.ctx, ev.time_ns,
                     t->cfg.hold_ms > 0 && ev.held_ns >= t->cfg.hold_ms * INT64_C(1000000));
    }
    if (e == ERR_IO)
        log_warn("trigger %s: %s", s->uri, err_text());
    if (e == ERR_LOST) {
        log_warn("trigger %s: %s", s->uri, err_text());
        s->ops->close(s->st);
        s->open = false;
        s->told = true;
    }
}

err_t triggers_step(struct triggers *t, int64_t now_ns)
{
    err_t e = OK;
    for (int i = 0; !e && i < CONFIG_TRIGGERS; i++) {
        e = open_source(t, &t->source[i], now_ns);
        read_source(t, &t->source[i]);
    }
    return e;
}

void triggers_look(const struct triggers *t, struct triggers_count *out)
{
    *out = t->count;
}
