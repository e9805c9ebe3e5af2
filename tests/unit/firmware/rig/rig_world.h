/* rig_world.h - a rig of boards, a broker and their faults in virtual time: the machines of
 * member.h and conductor.h, with everything around them invented. Truths that must hold are checked
 * where they could break. */
#ifndef RIG_RIG_WORLD_H
#define RIG_RIG_WORLD_H

#include "tests/unit/firmware/rig/rig_time.h"

/* ---- the broker ---- */

/* A message on its way: QoS 1 may come twice. The sender must be connected. */
static struct happening *send(struct world *w, int from, int to, enum message_topic t)
{
    if (!w->node[from].up || !w->node[to].up)
        return NULL;
    struct happening *h = later(w, between(w, 0.0003, chance(w) < 0.05 ? 0.1 : 0.003),
                                to == LEADER ? TO_LEADER : TO_MEMBER, to);
    h->from = from;
    h->topic = t;
    return h;
}

static void send_twice(struct world *w, const struct happening *h)
{
    if (!h || chance(w) >= w->faults.doubles)
        return;
    struct happening *again = later(w, between(w, 0.001, 2), h->what, h->node);
    const int64_t at = again->at_ns, order = again->order;
    *again = *h;
    again->at_ns = at;
    again->order = order;
}

static void link_up(struct world *w, int k);

/* ---- members ---- */

static void say(struct world *w, int k)
{
    struct node *n = &w->node[k];
    struct message_member m = {.online = true, .cameras = 1, .ready = !n->works};
    struct rigclock_state c;
    snprintf(m.boot, sizeof m.boot, "%08" PRIx64, (uint64_t)n->life);
    strcpy(m.version, "1");
    strcpy(m.sentence, "works");
    memcpy(m.epoch, n->machine.epoch, sizeof m.epoch);
    m.clock_known = rigclock_read(&n->clock, mono(w, k), &c);
    m.within_ns = c.within_ns;
    m.serial = n->machine.order.serial;
    m.n_holds = n->machine.n_holds;
    memcpy(m.hold, n->machine.hold, sizeof m.hold);
    n->said = m;
    n->has_said = true;
    struct happening *h = send(w, k, LEADER, MESSAGE_MEMBER);
    if (h)
        h->u.member = m;
}

static void member_holds(struct world *w, int k)
{
    struct node *n = &w->node[k];
    struct message_hold hold[MESSAGE_HOLDS];
    for (int i = 0; i < n->n_holds; i++) {
        memcpy(hold[i].take, n->hold[i].take, TAKE_ID_CAP);
        memcpy(hold[i].part, n->hold[i].id, TAKE_ID_CAP);
    }
    member_event(&n->machine,
                 &(struct member_event){.kind = MEMBER_HOLDS, .hold = hold, .n_holds = n->n_holds});
}

static struct disk_take *disk_find(struct world *w, const char *id)
{
    for (int i = w->n_disk - 1; i >= 0; i--)
        if (strcmp(w->disk[i].order.take, id) == 0)
            return &w->disk[i];
    return NULL;
}

/* Parts go only when the conductor has them, or noted that nobody wants them. */
static void member_release(struct world *w, int k, const char *take)
{
    struct node *n = &w->node[k];
    for (int i = 0; i < n->n_holds; i++) {
        if (strcmp(n->hold[i].take, take) != 0)
            continue;
        const struct disk_take *d = disk_find(w, take);
        const int at = d ? message_find(&d->order, n->name) : -1;
        assert_true(at >= 0);
        assert_true((d->committed && d->has[at]) || d->dropped || w->gives_up);
        n->hold[i--] = n->hold[--n->n_holds];
    }
    member_holds(w, k);
}

