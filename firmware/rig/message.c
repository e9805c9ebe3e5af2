/* Numbers of 64 bits are strings, as in manifests. Readers take each key once through one table of
 * fields, so that bounds stand beside names. */
#include "firmware/rig/message.h"

#include "drivers/format/json.h"
#include "drivers/format/name.h"

#include <inttypes.h>
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

static const char hex[] = "0123456789abcdef", ids[] = "0123456789abcdef-",
                  words[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789.:+~-_";

#define PORT_MAX 65535
#define DISK_MAX_MB 1e12
#define BALANCE_MAX 100.0
#define SERIAL_MAX 1e18
#define TIME_MAX_NS 4e18 // until 2096; differences fit into 64 bits
#define LEAD_MAX_NS 3600e9
#define WITHIN_MAX_NS 1e18 // added to one, too

/* ---- topics ---- */

static const char *const topic_word[MESSAGE_TOPICS] = {"conductor", "order", "time", "member",
                                                       "report",    "ask",   "press"};

static bool has_member(enum message_topic t)
{
    return t != MESSAGE_CONDUCTOR && t != MESSAGE_ORDER;
}

void message_topic(const char *rig, enum message_topic t, const char *member,
                   char out[MESSAGE_TOPIC_CAP])
{
    snprintf(out, MESSAGE_TOPIC_CAP, "hdrig/1/%s/%s%s%s", rig, topic_word[t],
             has_member(t) ? "/" : "", has_member(t) ? member : "");
}

enum message_topic message_kind(const char *rig, const char *topic, char member[TAKE_MEMBER_CAP])
{
    char head[MESSAGE_TOPIC_CAP];
    member[0] = 0;
    for (enum message_topic t = 0; t < MESSAGE_TOPICS; t++) {
        message_topic(rig, t, "", head);
        const size_t n = strlen(head);
        if (!has_member(t) && strcmp(topic, head) == 0)
            return t;
        if (!has_member(t) || strncmp(topic, head, n) != 0 || !manifest_is_member(topic + n))
            continue;
        snprintf(member, TAKE_MEMBER_CAP, "%s", topic + n);
        return t;
    }
    return MESSAGE_TOPICS;
}

/* ---- reading ---- */

enum field_kind { TRUTH, WHOLE, REAL, NS, TEXT, SENTENCE };

struct field {
    const char *key;
    enum field_kind kind;
    size_t offset;       // in the struct: bool, int, double, int64_t, char[cap]
    double low, high;    // of numbers, times too
    const char *allowed; // characters of a TEXT, which may be empty
    size_t cap;
};

static err_t refuse(const char *what, const char *key)
{
    return err_fail(ERR_FORMAT, "%s: \"%s\" is missing or out of range", what, key);
}

/* The value of a key; NULL if it is there twice, as readers differ in which they take. */
static const struct cJSON *get(const struct cJSON *object, const char *key)
{
    const struct cJSON *found = json_member(object, key);
    for (const struct cJSON *x = found ? json_next(found) : NULL; x; x = json_next(x))
        if (strcmp(json_key(x), key) == 0)
            return NULL;
    return found;
}

static bool read_ns(const struct cJSON *node, double low, double high, int64_t *out)
{
    const char *s = json_string(node);
    if (!s || !*s || strlen(s) > 19 || s[strspn(s, "0123456789")])
        return false;
    *out = strtoll(s, NULL, 10);
    return (double)*out >= low && (double)*out <= high;
}

static bool read_number(const struct cJSON *node, double low, double high, double *out)
{
    return json_number(node, out) && *out >= low && *out <= high;
}

static bool read_whole(const struct cJSON *node, double low, double high, int *out)
{
    double v;
    if (!read_number(node, low, high, &v) || v != floor(v))
        return false;
    *out = (int)v;
    return true;
}

/* Bytes of the character at s that can be shown: 0 for controls, C1 too, and what is not UTF-8. */
static size_t shown(const char *s)
{
    const unsigned char *c = (const unsigned char *)s;
    const bool control = c[0] < ' ' || c[0] == 0x7f || (c[0] == 0xc2 && c[1] < 0xa0);
    return control ? 0 : name_utf8(s, strlen(s));
}

/* A sentence is cut to its place after a whole character. */
static void read_sentence(const char *s, size_t cap, char *out)
{
    size_t n = 0;
    while (*s) {
        const size_t bytes = shown(s), more = bytes ? bytes : 1;
        if (n + more >= cap)
            break;
        memcpy(out + n, bytes ? s : " ", more);
        s += more;
        n += more;
    }
    out[n] = 0;
}

static bool read_text(const struct cJSON *node, const struct field *k, char *out)
{
    const char *s = json_string(node);
    if (!s || (k->kind == TEXT && (strlen(s) >= k->cap || s[strspn(s, k->allowed)])))
        return false;
    read_sentence(s, k->cap, out);
    return true;
}

static err_t read_fields(const char *what, const struct cJSON *doc, const struct field *fields,
                         int n, void *out)
{
    for (int i = 0; i < n; i++) {
        const struct field *k = &fields[i];
        const struct cJSON *node = get(doc, k->key);
        void *to = (char *)out + k->offset;
        bool ok = false;
        switch (k->kind) {
        case TRUTH:
            ok = json_truth(node, to);
            break;
        case WHOLE:
            ok = read_whole(node, k->low, k->high, to);
            break;
        case REAL:
            ok = read_number(node, k->low, k->high, to);
            break;
        case NS:
            ok = read_ns(node, k->low, k->high, to);
            break;
        case TEXT:
        case SENTENCE:
            ok = read_text(node, k, to);
            break;
        }
        if (!ok)
            return refuse(what, k->key);
    }
    return OK;
}

#define AT(type, member) offsetof(struct type, member)
#define COUNT(table) ((int)(sizeof(table) / sizeof(table)[0]))

/* A word of a list; its position is the value. */
static bool read_word(const struct cJSON *node, const char *const *list, int n, int *out)
{
    const char *s = json_string(node);
    for (*out = 0; s && *out < n; ++*out)
        if (strcmp(s, list[*out]) == 0)
            return true;
    return false;
}

static err_t open_object(const char *what, const char *text, size_t n, struct cJSON **doc)
{
    *doc = NULL;
    if (n > MESSAGE_MAX)
        return err_fail(ERR_FORMAT, "%s: %zu bytes, at most %d are read", what, n, MESSAGE_MAX);
    err_t e = json_parse(what, text, n, doc);
    if (e || json_is_object(*doc))
        return e;
    json_free(*doc);
    *doc = NULL;
    return err_fail(ERR_FORMAT, "%s: not an object", what);
}

typedef err_t body_fn(const char *what, const struct cJSON *doc, void *out);

static err_t read_message(const char *what, const char *text, size_t n, body_fn *body, void *out)
{
    struct cJSON *doc;
    err_t e = open_object(what, text, n, &doc);
    if (!e)
        e = body(what, doc, out);
    json_free(doc);
    return e;
}

/* ---- conductor ---- */

static err_t conductor_body(const char *what, const struct cJSON *doc, void *out)
{
    static const struct field fields[] = {
        {"online", TRUTH, AT(message_conductor, online), 0, 0, NULL, 0},
        {"epoch", TEXT, AT(message_conductor, epoch), 0, 0, hex, MESSAGE_EPOCH_CAP},
        {"board", TEXT, AT(message_conductor, board), 0, 0, words, TAKE_MEMBER_CAP},
        {"version", TEXT, AT(message_conductor, version), 0, 0, words, MESSAGE_WORD_CAP},
    };
    return read_fields(what, doc, fields, COUNT(fields), out);
}

err_t message_read_conductor(const char *text, size_t n, struct message_conductor *out)
{
    memset(out, 0, sizeof *out);
    err_t e = read_message("conductor", text, n, conductor_body, out);
    if (!e && !out->epoch[0])
        e = refuse("conductor", "epoch");
    if (e)
        memset(out, 0, sizeof *out);
    return e;
}

void message_write_conductor(const struct message_conductor *m, FILE *f)
{
    fprintf(f, "{\"online\": %s, \"epoch\": \"%s\", \"board\": \"%s\", \"version\": \"%s\"}",
            m->online ? "true" : "false", m->epoch, m->board, m->version);
}

/* ---- member ---- */

static err_t read_holds(const char *what, const struct cJSON *doc, struct message_member *m)
{
    static const struct field fields[] = {
        {"take", TEXT, AT(message_hold, take), 0, 0, ids, TAKE_ID_CAP},
        {"part", TEXT, AT(message_hold, part), 0, 0, ids, TAKE_ID_CAP},
        {"bytes", NS, AT(message_hold, bytes), 1, 1e9, NULL, 0},
        {"sha256", TEXT, AT(message_hold, sha256), 0, 0, hex, SHA256_HEX_CAP},
    };
    const struct cJSON *list = get(doc, "holds");
    err_t e = OK;
    if (!json_is_array(list) || json_count(list) > MESSAGE_HOLDS)
        return refuse(what, "holds");
    for (const struct cJSON *x = json_first(list); x && !e; x = json_next(x))
        e = read_fields(what, x, fields, COUNT(fields), &m->hold[m->n_holds++]);
    return e;
}

static err_t member_body(const char *what, const struct cJSON *doc, void *out)
{
    static const struct field online[] = {
        {"online", TRUTH, AT(message_member, online), 0, 0, NULL, 0},
        {"boot", TEXT, AT(message_member, boot), 0, 0, hex, MESSAGE_EPOCH_CAP},
    };
    static const struct field rest[] = {
        {"epoch", TEXT, AT(message_member, epoch), 0, 0, hex, MESSAGE_EPOCH_CAP},
        {"version", TEXT, AT(message_member, version), 0, 0, words, MESSAGE_WORD_CAP},
        {"host", TEXT, AT(message_member, host), 0, 0, words, MESSAGE_HOST_CAP},
        {"port", WHOLE, AT(message_member, port), 0, PORT_MAX, NULL, 0},
        {"token", TEXT, AT(message_member, token), 0, 0, hex, MESSAGE_TOKEN_CAP},
        {"cameras", WHOLE, AT(message_member, cameras), 0, BRACKET_CAMERAS_MAX, NULL, 0},
        {"ready", TRUTH, AT(message_member, ready), 0, 0, NULL, 0},
        {"lead_ns", NS, AT(message_member, lead_ns), 0, LEAD_MAX_NS, NULL, 0},
        {"sentence", SENTENCE, AT(message_member, sentence), 0, 0, NULL, TAKE_TEXT},
        {"free_mb", REAL, AT(message_member, free_mb), -1, DISK_MAX_MB, NULL, 0},
        {"clock_known", TRUTH, AT(message_member, clock_known), 0, 0, NULL, 0},
        {"within_ns", NS, AT(message_member, within_ns), 0, WITHIN_MAX_NS, NULL, 0},
        {"clock", TEXT, AT(message_member, clock), 0, 0, words, 16},
        {"serial", NS, AT(message_member, serial), 0, SERIAL_MAX, NULL, 0},
    };
    struct message_member *m = out;
    err_t e = read_fields(what, doc, online, COUNT(online), m);
    if (e || !m->online)
        return e;
    e = read_fields(what, doc, rest, COUNT(rest), m);
    return e ? e : read_holds(what, doc, m);
}

err_t message_read_member(const char *text, size_t n, struct message_member *out)
{
    memset(out, 0, sizeof *out);
    err_t e = read_message("member", text, n, member_body, out);
    if (e)
        memset(out, 0, sizeof *out);
    return e;
}

void message_write_member(const struct message_member *m, FILE *f)
{
    fprintf(f, "{\"online\": %s, \"boot\": \"%s\"", m->online ? "true" : "false", m->boot);
    if (m->online) {
        fprintf(f,
                ", \"epoch\": \"%s\", \"version\": \"%s\", \"host\": \"%s\", \"port\": %d, "
                "\"token\": \"%s\", "
                "\"cameras\": %d, \"ready\": %s, \"lead_ns\": \"%" PRId64 "\", \"sentence\": ",
                m->epoch, m->version, m->host, m->port, m->token, m->cameras,
                m->ready ? "true" : "false", m->lead_ns);
        json_put_string(f, m->sentence);
        fprintf(f,
                ", \"free_mb\": %.0f, \"clock_known\": %s, \"within_ns\": \"%" PRId64
                "\", \"clock\": \"%s\", \"serial\": \"%" PRId64 "\", \"holds\": [",
                m->free_mb, m->clock_known ? "true" : "false", m->within_ns, m->clock, m->serial);
        for (int i = 0; i < m->n_holds; i++)
            fprintf(f,
                    "%s{\"take\": \"%s\", \"part\": \"%s\", \"bytes\": \"%" PRId64
                    "\", \"sha256\": \"%s\"}",
                    i ? ", " : "", m->hold[i].take, m->hold[i].part, m->hold[i].bytes,
                    m->hold[i].sha256);
        fputs("]", f);
    }
    fputs("}", f);
}

/* ---- order ---- */

static const char *const order_word[] = {"meter", "shoot", "cancel", "release"};

static err_t read_members(const char *what, const struct cJSON *doc, struct message_order *m)
{
    const struct cJSON *list = get(doc, "members");
    if (!json_is_array(list) || json_count(list) > MESSAGE_MEMBERS)
        return refuse(what, "members");
    for (const struct cJSON *x = json_first(list); x; x = json_next(x)) {
        const char *name = json_string(get(x, "name"));
        if (!name || !manifest_is_member(name) ||
            !read_whole(get(x, "turn"), 0, 1e6, &m->turn[m->n]))
            return refuse(what, "members");
        snprintf(m->member[m->n++], TAKE_MEMBER_CAP, "%s", name);
    }
    return OK;
}

static bool read_times(const struct cJSON *list, int *n, double *time_s)
{
    *n = 0;
    if (!json_is_array(list) || json_count(list) > BRACKET_EXPOSURES_MAX)
        return false;
    for (const struct cJSON *x = json_first(list); x; x = json_next(x))
        if (!read_number(x, MESSAGE_TIME_MIN_S, MESSAGE_TIME_MAX_S, &time_s[(*n)++]))
            return false;
    return true;
}

static err_t read_balance(const char *what, const struct cJSON *doc, float *red, float *blue)
{
    double r, b;
    if (!read_number(get(doc, "red"), 0, BALANCE_MAX, &r))
        return refuse(what, "red");
    if (!read_number(get(doc, "blue"), 0, BALANCE_MAX, &b))
        return refuse(what, "blue");
    *red = (float)r;
    *blue = (float)b;
    return OK;
}

/* Texts that may be empty in another kind of message. */
static err_t need(const char *what, const char *key, const char *text)
{
    return *text ? OK : refuse(what, key);
}

static err_t order_body(const char *what, const struct cJSON *doc, void *out)
{
    static const struct field fields[] = {
        {"epoch", TEXT, AT(message_order, epoch), 0, 0, hex, MESSAGE_EPOCH_CAP},
        {"serial", NS, AT(message_order, serial), 0, SERIAL_MAX, NULL, 0},
        {"take", TEXT, AT(message_order, take), 0, 0, ids, TAKE_ID_CAP},
        {"start_ns", NS, AT(message_order, start_ns), 0, TIME_MAX_NS, NULL, 0},
        {"stagger", TRUTH, AT(message_order, stagger), 0, 0, NULL, 0},
    };
    struct message_order *m = out;
    int kind;
    if (!read_word(get(doc, "order"), order_word, COUNT(order_word), &kind))
        return refuse(what, "order");
    m->kind = (enum message_order_kind)kind;
    err_t e = read_fields(what, doc, fields, COUNT(fields), m);
    if (!e)
        e = read_members(what, doc, m);
    if (!e && !read_times(get(doc, "times_s"), &m->n_times, m->time_s))
        e = refuse(what, "times_s");
    if (!e)
        e = read_balance(what, doc, &m->red, &m->blue);
    if (!e)
        e = need(what, "epoch", m->epoch);
    if (!e && (m->kind == MESSAGE_SHOOT || m->kind == MESSAGE_RELEASE))
        e = need(what, "take", m->take);
    return !e && m->kind == MESSAGE_SHOOT && m->n_times < 1 ? refuse(what, "times_s") : e;
}

err_t message_read_order(const char *text, size_t n, struct message_order *out)
{
    memset(out, 0, sizeof *out);
    err_t e = read_message("order", text, n, order_body, out);
    if (e)
        memset(out, 0, sizeof *out);
    return e;
}

static void put_times(int n, const double *time_s, FILE *f)
{
    fputs("[", f);
    for (int i = 0; i < n; i++)
        fprintf(f, "%s%.12g", i ? ", " : "", time_s[i]);
    fputs("]", f);
}

void message_write_order(const struct message_order *m, FILE *f)
{
    fprintf(f,
            "{\"order\": \"%s\", \"epoch\": \"%s\", \"serial\": \"%" PRId64
            "\", \"take\": \"%s\", \"start_ns\": \"%" PRId64
            "\", \"stagger\": %s, \"red\": %.9g, \"blue\": %.9g, \"times_s\": ",
            order_word[m->kind], m->epoch, m->serial, m->take, m->start_ns,
            m->stagger ? "true" : "false", (double)m->red, (double)m->blue);
    put_times(m->n_times, m->time_s, f);
    fputs(", \"members\": [", f);
    for (int i = 0; i < m->n; i++)
        fprintf(f, "%s{\"name\": \"%s\", \"turn\": %d}", i ? ", " : "", m->member[i], m->turn[i]);
    fputs("]}", f);
}

int message_find(const struct message_order *m, const char *member)
{
    for (int i = 0; i < m->n; i++)
        if (strcmp(m->member[i], member) == 0)
            return i;
    return -1;
}

/* ---- report ---- */

static const char *const report_word[] = {"metered", "stored", "failed"};

static err_t read_meters(const char *what, const struct cJSON *doc, struct message_report *m)
{
    const struct cJSON *list = get(doc, "meters_s");
    if (!json_is_array(list) || json_count(list) > BRACKET_CAMERAS_MAX)
        return refuse(what, "meters_s");
    for (const struct cJSON *x = json_first(list); x; x = json_next(x)) {
        struct message_meter *k = &m->meter[m->n_cameras++];
        if (!read_times(x, &k->n, k->time_s))
            return refuse(what, "meters_s");
    }
    return OK;
}

static err_t read_starts(const char *what, const struct cJSON *doc, struct message_report *m)
{
    static const struct field fields[] = {
        {"camera", WHOLE, AT(message_start, camera), 0, BRACKET_CAMERAS_MAX - 1, NULL, 0},
        {"index", WHOLE, AT(message_start, index), 0, BRACKET_EXPOSURES_MAX - 1, NULL, 0},
        {"common_ns", NS, AT(message_start, common_ns), 0, TIME_MAX_NS, NULL, 0},
        {"within_ns", NS, AT(message_start, within_ns), 0, WITHIN_MAX_NS, NULL, 0},
    };
    const struct cJSON *list = get(doc, "starts");
    err_t e = OK;
    if (!json_is_array(list) || json_count(list) > TAKE_FRAMES_MAX)
        return refuse(what, "starts");
    for (const struct cJSON *x = json_first(list); x && !e; x = json_next(x))
        e = read_fields(what, x, fields, COUNT(fields), &m->start[m->n_starts++]);
    return e;
}

static err_t report_body(const char *what, const struct cJSON *doc, void *out)
{
    static const struct field fields[] = {
        {"epoch", TEXT, AT(message_report, epoch), 0, 0, hex, MESSAGE_EPOCH_CAP},
        {"serial", NS, AT(message_report, serial), 0, SERIAL_MAX, NULL, 0},
        {"take", TEXT, AT(message_report, take), 0, 0, ids, TAKE_ID_CAP},
        {"part", TEXT, AT(message_report, part), 0, 0, ids, TAKE_ID_CAP},
        {"reason", SENTENCE, AT(message_report, reason), 0, 0, NULL, TAKE_TEXT},
    };
    struct message_report *m = out;
    int kind;
    if (!read_word(get(doc, "report"), report_word, COUNT(report_word), &kind))
        return refuse(what, "report");
    m->kind = (enum message_report_kind)kind;
    err_t e = read_fields(what, doc, fields, COUNT(fields), m);
    if (!e)
        e = read_meters(what, doc, m);
    if (!e)
        e = read_starts(what, doc, m);
    if (!e)
        e = read_balance(what, doc, &m->red, &m->blue);
    if (!e && m->kind == MESSAGE_STORED)
        e = need(what, "take", m->take);
    return !e && m->kind == MESSAGE_STORED ? need(what, "part", m->part) : e;
}

err_t message_read_report(const char *text, size_t n, struct message_report *out)
{
    memset(out, 0, sizeof *out);
    err_t e = read_message("report", text, n, report_body, out);
    if (e)
        memset(out, 0, sizeof *out);
    return e;
}

void message_write_report(const struct message_report *m, FILE *f)
{
    fprintf(f,
            "{\"report\": \"%s\", \"epoch\": \"%s\", \"serial\": \"%" PRId64
            "\", \"take\": \"%s\", \"part\": \"%s\", \"red\": %.9g, \"blue\": %.9g, \"reason\": ",
            report_word[m->kind], m->epoch, m->serial, m->take, m->part, (double)m->red,
            (double)m->blue);
    json_put_string(f, m->reason);
    fputs(", \"meters_s\": [", f);
    for (int i = 0; i < m->n_cameras; i++) {
        fputs(i ? ", " : "", f);
        put_times(m->meter[i].n, m->meter[i].time_s, f);
    }
    fputs("], \"starts\": [", f);
    for (int i = 0; i < m->n_starts; i++) {
        const struct message_start *x = &m->start[i];
        fprintf(f,
                "%s{\"camera\": %d, \"index\": %d, \"common_ns\": \"%" PRId64
                "\", \"within_ns\": \"%" PRId64 "\"}",
                i ? ", " : "", x->camera, x->index, x->common_ns, x->within_ns);
    }
    fputs("]}", f);
}

/* ---- time ---- */

static err_t time_body(const char *what, const struct cJSON *doc, void *out)
{
    static const struct field fields[] = {
        {"epoch", TEXT, AT(message_time, epoch), 0, 0, hex, MESSAGE_EPOCH_CAP},
        {"sent_ns", NS, AT(message_time, sent_ns), 0, TIME_MAX_NS, NULL, 0},
        {"got_ns", NS, AT(message_time, got_ns), 0, TIME_MAX_NS, NULL, 0},
        {"replied_ns", NS, AT(message_time, replied_ns), 0, TIME_MAX_NS, NULL, 0},
        {"disciplined", TRUTH, AT(message_time, disciplined), 0, 0, NULL, 0},
        {"real_ns", NS, AT(message_time, real_ns), 0, TIME_MAX_NS, NULL, 0},
        {"within_ns", NS, AT(message_time, within_ns), 0, WITHIN_MAX_NS, NULL, 0},
    };
    return read_fields(what, doc, fields, COUNT(fields), out);
}

err_t message_read_time(const char *text, size_t n, struct message_time *out)
{
    memset(out, 0, sizeof *out);
    err_t e = read_message("time", text, n, time_body, out);
    if (e)
        memset(out, 0, sizeof *out);
    return e;
}

void message_write_time(const struct message_time *m, FILE *f)
{
    fprintf(f,
            "{\"epoch\": \"%s\", \"sent_ns\": \"%" PRId64 "\", \"got_ns\": \"%" PRId64
            "\", \"replied_ns\": \"%" PRId64 "\", \"disciplined\": %s, \"real_ns\": \"%" PRId64
            "\", \"within_ns\": \"%" PRId64 "\"}",
            m->epoch, m->sent_ns, m->got_ns, m->replied_ns, m->disciplined ? "true" : "false",
            m->real_ns, m->within_ns);
}
