/* Who is there, and whether a press would find all that it needs. */
#include "firmware/rig/conductor_inner.h"

#include <string.h>

struct conductor_member *conductor_members_find(struct conductor *c, const char *name)
{
    for (int i = 0; i < c->n; i++)
        if (strcmp(c->member[i].name, name) == 0)
            return &c->member[i];
    return NULL;
}

struct conductor_member *conductor_members_add(struct conductor *c, const char *name)
{
    if (c->n == MESSAGE_MEMBERS)
        return NULL;
    int at = c->n++;
    // those that are not listed by name, so that cameras keep their order
    for (; at > 0 && !c->member[at - 1].listed && strcmp(c->member[at - 1].name, name) > 0; at--)
        c->member[at] = c->member[at - 1];
    struct conductor_member *m = &c->member[at];
    *m = (struct conductor_member){0};
    snprintf(m->name, sizeof m->name, "%s", name);
    return m;
}

const struct message_hold *conductor_members_hold(const struct conductor_member *m,
                                                  const char *take)
{
    for (int i = 0; i < m->said.n_holds; i++)
        if (strcmp(m->said.hold[i].take, take) == 0)
            return &m->said.hold[i];
    return NULL;
}

bool conductor_members_belongs(const struct conductor *c, const struct conductor_member *m)
{
    return m->listed || !c->cfg.set->rig_member[0][0];
}

err_t conductor_members_check(const struct conductor *c, const struct conductor_member *m,
                              int64_t now_ns)
{
    const double skew_ms = c->cfg.set->bracket_skew_ms;
    if (!m->said.online && !m->since_ns)
        return err_fail(ERR_LOST, "%s is not there", m->name);
    if (!m->said.online)
        return err_fail(ERR_LOST, "%s is not there since %.0f s", m->name,
                        (double)(now_ns - m->since_ns) * 1e-9);
    if (strcmp(m->said.version, c->cfg.version) != 0)
        return err_fail(ERR_LOST, "%s runs hdrig %s, the conductor %s: install the same", m->name,
                        m->said.version, c->cfg.version);
    if (strcmp(m->said.epoch, c->cfg.epoch) != 0)
        return err_fail(ERR_LOST, "%s has not heard of this conductor yet", m->name);
    if (!m->said.ready)
        return err_fail(ERR_LOST, "%s: %s", m->name, m->said.sentence);
    if (!m->said.clock_known)
        return err_fail(ERR_LOST, "%s does not know the rig's time yet", m->name);
    if (skew_ms > 0 && (double)m->said.within_ns * 1e-6 > skew_ms / 2)
        return err_fail(ERR_LOST,
                        "%s knows the rig's time only within %.3g ms: bracket.skew_ms = %g needs "
                        "%.3g ms",
                        m->name, (double)m->said.within_ns * 1e-6, skew_ms, skew_ms / 2);
    return OK;
}

err_t conductor_members_check_all(const struct conductor *c, int64_t now_ns)
{
    int n = 0, cameras = 0;
    for (int i = 0; i < c->n; i++) {
        const struct conductor_member *m = &c->member[i];
        if (!conductor_members_belongs(c, m) ||
            (!m->said.online && !m->listed && c->cfg.set->rig_partial))
            continue;
        err_t e = conductor_members_check(c, m, now_ns);
        if (e && !c->cfg.set->rig_partial)
            return e;
        n += !e;
        cameras += e ? 0 : m->said.cameras;
    }
    if (!n)
        return err_fail(ERR_LOST, "no member of the rig is ready");
    if (cameras > MESSAGE_MEMBERS)
        return err_fail(ERR_LIMIT, "the rig has %d cameras, at most %d are possible", cameras,
                        MESSAGE_MEMBERS);
    return OK;
}

bool conductor_members_meters(const struct conductor *c, const char *name)
{
    const char *list = c->cfg.set->rig_meter;
    const size_t n = strlen(name);
    for (const char *p = list; (p = strstr(p, name)); p += n)
        if ((p == list || p[-1] == ' ') && (p[n] == ' ' || !p[n]))
            return true;
    return !list[0];
}

void conductor_members_gather(const struct conductor *c, struct conductor_take *t, int64_t now_ns)
{
    struct message_order *o = &t->order;
    int turn = 0;
    for (int i = 0; i < c->n; i++) {
        const struct conductor_member *m = &c->member[i];
        if (!conductor_members_belongs(c, m))
            continue;
        if (conductor_members_check(c, m, now_ns) != OK) {
            snprintf(t->reason, sizeof t->reason, "without %s", m->name);
            memcpy(t->out[t->n_out++], m->name, sizeof m->name);
            continue;
        }
        memcpy(o->member[o->n], m->name, sizeof m->name);
        o->turn[o->n++] = turn;
        turn += m->said.cameras;
    }
}