/* The frames of a take begin when the member believes that the start has come. */
static void member_shoot(struct world *w, int k)
{
    struct node *n = &w->node[k];
    const struct message_order *o = &n->machine.order;
    struct rigclock_state c;
    assert_true(rigclock_read(&n->clock, mono(w, k), &c));
    double sum = 0.3;
    for (int i = 0; i < o->n_times; i++)
        sum += o->time_s[i];
    const int64_t wait = o->start_ns - c.offset_ns - mono(w, k);
    const int64_t begin = (wait > 0 ? wait : 0) + between(w, -0.016, 0.016) +
                          (chance(w) < w->faults.late ? SECOND : 0);
    struct happening *h = later(w, begin + (int64_t)(sum * 1e9) + between(w, 0.1, 2), WORK_DONE, k);
    h->work = ++n->work;
    h->u.part = (struct part){.maker = k, .true_ns = w->now_ns + begin};
    memcpy(h->u.part.take, o->take, TAKE_ID_CAP);
    memcpy(h->u.part.shot_for, o->take, TAKE_ID_CAP);
    h->u.part.common_ns = mono(w, k) + begin + c.offset_ns;
    h->u.part.within_ns = c.within_ns;
    n->works = true;
}

static void member_meter(struct world *w, int k)
{
    struct node *n = &w->node[k];
    struct happening *h = later(w, between(w, 0.2, 1), WORK_DONE, k);
    h->work = ++n->work;
    n->works = true;
}

static void member_stop(struct world *w, int k)
{
    struct node *n = &w->node[k];
    struct message_report r = {.reason = "cancelled"};
    n->works = false;
    n->work++;
    member_event(&n->machine, &(struct member_event){.kind = MEMBER_FAILED, .report = &r});
}

static void member_act(struct world *w, int k)
{
    struct node *n = &w->node[k];
    struct member_action a;
    while (member_action(&n->machine, &a)) {
        struct happening *h;
        switch (a.kind) {
        case MEMBER_ANNOUNCE:
            say(w, k);
            break;
        case MEMBER_METER:
            member_meter(w, k);
            break;
        case MEMBER_SHOOT:
            member_shoot(w, k);
            break;
        case MEMBER_STOP:
            member_stop(w, k);
            break;
        case MEMBER_RELEASE:
            member_release(w, k, a.take);
            break;
        case MEMBER_REPORT:
            h = send(w, k, LEADER, MESSAGE_REPORT);
            if (h)
                h->u.report = n->machine.report;
            send_twice(w, h);
            break;
        }
    }
}

static void work_done(struct world *w, const struct happening *h)
{
    struct node *n = &w->node[h->node];
    struct message_report r = {.n_cameras = 1, .meter = {{2, {0.001, 0.016}}}};
    struct member_event ev = {.kind = MEMBER_METERED, .report = &r};
    if (!n->works || h->work != n->work)
        return;
    n->works = false;
    const bool shot = h->u.part.take[0] != 0;
    if (shot && (chance(w) < w->faults.aborts || n->n_holds == MESSAGE_HOLDS)) {
        ev.kind = MEMBER_FAILED;
        strcpy(r.reason, "the light changed");
    } else if (shot) {
        struct part *p = &n->hold[n->n_holds++];
        *p = h->u.part;
        snprintf(p->id, sizeof p->id, "%08x-%06d", 0xabc000 + h->node, ++n->n_parts);
        ev.kind = MEMBER_STORED;
        memcpy(r.part, p->id, sizeof r.part);
        r.n_starts = 1;
        r.start[0] = (struct message_start){0, 0, p->common_ns, p->within_ns};
        member_holds(w, h->node);
    }
    member_event(&n->machine, &ev);
    member_act(w, h->node);
}

static void ask_time(struct world *w, int k)
{
    struct happening *h = send(w, k, LEADER, MESSAGE_ASK);
    if (h)
        h->u.time = (struct message_time){.sent_ns = mono(w, k)};
}

