#include "firmware/rig/boards_status.h"

#include "firmware/rig/boards_inner.h"

#include "drivers/device/clocks.h"
#include "drivers/format/json.h"

static const char *state_word(const struct boards *b)
{
    static const char *const words[] = {[CONDUCTOR_OFF] = "off",
                                        [CONDUCTOR_LISTEN] = "listens",
                                        [CONDUCTOR_LEADS] = "leads",
                                        [CONDUCTOR_REFUSED] = "refused"};
    if (b->has_conductor)
        return words[b->conductor.state];
    return !b->member.up ? "off" : b->member.led ? "led" : "alone";
}

static void put_truth(FILE *f, const char *key, bool v)
{
    fprintf(f, "\"%s\": %s, ", key, v ? "true" : "false");
}

static void put_members(const struct conductor *c, FILE *f)
{
    const int64_t now = clocks_now();
    fputs(", \"members\": [", f);
    for (int i = 0; i < c->n; i++) {
        const struct conductor_member *m = &c->member[i];
        fprintf(f, "%s{\"name\": \"%s\", ", i ? ", " : "", m->name);
        put_truth(f, "listed", m->listed);
        put_truth(f, "online", m->said.online);
        put_truth(f, "ready", m->said.online && m->said.ready);
        fputs("\"address\": ", f);
        json_put_string(f, m->said.host);
        fputs(", \"sentence\": ", f);
        json_put_string(f, m->said.online ? m->said.sentence : "is not there");
        fprintf(f,
                ", \"version\": \"%s\", \"cameras\": %d, \"free_mb\": %.0f, \"clock\": \"%s\", "
                "\"within_ms\": %.3f, \"holds\": %d, \"since_s\": %.1f}",
                m->said.version, m->said.cameras, m->said.free_mb, m->said.clock,
                (double)m->said.within_ns * 1e-6, m->said.n_holds,
                m->since_ns ? (double)(now - m->since_ns) * 1e-9 : 0.0);
    }
    fputs("]", f);
}

static void put_take(const struct conductor *c, const struct conductor_take *t, FILE *f)
{
    char choice[TAKE_TEXT];
    static const char *const phases[] = {"free",      "metering", "recording", "shooting",
                                         "gathering", "joining",  "dropping",  "dropped"};
    static const char *const parts[] = {"waits", "stored", "fetching", "fetched", "failed", "gone"};
    fprintf(f, "{\"id\": \"%s\", \"phase\": \"%s\", \"reason\": ", t->order.take, phases[t->phase]);
    json_put_string(f, t->reason);
    fputs(", \"choice\": ", f);
    json_put_string(f, conductor_parts_choice(c, t, choice) ? choice : "");
    fputs(", \"parts\": [", f);
    for (int k = 0; k < t->order.n; k++) {
        fprintf(f, "%s{\"name\": \"%s\", \"state\": \"%s\", \"why\": ", k ? ", " : "",
                t->order.member[k], parts[t->part[k]]);
        json_put_string(f, t->why[k]);
        fputs("}", f);
    }
    fputs("]}", f);
}

static void put_takes(const struct conductor *c, FILE *f)
{
    bool any = false;
    fputs(", \"takes\": [", f);
    for (int i = 0; i < CONDUCTOR_TAKES; i++) {
        if (c->take[i].phase == TAKE_FREE)
            continue;
        fputs(any ? ", " : "", f);
        put_take(c, &c->take[i], f);
        any = true;
    }
    fputs("]", f);
}

/* Starts of each exposure, ms from their mean. */
static void put_starts(const struct conductor_starts *l, int exposures, FILE *f)
{
    fputs(", \"starts\": [", f);
    for (int x = 0; x < exposures; x++) {
        int64_t base = 0;
        double mean = 0;
        int n = 0;
        for (int i = 0; i < l->n; i++)
            if (l->v[i].index == x) {
                base = n ? base : l->v[i].common_ns;
                mean += (double)(l->v[i].common_ns - base);
                n++;
            }
        mean /= n > 0 ? n : 1;
        fputs(x ? ", [" : "[", f);
        for (int i = 0, k = 0; i < l->n; i++)
            if (l->v[i].index == x)
                fprintf(f, "%s{\"name\": \"%s\", \"camera\": %d, \"ms\": %.3f}", k++ ? ", " : "",
                        l->v[i].member, l->v[i].camera,
                        ((double)(l->v[i].common_ns - base) - mean) * 1e-6);
        fputs("]", f);
    }
    fputs("]", f);
}

static void put_last(const struct conductor *c, FILE *f)
{
    const struct conductor_last *l = &c->last;
    fprintf(f, ", \"last\": {\"id\": \"%s\", \"ok\": %s, \"sentence\": ", l->take,
            l->err ? "false" : "true");
    json_put_string(f, l->text);
    fputs(", \"skew_ms\": [", f);
    for (int i = 0; i < l->n; i++)
        fprintf(f, "%s%.3f", i ? ", " : "", (double)l->apart_ns[i] * 1e-6);
    fprintf(f, "], \"within_ms\": %.3f", (double)l->within_ns * 1e-6);
    if (c->starts.serial == l->serial)
        put_starts(&c->starts, l->n, f);
    fputs("}", f);
}

/* Cameras of a joint take are those of its boards in their order. */
static void put_views(const struct boards *b, FILE *f)
{
    int camera = 0;
    bool any = false;
    fputs(", \"views\": [", f);
    for (int i = 0; i < b->conductor.n; i++) {
        const struct conductor_member *m = &b->conductor.member[i];
        for (int k = 0; k < m->said.cameras && camera < MESSAGE_MEMBERS; k++) {
            const struct boards_view *v = &b->view[camera++];
            if (!v->known)
                continue;
            fprintf(f,
                    "%s{\"name\": \"%s\", \"camera\": %d, \"x\": %.6g, \"z\": %.6g, "
                    "\"dx\": %.4g, \"dz\": %.4g}",
                    any ? ", " : "", m->name, k, (double)v->x, (double)v->z, (double)v->dx,
                    (double)v->dz);
            any = true;
        }
    }
    fputs("]", f);
}

void boards_status_write(const struct boards *b, FILE *f)
{
    const char *trouble = boards_trouble(b);
    fprintf(f, "{\"role\": \"%s\", \"name\": \"%s\", \"board\": \"%s\", \"state\": \"%s\", ",
            b->has_conductor ? "conductor" : "member", b->set->rig_name, b->member.name,
            state_word(b));
    put_truth(f, "ready", !trouble);
    fputs("\"sentence\": ", f);
    json_put_string(f, trouble ? trouble : "ready to capture");
    if (b->has_conductor) {
        put_members(&b->conductor, f);
        put_takes(&b->conductor, f);
        if (b->conductor.last.take[0] || b->conductor.last.err)
            put_last(&b->conductor, f);
        put_views(b, f);
    }
    fputs("}", f);
}
