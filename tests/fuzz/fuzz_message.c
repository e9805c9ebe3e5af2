/* First byte: which message of a rig; the rest is its payload. Refused and nothing is read, or what
 * was read is within bounds, can be written, and is the same when it is read again. */
#include "firmware/rig/message.h"

#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void must(bool truth)
{
    if (!truth)
        abort();
}

#define KIND(type)                                                                                 \
    static struct message_##type type##_read;                                                      \
    static bool read_##type(const char *text, size_t n)                                            \
    {                                                                                              \
        static const struct message_##type zero;                                                   \
        err_t e = message_read_##type(text, n, &type##_read);                                      \
        must(!e || (*err_text() && memcmp(&type##_read, &zero, sizeof zero) == 0));                \
        return !e;                                                                                 \
    }                                                                                              \
    static void write_##type(FILE *f)                                                              \
    {                                                                                              \
        message_write_##type(&type##_read, f);                                                     \
    }

KIND(conductor)
KIND(member)
KIND(order)
KIND(report)
KIND(time)

static const struct kind {
    bool (*read)(const char *text, size_t n);
    void (*write)(FILE *f);
} kinds[] = {{read_conductor, write_conductor},
             {read_member, write_member},
             {read_order, write_order},
             {read_report, write_report},
             {read_time, write_time}};

/* own: free. */
static char *written(const struct kind *k)
{
    char *text;
    size_t n;
    FILE *f = open_memstream(&text, &n);
    must(f != NULL);
    k->write(f);
    must(fclose(f) == 0 && n <= MESSAGE_MAX);
    return text;
}

static bool times_ok(int n, const double *time_s)
{
    for (int i = 0; i < n; i++)
        if (!(time_s[i] >= MESSAGE_TIME_MIN_S && time_s[i] <= MESSAGE_TIME_MAX_S))
            return false;
    return n >= 0 && n <= BRACKET_EXPOSURES_MAX;
}

static void within_bounds(void)
{
    must(member_read.n_holds >= 0 && member_read.n_holds <= MESSAGE_HOLDS);
    must(member_read.within_ns >= 0 && member_read.serial >= 0);
    must(order_read.n >= 0 && order_read.n <= MESSAGE_MEMBERS && order_read.serial >= 0);
    must(times_ok(order_read.n_times, order_read.time_s));
    for (int i = 0; i < order_read.n; i++)
        must(manifest_is_member(order_read.member[i]) && order_read.turn[i] >= 0);
    must(report_read.n_cameras >= 0 && report_read.n_cameras <= BRACKET_CAMERAS_MAX);
    must(report_read.n_starts >= 0 && report_read.n_starts <= TAKE_FRAMES_MAX);
    for (int i = 0; i < report_read.n_cameras; i++)
        must(times_ok(report_read.meter[i].n, report_read.meter[i].time_s));
    for (int i = 0; i < report_read.n_starts; i++)
        must((unsigned)report_read.start[i].camera < BRACKET_CAMERAS_MAX &&
             (unsigned)report_read.start[i].index < BRACKET_EXPOSURES_MAX);
}

/* The text as a topic. */
static void topic(const uint8_t *data, size_t size)
{
    char *text = malloc(size + 1), name[TAKE_MEMBER_CAP];
    must(text != NULL);
    memcpy(text, data, size);
    text[size] = 0;
    char full[MESSAGE_TOPIC_CAP];
    const enum message_topic t = message_kind("rig", text, name);
    if (t != MESSAGE_TOPICS) {
        must(!*name || manifest_is_member(name));
        message_topic("rig", t, name, full);
        must(strcmp(full, text) == 0);
    }
    free(text);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size < 1)
        return 0;
    const size_t n = sizeof kinds / sizeof kinds[0], i = data[0] % (n + 1);
    if (i == n)
        topic(data + 1, size - 1);
    if (i == n || !kinds[i].read((const char *)data + 1, size - 1))
        return 0;
    within_bounds();
    char *first = written(&kinds[i]);
    must(kinds[i].read(first, strlen(first)));
    char *second = written(&kinds[i]);
    must(strcmp(first, second) == 0);
    free(second);
    free(first);
    return 0;
}