static void to_member(struct world *w, struct happening *h)
{
    struct node *n = &w->node[h->node];
    struct member_event ev = {.kind = MEMBER_ORDER, .order = &h->u.order};
    struct rigclock_state c;
    if (!n->up)
        return;
    if (h->topic == MESSAGE_TIME) {
        const struct message_time *t = &h->u.time;
        if (strcmp(t->epoch, n->machine.epoch) == 0)
            rigclock_exchange(&n->clock, t->sent_ns, t->got_ns, t->replied_ns, mono(w, h->node));
        return;
    }
    if (h->topic == MESSAGE_CONDUCTOR) {
        ev.kind = MEMBER_CONDUCTOR;
        ev.conductor = &h->u.conductor;
        if (strcmp(ev.conductor->epoch, n->machine.epoch) != 0)
            n->clock = (struct rigclock){0};
    }
    ev.common_known = rigclock_read(&n->clock, mono(w, h->node), &c);
    ev.common_ns = mono(w, h->node) + c.offset_ns;
    member_event(&n->machine, &ev);
    member_act(w, h->node);
    if (h->topic == MESSAGE_CONDUCTOR)
        ask_time(w, h->node);
}

/* ---- the conductor ---- */

static bool leader_has(void *ctx, const char *take, const char *member)
{
    const struct disk_take *d = disk_find(ctx, take);
    const int at = d ? message_find(&d->order, member) : -1;
    return at >= 0 && d->committed && d->has[at];
}

static err_t leader_event(struct world *w, struct conductor_event ev);

static void publish_order(struct world *w, const struct message_order *o)
{
    for (int k = 0; k < w->n; k++) {
        struct happening *h = send(w, LEADER, k, MESSAGE_ORDER);
        if (h)
            h->u.order = *o;
        send_twice(w, h);
    }
}

static void publish_presence(struct world *w, const struct message_conductor *c)
{
    w->presence = *c;
    w->has_presence = true;
    for (int k = 0; k < NODES; k++) {
        if (k >= w->n && k != LEADER)
            continue;
        struct happening *h = send(w, LEADER, k, MESSAGE_CONDUCTOR);
        if (h)
            h->u.conductor = *c;
    }
}

/* Every press has one outcome. */
static void tell_outcome(struct world *w, const struct conductor_action *a)
{
    memcpy(w->last, a->text, sizeof w->last);
    memcpy(w->last_take, a->take, sizeof w->last_take);
    w->last_ns = w->now_ns;
    if (a->asked) {
        assert_true(w->waits > 0);
        w->waits--;
        w->told++;
        assert_true(a->err == OK || a->text[0]);
    }
    w->joints += a->err == OK;
    if (getenv("DBG"))
        printf("%.3f tell %d asked %d %s: %s\n", (double)w->now_ns * 1e-9, a->err, a->asked,
               a->take, a->text);
}

static void leader_act(struct world *w)
{
    static struct conductor_action a;
    while (conductor_action(&w->leader, &a)) {
        struct happening *h;
        switch (a.kind) {
        case CONDUCTOR_CLAIM: {
            struct message_conductor c = {.online = true, .board = "leader", .version = "1"};
            memcpy(c.epoch, w->leader.cfg.epoch, sizeof c.epoch);
            publish_presence(w, &c);
            break;
        }
        case CONDUCTOR_ORDER:
            publish_order(w, &a.order);
            break;
        case CONDUCTOR_TELL:
            tell_outcome(w, &a);
            break;
        case CONDUCTOR_REMOVE:
            break;
        default:
            h = later(w, between(w, 0.005, a.kind == CONDUCTOR_FETCH ? 0.6 : 0.05), TASK, LEADER);
            h->u.task = a;
            break;
        }
    }
}

