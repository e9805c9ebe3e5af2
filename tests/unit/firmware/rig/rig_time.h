/* rig_time.h - what the world of rig_world.h is made of: its parts, chance, time. */
#ifndef RIG_RIG_TIME_H
#define RIG_RIG_TIME_H

#include "firmware/rig/conductor.h"
#include "firmware/rig/member.h"
#include "firmware/rig/rigclock.h"

#include <inttypes.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define MS INT64_C(1000000)
#define SECOND (1000 * MS)

enum { LEADER = MESSAGE_MEMBERS, NODES = MESSAGE_MEMBERS + 1, DISK_TAKES = 8192 };

struct part { // on a disk
    char take[TAKE_ID_CAP], id[TAKE_ID_CAP];
    int maker;                  // the truth: whose cameras made it,
    char shot_for[TAKE_ID_CAP]; // for which order,
    int64_t true_ns;            // and when, by the world's time
    int64_t common_ns, within_ns;
};

struct node {
    bool alive, linked, up; // runs; its network works; the broker has it
    int64_t life;           // events of former lives do nothing
    double drift;
    int64_t offset_ns;     // of its CLOCK_MONOTONIC
    struct member machine; // of members:
    char name[TAKE_MEMBER_CAP];
    struct rigclock clock;
    bool works;
    int64_t work; // events of former work do nothing
    int n_holds, n_parts;
    struct part hold[MESSAGE_HOLDS];
    char retained[512]; // by the broker: not used for the leader
    struct message_member said;
    bool has_said;
};

struct disk_take {
    struct message_order order;
    bool pending, dropped, committed, accepted;
    bool has[MESSAGE_MEMBERS];
    struct part part[MESSAGE_MEMBERS];
};

enum what { TO_MEMBER, TO_LEADER, WILL, LINK, START, WORK_DONE, TASK, BEAT };

struct happening {
    int64_t at_ns, order; // equal times in the order of their making
    enum what what;
    int node, from; // from: who sent it
    int64_t life, work;
    enum message_topic topic;
    union {
        struct message_conductor conductor;
        struct message_order order;
        struct message_member member;
        struct message_report report;
        struct message_time time;
        struct conductor_action task;
        struct part part;
    } u;
};

struct faults {
    double aborts, late, doubles; // shares of takes and messages
    double kills, cuts, brokers;  // a second: of each board, each link, the broker
    bool leader_dies;
    double loses; // a part, each second
};

struct world {
    int n;
    uint64_t random;
    struct faults faults;
    int64_t now_ns, made;
    struct config set;
    bool broker, gives_up;
    struct message_conductor presence; // retained
    bool has_presence;
    struct node node[NODES];
    struct conductor leader;
    int64_t tick_ns, number;
    int n_disk;
    struct disk_take *disk;
    int n_queue, cap_queue;
    struct happening **queue; // a heap
    int waits;                // presses without an outcome yet
    long presses, refused, joints, told, lost, kills, cuts, accepts, retakes, conflicts;
    char last[TAKE_TEXT], last_take[TAKE_ID_CAP];
    int64_t last_ns;
};

/* ---- chance and the queue ---- */

static double chance(struct world *w)
{
    uint64_t z = (w->random += UINT64_C(0x9e3779b97f4a7c15)); // splitmix64
    z = (z ^ (z >> 30)) * UINT64_C(0xbf58476d1ce4e5b9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94d049bb133111eb);
    return (double)((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

static int64_t between(struct world *w, double low_s, double high_s)
{
    return (int64_t)((low_s + (high_s - low_s) * chance(w)) * 1e9);
}

static bool earlier(const struct happening *a, const struct happening *b)
{
    return a->at_ns != b->at_ns ? a->at_ns < b->at_ns : a->order < b->order;
}

static struct happening *later(struct world *w, int64_t after_ns, enum what what, int node)
{
    struct happening *h = calloc(1, sizeof *h);
    assert_non_null(h);
    h->at_ns = w->now_ns + after_ns;
    h->order = w->made++;
    h->what = what;
    h->node = node;
    h->life = w->node[node].life;
    if (w->n_queue == w->cap_queue) {
        w->cap_queue = 2 * w->cap_queue + 64;
        w->queue = realloc(w->queue, (size_t)w->cap_queue * sizeof(struct happening *));
        assert_non_null(w->queue);
    }
    int i = w->n_queue++;
    for (; i > 0 && earlier(h, w->queue[(i - 1) / 2]); i = (i - 1) / 2)
        w->queue[i] = w->queue[(i - 1) / 2];
    w->queue[i] = h;
    return h;
}

static struct happening *pop(struct world *w)
{
    struct happening *top = w->queue[0], *x = w->queue[--w->n_queue];
    int i = 0;
    for (int k; (k = 2 * i + 1) < w->n_queue; i = k) {
        k += k + 1 < w->n_queue && earlier(w->queue[k + 1], w->queue[k]);
        if (!earlier(w->queue[k], x))
            break;
        w->queue[i] = w->queue[k];
    }
    w->queue[i] = x;
    return top;
}

/* ---- clocks ---- */

static int64_t mono(const struct world *w, int k)
{
    const struct node *n = &w->node[k];
    return w->now_ns + (int64_t)((double)w->now_ns * n->drift) + n->offset_ns;
}

static int64_t common(const struct world *w)
{
    return mono(w, LEADER) + w->leader.cfg.common_ns;
}

#endif