static void fetch(struct world *w, struct disk_take *d, const struct conductor_action *a,
                  struct conductor_event *ev, struct message_report *r)
{
    const int at = message_find(&d->order, a->name);
    ev->err = ERR_TIMEOUT;
    ev->text = "no answer";
    for (int k = 0; k < w->n; k++) {
        struct node *n = &w->node[k];
        if (strcmp(n->name, a->name) != 0 || !n->alive || !n->linked || !w->node[LEADER].linked)
            continue;
        ev->err = ERR_FORMAT;
        ev->text = "no such part";
        for (int i = 0; i < n->n_holds; i++) {
            if (strcmp(n->hold[i].id, a->part.part) != 0)
                continue;
            d->part[at] = n->hold[i];
            d->has[at] = true;
            ev->err = OK;
            r->n_starts = 1;
            r->start[0] = (struct message_start){0, 0, n->hold[i].common_ns, n->hold[i].within_ns};
        }
    }
}

/* All that a joint take must be. */
static void check_joint(struct world *w, const struct disk_take *d, const struct message_order *o)
{
    int64_t low = INT64_MAX, high = INT64_MIN;
    assert_false(d->committed);
    assert_false(d->dropped);
    if (!w->set.rig_partial && !d->accepted)
        assert_int_equal(o->n, d->order.n);
    for (int i = 0; i < o->n; i++) {
        const int at = message_find(&d->order, o->member[i]);
        assert_true(at >= 0 && d->has[at]);
        const struct part *p = &d->part[at];
        assert_string_equal(p->take, d->order.take);
        assert_string_equal(p->shot_for, d->order.take);
        assert_string_equal(w->node[p->maker].name, o->member[i]);
        low = p->true_ns < low ? p->true_ns : low;
        high = p->true_ns > high ? p->true_ns : high;
    }
    if (w->set.bracket_skew_ms) // within what the clocks say of themselves
        assert_true(high - low < (w->set.bracket_skew_ms + 20) * MS);
}

/* A part that was lost is no reason to drop those of others. */
static void check_drop(const struct world *w, const char *take)
{
    const char *why = "";
    for (int i = 0; i < CONDUCTOR_TAKES; i++)
        if (w->leader.take[i].phase == TAKE_DROPPING &&
            strcmp(w->leader.take[i].order.take, take) == 0)
            why = w->leader.take[i].reason;
    if (!strstr(why, "lost its part") && !strstr(why, "was started again"))
        return;
    for (int k = 0; k < w->n; k++)
        for (int i = 0; i < w->node[k].n_holds; i++)
            assert_string_not_equal(w->node[k].hold[i].take, take);
}

static void do_task(struct world *w, const struct happening *h)
{
    const struct conductor_action *a = &h->u.task;
    struct message_report r = {0};
    char id[TAKE_ID_CAP];
    struct conductor_event ev = {.take = a->take,
                                 .name = a->name,
                                 .order = &a->order,
                                 .report = &r,
                                 .text = "the disk is full"};
    struct disk_take *d = disk_find(w, a->take);
    const bool fails = a->kind != CONDUCTOR_CLEAR && chance(w) < w->faults.aborts / 4;
    ev.err = fails ? ERR_LIMIT : OK;
    switch (a->kind) {
    case CONDUCTOR_RECORD:
        ev.kind = CONDUCTOR_RECORDED;
        snprintf(id, sizeof id, "0123abcd-%06" PRId64, ++w->number);
        ev.take = id;
        if (fails)
            break;
        assert_true(w->n_disk < DISK_TAKES);
        d = &w->disk[w->n_disk++];
        *d = (struct disk_take){.order = a->order, .pending = true};
        memcpy(d->order.take, id, sizeof id);
        break;
    case CONDUCTOR_FETCH:
        ev.kind = CONDUCTOR_FETCHED;
        fetch(w, d, a, &ev, &r);
        break;
    case CONDUCTOR_JOIN:
        ev.kind = CONDUCTOR_JOINED;
        if (fails)
            break;
        check_joint(w, d, &a->order);
        d->committed = true;
        d->pending = false;
        break;
    case CONDUCTOR_DROP:
        ev.kind = CONDUCTOR_DROPPED;
        check_drop(w, a->take);
        d->dropped = !fails;
        break;
    default:
        d->pending = false;
        d->dropped = true; // nobody wants it
        return;
    }
    if (w->node[LEADER].alive && h->life == w->node[LEADER].life)
        leader_event(w, ev);
}

static err_t leader_event(struct world *w, struct conductor_event ev)
{
    ev.now_ns = mono(w, LEADER);
    err_t e = conductor_event(&w->leader, &ev);
    leader_act(w);
    return e;
}

static void to_leader(struct world *w, const struct happening *h)
{
    struct conductor_event ev = {.name = h->from == LEADER ? NULL : w->node[h->from].name};
    struct happening *x;
    if (!w->node[LEADER].up)
        return;
    switch (h->topic) {
    case MESSAGE_CONDUCTOR:
        ev.kind = CONDUCTOR_OTHER;
        ev.conductor = &h->u.conductor;
        break;
    case MESSAGE_MEMBER:
        ev.kind = CONDUCTOR_MEMBER;
        ev.member = &h->u.member;
        break;
    case MESSAGE_REPORT:
        ev.kind = CONDUCTOR_REPORT;
        ev.report = &h->u.report;
        break;
    default:
        x = send(w, LEADER, h->from, MESSAGE_TIME);
        if (x && w->leader.state == CONDUCTOR_LEADS) {
            x->u.time = h->u.time;
            x->u.time.got_ns = x->u.time.replied_ns = common(w);
            memcpy(x->u.time.epoch, w->leader.cfg.epoch, sizeof x->u.time.epoch);
        }
        return;
    }
    err_t e = leader_event(w, ev);
    assert_int_equal(e, OK);
}

static void leader_start(struct world *w)
{
    struct conductor_config cfg = {
        .set = &w->set, .board = "leader", .version = "1", .has = leader_has, .ctx = w};
    snprintf(cfg.epoch, sizeof cfg.epoch, "%016" PRIx64, (uint64_t)w->now_ns + 1);
    cfg.common_ns = w->now_ns + 1000 * SECOND - mono(w, LEADER);
    assert_int_equal(conductor_init(&w->leader, &cfg), OK);
    for (int i = 0; i < w->n_disk; i++) {
        if (!w->disk[i].pending)
            continue;
        struct message_order o = w->disk[i].order;
        o.kind = w->disk[i].dropped ? MESSAGE_RELEASE : MESSAGE_SHOOT;
        err_t e = leader_event(w, (struct conductor_event){.kind = CONDUCTOR_MEMORY, .order = &o});
        assert_int_equal(e, OK);
    }
}

/* ---- faults ---- */

static void node_start(struct world *w, int k)
{
    struct node *n = &w->node[k];
    n->alive = true;
    n->life++;
    n->works = false;
    n->offset_ns = between(w, 0, 1e6); // another boot, another monotonic clock
    if (k == LEADER) {
        leader_start(w);
    } else {
        member_init(&n->machine, n->name);
        n->clock = (struct rigclock){0};
        member_holds(w, k);
    }
    link_up(w, k);
}

static void link_up(struct world *w, int k)
{
    later(w, between(w, 0.05, 0.5), LINK, k);
}

/* The connection is there: presence and states that the broker has retained come. */
static void connect(struct world *w, int k)
{
    struct node *n = &w->node[k];
    if (n->up || !n->alive || !n->linked || !w->broker)
        return;
    n->up = true;
    if (k != LEADER) {
        member_event(&n->machine, &(struct member_event){.kind = MEMBER_UP});
        member_act(w, k);
    } else {
        err_t e = leader_event(w, (struct conductor_event){.kind = CONDUCTOR_UP});
        assert_int_equal(e, OK);
        for (int i = 0; i < w->n; i++) {
            struct happening *h = w->node[i].has_said ? later(w, MS, TO_LEADER, LEADER) : NULL;
            if (h) {
                h->from = i;
                h->topic = MESSAGE_MEMBER;
                h->u.member = w->node[i].said;
            }
        }
    }
    if (w->has_presence) {
        struct happening *h = later(w, MS, k == LEADER ? TO_LEADER : TO_MEMBER, k);
        h->from = LEADER;
        h->topic = MESSAGE_CONDUCTOR;
        h->u.conductor = w->presence;
    }
}

/* The broker has noticed that a node is gone: its will. */
static void offline(struct world *w, int k)
{
    struct node *n = &w->node[k];
    n->up = false;
    if (k == LEADER && w->has_presence && w->presence.online) {
        struct message_conductor c = w->presence;
        c.online = false;
        w->presence = c;
        for (int i = 0; i < w->n; i++)
            if (w->node[i].up) {
                struct happening *h = later(w, MS, TO_MEMBER, i);
                h->from = LEADER;
                h->topic = MESSAGE_CONDUCTOR;
                h->u.conductor = c;
            }
    } else if (k != LEADER) {
        n->said.online = false;
        struct happening *h = w->node[LEADER].up ? later(w, MS, TO_LEADER, LEADER) : NULL;
        if (h) {
            h->from = k;
            h->topic = MESSAGE_MEMBER;
            h->u.member = n->said;
        }
    }
}

static void notice_down(struct world *w, int k)
{
    struct node *n = &w->node[k];
    if (!n->alive)
        return;
    if (k != LEADER)
        member_event(&n->machine, &(struct member_event){.kind = MEMBER_DOWN});
    else
        assert_int_equal(leader_event(w, (struct conductor_event){.kind = CONDUCTOR_DOWN}), OK);
}

static void kill_node(struct world *w, int k, double down_s)
{
    struct node *n = &w->node[k];
    if (!n->alive)
        return;
    w->kills++;
    n->alive = false;
    n->life++;
    if (k == LEADER) {
        w->lost += w->waits;
        w->waits = 0;
    }
    later(w, chance(w) < 0.5 ? MS : 7 * SECOND, WILL, k)->work = -1;
    n->up = false;
    later(w, (int64_t)(down_s * 1e9), START, k);
}

static void cut_link(struct world *w, int k, double down_s)
{
    struct node *n = &w->node[k];
    if (!n->linked)
        return;
    w->cuts++;
    n->linked = false;
    if (n->up) {
        n->up = false;
        notice_down(w, k);
        later(w, 7 * SECOND, WILL, k)->work = -1;
    }
    later(w, (int64_t)(down_s * 1e9), LINK, k)->work = 1;
}

static void stop_broker(struct world *w, double down_s)
{
    w->broker = false;
    w->has_presence = false;
    for (int k = 0; k < NODES; k++) {
        w->node[k].has_said = false;
        if (w->node[k].up) {
            w->node[k].up = false;
            notice_down(w, k);
        }
    }
    later(w, (int64_t)(down_s * 1e9), LINK, LEADER)->work = 2;
}

static void on_link(struct world *w, const struct happening *h)
{
    struct node *n = &w->node[h->node];
    if (h->work == 2) {
        w->broker = true;
        for (int k = 0; k < NODES; k++)
            if (w->node[k].alive)
                link_up(w, k);
        return;
    }
    if (h->work == 1) {
        n->linked = true;
        link_up(w, h->node);
        return;
    }
    connect(w, h->node);
}

/* Once a second of the world: heartbeats, faults. */
static void beat(struct world *w)
{
    for (int k = 0; k < NODES; k++) {
        struct node *n = &w->node[k];
        if ((k >= w->n && k != LEADER) || !n->alive)
            continue;
        if (n->up && k != LEADER && n->machine.led) {
            ask_time(w, k);
            say(w, k);
        }
        if (n->linked && !n->up && w->broker)
            link_up(w, k);
        if ((k != LEADER || w->faults.leader_dies) && chance(w) < w->faults.kills)
            kill_node(w, k, 1 + 20 * chance(w));
        if (k != LEADER && n->n_holds && w->faults.loses > 0 && chance(w) < w->faults.loses) {
            n->n_holds--; // the last of its parts is gone
            member_holds(w, k);
        }
        if (chance(w) < w->faults.cuts)
            cut_link(w, k, 0.1 + 30 * chance(w) * chance(w));
    }
    if (w->broker && chance(w) < w->faults.brokers)
        stop_broker(w, 0.5 + 5 * chance(w));
    if (w->node[LEADER].alive)
        leader_event(w, (struct conductor_event){.kind = CONDUCTOR_TICK});
    later(w, SECOND, BEAT, LEADER);
}

static void happen(struct world *w, struct happening *h)
{
    const bool same_life = h->life == w->node[h->node].life;
    switch (h->what) {
    case TO_MEMBER:
        if (same_life)
            to_member(w, h);
        break;
    case TO_LEADER:
        if (same_life)
            to_leader(w, h);
        break;
    case WILL:
        if (!w->node[h->node].up && w->broker)
            offline(w, h->node);
        break;
    case LINK:
        on_link(w, h);
        break;
    case START:
        if (!w->node[h->node].alive)
            node_start(w, h->node);
        break;
    case WORK_DONE:
        if (same_life)
            work_done(w, h);
        break;
    case TASK:
        // half of what was under way when the process died reached the disk
        if (same_life || chance(w) < 0.5)
            do_task(w, h);
        break;
    case BEAT:
        beat(w);
        break;
    }
}

static void world_run(struct world *w, double seconds)
{
    const int64_t until = w->now_ns + (int64_t)(seconds * 1e9);
    while (w->n_queue && w->queue[0]->at_ns <= until) {
        struct happening *h = pop(w);
        w->now_ns = h->at_ns;
        happen(w, h);
        free(h);
    }
    w->now_ns = until;
}

static struct world *world_open(int members, uint64_t seed)
{
    struct world *w = calloc(1, sizeof *w);
    assert_non_null(w);
    w->n = members;
    w->random = seed;
    w->broker = true;
    w->number = 100;
    config_defaults(&w->set);
    w->disk = calloc(DISK_TAKES, sizeof *w->disk);
    assert_non_null(w->disk);
    for (int k = 0; k < members; k++) {
        snprintf(w->node[k].name, sizeof w->node[k].name, "board-%02d", k);
        snprintf(w->set.rig_member[k], CONFIG_TEXT, "board-%02d", k);
    }
    for (int k = 0; k < NODES; k++) {
        w->node[k].linked = true;
        w->node[k].drift = (chance(w) - 0.5) * 90e-6;
        if (k < members || k == LEADER)
            node_start(w, k);
    }
    later(w, SECOND, BEAT, LEADER);
    return w;
}

static void world_close(struct world *w)
{
    while (w->n_queue)
        free(pop(w));
    free(w->queue);
    free(w->disk);
    free(w);
}

/* A press now; false: refused, with err_text(). */
static bool world_press(struct world *w)
{
    w->presses++;
    struct conductor_event ev = {.kind = CONDUCTOR_PRESS, .asked = true};
    if (!w->node[LEADER].alive)
        return false;
    ev.now_ns = mono(w, LEADER);
    if (conductor_event(&w->leader, &ev) != OK) {
        w->refused++;
        return false;
    }
    w->waits++;
    leader_act(w);
    return true;
}

static void world_heal(struct world *w)
{
    w->faults = (struct faults){0};
}

static int open_takes(const struct world *w)
{
    int n = 0;
    for (int i = 0; i < CONDUCTOR_TAKES; i++)
        n += w->leader.take[i].phase != TAKE_FREE;
    return n;
}

static int open_holds(const struct world *w)
{
    int n = 0;
    for (int k = 0; k < w->n; k++)
        n += w->node[k].n_holds;
    return n;
}

#endif
