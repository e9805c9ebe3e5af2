/* Messages of a rig of boards: written and read back, and as a hostile broker would send them. */
#include "firmware/rig/message.h"
#include "tests/unit/expect.h"

#include <inttypes.h>
#include <stdlib.h>

static struct message_member member;
static struct message_order order;
static struct message_report report;

#define FULL_TAKE "0123abcd-0123456789abcdef012345" // TAKE_ID_CAP - 1
#define FULL_NAME "board-0123456789-0123456789-abc" // TAKE_MEMBER_CAP - 1
#define TIMES 9

struct kind {
    size_t bytes;
    void (*write)(const void *m, FILE *f);
    err_t (*read)(const char *text, size_t n, void *out);
};

#define KIND(type)                                                                                 \
    static void write_##type(const void *m, FILE *f)                                               \
    {                                                                                              \
        message_write_##type(m, f);                                                                \
    }                                                                                              \
    static err_t read_##type(const char *text, size_t n, void *out)                                \
    {                                                                                              \
        return message_read_##type(text, n, out);                                                  \
    }                                                                                              \
    static const struct kind type##_kind = {sizeof(struct message_##type), write_##type,           \
                                            read_##type};

KIND(conductor)
KIND(member)
KIND(order)
KIND(report)
KIND(time)

/* own: free. */
static char *written(const struct kind *k, const void *m)
{
    char *text;
    size_t n;
    FILE *f = open_memstream(&text, &n);
    assert_non_null(f);
    k->write(m, f);
    assert_int_equal(fclose(f), 0);
    assert_in_range(n, 2, MESSAGE_MAX);
    return text;
}

static void comes_back(const struct kind *k, const void *m)
{
    char *text = written(k, m);
    void *out = malloc(k->bytes);
    assert_non_null(out);
    memset(out, 0x55, k->bytes);
    expect_ok(k->read(text, strlen(text), out));
    char *again = written(k, out);
    assert_string_equal(text, again);
    assert_memory_equal(m, out, k->bytes);
    free(again);
    free(out);
    free(text);
}

/* Refused with a sentence that has these words, and nothing is left in *out. */
static void refused_bytes(const struct kind *k, const char *text, size_t n, const char *words)
{
    unsigned char *out = malloc(k->bytes), sum = 0;
    assert_non_null(out);
    memset(out, 0x55, k->bytes);
    expect_err(k->read(text, n, out), ERR_FORMAT, words);
    for (size_t i = 0; i < k->bytes; i++)
        sum |= out[i];
    assert_int_equal(sum, 0);
    free(out);
}

static void refused(const struct kind *k, const char *text, const char *words)
{
    refused_bytes(k, text, strlen(text), words);
}

/* What the message is if the first `from` in it becomes `to`.
 * own: free. */
static char *changed(const struct kind *k, const void *m, const char *from, const char *to)
{
    char *text = written(k, m), *at = strstr(text, from), *out;
    if (!at)
        fail_msg("\"%s\" is not in %s", from, text);
    *at = 0;
    assert_true(asprintf(&out, "%s%s%s", text, to, at + strlen(from)) > 0);
    free(text);
    return out;
}

static void refused_with(const struct kind *k, const void *m, const char *const change[3])
{
    char *text = changed(k, m, change[0], change[1]);
    refused(k, text, change[2]);
    free(text);
}

static void read_with(const struct kind *k, const void *m, const char *const change[2], void *out)
{
    char *text = changed(k, m, change[0], change[1]);
    expect_ok(k->read(text, strlen(text), out));
    char *again = written(k, out); // what is read can be written
    expect_ok(k->read(again, strlen(again), out));
    free(again);
    free(text);
}

/* ---- messages as they are ---- */

static const struct message_conductor conductor = {true, "0123456789abcdef", "left", "0.5.0-rc1"};

static const struct message_time stamps = {
    "00ff", 1, INT64_C(4000000000000000000), INT64_C(1790000000000000001), true, 3, 1000};

static void fill_member(int holds)
{
    member = (struct message_member){.online = true,
                                     .boot = "fedcba9876543210",
                                     .version = "0123456789.0123456789+01234567",
                                     .host = "fe80::1:2:3~eth0",
                                     .port = 65535,
                                     .token = "0123456789abcdef0123456789abcdef",
                                     .cameras = BRACKET_CAMERAS_MAX,
                                     .epoch = "0123456789abcdef",
                                     .ready = true,
                                     .lead_ns = 900000000,
                                     .sentence = "says \"no\", \\ and \xc3\xa4",
                                     .free_mb = 12345,
                                     .clock_known = true,
                                     .within_ns = 210000,
                                     .clock = "exchange",
                                     .serial = INT64_C(1000000000000000000),
                                     .n_holds = holds};
    for (int i = 0; i < holds; i++) {
        snprintf(member.hold[i].take, TAKE_ID_CAP, "%s", FULL_TAKE);
        snprintf(member.hold[i].part, TAKE_ID_CAP, "%08x-%06d", 0xfeedu, i);
        member.hold[i].bytes = 2000000 + i;
        memset(member.hold[i].sha256, 'f', SHA256_HEX_CAP - 1);
    }
}

static void fill_order(int members)
{
    order = (struct message_order){.kind = MESSAGE_SHOOT,
                                   .epoch = "0123456789abcdef",
                                   .serial = 17,
                                   .take = FULL_TAKE,
                                   .n = members,
                                   .start_ns = INT64_C(1790000000123456789),
                                   .n_times = TIMES,
                                   .stagger = true,
                                   .red = 1.9375f,
                                   .blue = 1.1f};
    for (int i = 0; i < members; i++) {
        snprintf(order.member[i], TAKE_MEMBER_CAP, "%.27s-%03d", FULL_NAME, i);
        order.turn[i] = 16 * i;
    }
    for (int i = 0; i < TIMES; i++)
        order.time_s[i] = 0.0625 * (i + 1);
}

static void fill_report(int cameras, int starts)
{
    report = (struct message_report){.kind = MESSAGE_STORED,
                                     .epoch = "a",
                                     .serial = 17,
                                     .take = FULL_TAKE,
                                     .part = "00000001-000001",
                                     .n_cameras = cameras,
                                     .n_starts = starts,
                                     .red = 0.3f,
                                     .blue = 100};
    for (int i = 0; i < cameras; i++) {
        report.meter[i].n = TIMES;
        for (int k = 0; k < TIMES; k++)
            report.meter[i].time_s[k] = 0.0625 * (TIMES * i + k + 1);
    }
    for (int i = 0; i < starts; i++)
        report.start[i] =
            (struct message_start){i / TIMES, i % TIMES, INT64_C(3999999999999999000) + i,
                                   INT64_C(999999999999999000) + i};
    memset(report.reason, 1, sizeof report.reason - 1); // takes the most room
}

static void round_trips(void **state)
{
    (void)state;
    comes_back(&conductor_kind, &conductor);
    comes_back(&conductor_kind, &(struct message_conductor){.epoch = "0"});
    comes_back(&time_kind, &stamps);
    comes_back(&time_kind, &(struct message_time){0});
    for (int n = 0; n <= MESSAGE_HOLDS; n += 32) {
        fill_member(n);
        comes_back(&member_kind, &member);
    }
    comes_back(&member_kind, &(struct message_member){.boot = "12"});
    comes_back(&member_kind, &(struct message_member){.online = true, .free_mb = -1});
    for (int n = 0; n <= MESSAGE_MEMBERS; n += 32) {
        fill_order(n);
        comes_back(&order_kind, &order);
    }
    for (int kind = MESSAGE_METER; kind <= MESSAGE_RELEASE; kind++) {
        order.kind = (enum message_order_kind)kind;
        comes_back(&order_kind, &order);
    }
    fill_order(1);
    assert_int_equal(message_find(&order, order.member[0]), 0);
    assert_int_equal(message_find(&order, "left"), -1);
    fill_report(0, 0);
    memset(report.reason, 'a', sizeof report.reason - 1);
    comes_back(&report_kind, &report);
    fill_report(BRACKET_CAMERAS_MAX, TAKE_FRAMES_MAX);
    memset(report.reason, '"', sizeof report.reason - 1);
    comes_back(&report_kind, &report);
    report.kind = MESSAGE_FAILED;
    report.take[0] = report.part[0] = 0;
    memset(report.take, 0, sizeof report.take);
    memset(report.part, 0, sizeof report.part);
    comes_back(&report_kind, &report);
}

/* The largest that a board would send fit, whatever their sentences hold. */
static void largest_fit(void **state)
{
    (void)state;
    fill_report(BRACKET_CAMERAS_MAX, TAKE_FRAMES_MAX);
    char *text = written(&report_kind, &report);
    struct message_report out;
    expect_ok(message_read_report(text, strlen(text), &out));
    assert_int_equal(strspn(out.reason, " "), TAKE_TEXT - 1); // controls have become blanks
    free(text);
    fill_member(MESSAGE_HOLDS);
    memset(member.sentence, 0xff, sizeof member.sentence - 1);
    text = written(&member_kind, &member);
    struct message_member back;
    expect_ok(message_read_member(text, strlen(text), &back));
    assert_int_equal(strlen(back.sentence), 3 * 85); // U+FFFD, whole
    free(text);
    fill_order(128);
    text = written(&order_kind, &order);
    struct message_order all;
    expect_ok(message_read_order(text, strlen(text), &all));
    assert_int_equal(all.n, 128);
    assert_int_equal(strlen(all.member[127]), TAKE_MEMBER_CAP - 1);
    assert_int_equal(message_find(&all, order.member[127]), 127);
    assert_true(strlen(text) < MESSAGE_MAX / 2);
    free(text);
}

/* ---- names and topics ---- */

static void names(void **state)
{
    (void)state;
    static const char *const good[] = {"a", "0", "left", "cam-2", "a-", FULL_NAME};
    static const char *const bad[] = {"",     "-a",  "Left", "a.b",      "a/b",         "a+",
                                      "a#",   "a b", "a\n",  "\xc3\xa4", FULL_NAME "d", "$sys",
                                      "a\"b", "..",  "+",    "#"};
    for (size_t i = 0; i < sizeof good / sizeof good[0]; i++)
        assert_true(manifest_is_member(good[i]));
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++)
        assert_false(manifest_is_member(bad[i]));
}

static void topics(void **state)
{
    (void)state;
    char topic[MESSAGE_TOPIC_CAP], name[TAKE_MEMBER_CAP];
    for (int t = 0; t < MESSAGE_TOPICS; t++) {
        const bool own = t == MESSAGE_CONDUCTOR || t == MESSAGE_ORDER;
        message_topic(FULL_NAME, (enum message_topic)t, FULL_NAME, topic);
        assert_in_range(strlen(topic), 10 + strlen(FULL_NAME), MESSAGE_TOPIC_CAP - 2);
        assert_int_equal(message_kind(FULL_NAME, topic, name), t);
        assert_string_equal(name, own ? "" : FULL_NAME);
        assert_int_equal(message_kind("other", topic, name), MESSAGE_TOPICS);
        assert_string_equal(name, "");
        message_topic("rig", (enum message_topic)t, "+", topic);
        assert_int_equal(message_kind("rig", topic, name), own ? t : MESSAGE_TOPICS);
    }
    message_topic("rig", MESSAGE_CONDUCTOR, NULL, topic);
    assert_string_equal(topic, "hdrig/1/rig/conductor");
    message_topic("rig", MESSAGE_MEMBER, "+", topic);
    assert_string_equal(topic, "hdrig/1/rig/member/+");
}

static void foreign_topics(void **state)
{
    (void)state;
    static const char *const bad[] = {
        "",
        "hdrig/1/rig",
        "hdrig/1/rig/",
        "hdrig/1/rig/member",
        "hdrig/1/rig/member/",
        "hdrig/1/rig/member/+",
        "hdrig/1/rig/member/#",
        "hdrig/1/rig/member/a/b",
        "hdrig/1/rig/member/Left",
        "hdrig/1/rig/member/" FULL_NAME "d",
        "hdrig/1/rig/order/left",
        "hdrig/1/rig/conductor/",
        "hdrig/1/rig/conductors",
        "hdrig/1/rig2/order",
        "hdrig/2/rig/order",
        "/hdrig/1/rig/order",
        "hdrig/1/RIG/order",
        "$SYS/broker/uptime",
    };
    char name[TAKE_MEMBER_CAP] = "before", *longer = calloc(1, 70000);
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        assert_int_equal(message_kind("rig", bad[i], name), MESSAGE_TOPICS);
        assert_string_equal(name, "");
    }
    memset(longer, 'a', 69999);
    memcpy(longer, "hdrig/1/rig/member/", 19);
    assert_int_equal(message_kind("rig", longer, name), MESSAGE_TOPICS);
    free(longer);
}

/* ---- hostile text ---- */

static void not_objects(void **state)
{
    (void)state;
    static const struct kind *const kinds[] = {&conductor_kind, &member_kind, &order_kind,
                                               &report_kind, &time_kind};
    static const char *const texts[] = {"[]", "1", "null", "\"online\"", "true"};
    for (size_t k = 0; k < sizeof kinds / sizeof kinds[0]; k++) {
        for (size_t i = 0; i < sizeof texts / sizeof texts[0]; i++)
            refused(kinds[k], texts[i], "not an object");
        refused(kinds[k], "", "not JSON");
        refused(kinds[k], "{", "cut short");
        refused(kinds[k], "{}x", "not JSON");
        refused(kinds[k], "{\"a\": NaN}", "finite numbers");
        refused_bytes(kinds[k], "{}\0", 3, "byte 2 is 0");
        refused(kinds[k], "{}", "is missing");
    }
}

static void too_much(void **state)
{
    (void)state;
    char *text = malloc(MESSAGE_MAX + 1);
    assert_non_null(text);
    memset(text, ' ', MESSAGE_MAX + 1);
    text[0] = '{';
    text[MESSAGE_MAX] = '}';
    refused_bytes(&order_kind, text, MESSAGE_MAX + 1, "at most 65536");
    memset(text, '[', MESSAGE_MAX);
    refused_bytes(&order_kind, text, MESSAGE_MAX, "not JSON");
    for (int i = 0; i + 5 <= MESSAGE_MAX; i += 5)
        memcpy(text + i, "{\"a\":", 5);
    refused_bytes(&member_kind, text, MESSAGE_MAX, "member");
    free(text);
}

/* Every key must be there, and be there once. */
static void each_key_once(const struct kind *k, const void *m)
{
    char *text = written(k, m), key[32];
    for (const char *p = text; (p = strstr(p, "\": ")) != NULL; p++) {
        const char *from = p;
        while (from[-1] != '"')
            from--;
        snprintf(key, sizeof key, "%.*s", (int)(p - from), from);
        char old[48], gone[48], twice[96], words[64];
        snprintf(old, sizeof old, "\"%s\": ", key);
        snprintf(gone, sizeof gone, "\"%sx\": ", key);
        snprintf(twice, sizeof twice, "\"%s\": {}, \"%s\": ", key, key);
        bool in_list = strcmp(key, "name") == 0 || strcmp(key, "turn") == 0;
        snprintf(words, sizeof words, "\"%s\" is missing", in_list ? "members" : key);
        refused_with(k, m, (const char *const[3]){old, gone, words});
        refused_with(k, m, (const char *const[3]){old, twice, words});
    }
    free(text);
}

static void keys(void **state)
{
    (void)state;
    fill_member(1);
    fill_order(1);
    fill_report(1, 1);
    each_key_once(&conductor_kind, &conductor);
    each_key_once(&member_kind, &member);
    each_key_once(&order_kind, &order);
    each_key_once(&report_kind, &report);
    each_key_once(&time_kind, &stamps);
    struct message_conductor out;
    read_with(&conductor_kind, &conductor,
              (const char *const[2]){"{", "{\"later\": [{\"online\": 0}], "}, &out);
    assert_true(out.online);
}

static void wrong_members(void **state)
{
    (void)state;
    static const char *const of_member[][3] = {
        {"\"online\": true", "\"online\": 1", "online"},
        {"\"online\": true", "\"online\": \"true\"", "online"},
        {"\"boot\": \"f", "\"boot\": \"F", "boot"},
        {"\"boot\": \"", "\"boot\": \"0", "boot"},
        {"\"version\": \"0", "\"version\": \"\\\"", "version"},
        {"\"host\": \"fe80::", "\"host\": \"a/b@", "host"},
        {"\"host\": \"fe80::", "\"host\": \"a\\n", "host"},
        {"\"port\": 65535", "\"port\": 65536", "port"},
        {"\"port\": 65535", "\"port\": -1", "port"},
        {"\"port\": 65535", "\"port\": 1.5", "port"},
        {"\"port\": 65535", "\"port\": 1e999", "port"},
        {"\"port\": 65535", "\"port\": \"80\"", "port"},
        {"\"token\": \"", "\"token\": \"0", "token"},
        {"\"cameras\": 16", "\"cameras\": 17", "cameras"},
        {"\"cameras\": 16", "\"cameras\": -1e999", "cameras"},
        {"\"ready\": true", "\"ready\": null", "ready"},
        {"\"sentence\": \"", "\"sentence\": 5, \"x\": \"", "sentence"},
        {"\"free_mb\": 12345", "\"free_mb\": 1e13", "free_mb"},
        {"\"free_mb\": 12345", "\"free_mb\": -2", "free_mb"},
        {"\"within_ns\": \"210000\"", "\"within_ns\": 210000", "within_ns"},
        {"\"within_ns\": \"", "\"within_ns\": \"-", "within_ns"},
        {"\"clock\": \"exchange", "\"clock\": \"exchange-exchange", "clock"},
        {"\"holds\": [", "\"holds\": {}, \"x\": [", "holds"},
        {"\"holds\": [", "\"holds\": [1, ", "take"},
        {"\"take\": \"0123", "\"take\": \"../0", "take"},
        {"\"part\": \"", "\"part\": \"/", "part"},
        {"\"part\": \"", "\"part\": \"00000000000000000", "part"},
    };
    fill_member(1);
    for (size_t i = 0; i < sizeof of_member / sizeof of_member[0]; i++)
        refused_with(&member_kind, &member, of_member[i]);
}

static void wrong_orders(void **state)
{
    (void)state;
    static const char *const of_order[][3] = {
        {"\"order\": \"shoot\"", "\"order\": \"shot\"", "order"},
        {"\"order\": \"shoot\"", "\"order\": 1", "order"},
        {"\"epoch\": \"0123456789abcdef\"", "\"epoch\": \"\"", "epoch"},
        {"\"take\": \"" FULL_TAKE "\"", "\"take\": \"\"", "take"},
        {"\"stagger\": true", "\"stagger\": []", "stagger"},
        {"\"red\": 1", "\"red\": 101", "red"},
        {"\"red\": ", "\"red\": -", "red"},
        {"\"blue\": ", "\"blue\": 1e999, \"x\": ", "blue"},
        {"\"times_s\": [", "\"times_s\": [0, ", "times_s"},
        {"\"times_s\": [", "\"times_s\": [\"1\", ", "times_s"},
        {"\"times_s\": [", "\"times_s\": [1, ", "times_s"}, // ten
        {"\"times_s\": [", "\"times_s\": [], \"x\": [", "times_s"},
        {"\"members\": [", "\"members\": [null, ", "members"},
        {"\"turn\": 0", "\"turn\": -1", "members"},
        {"\"turn\": 0", "\"turn\": 1000001", "members"},
        {"\"name\": \"", "\"name\": \"-", "members"},
        {"\"name\": \"board", "\"name\": \"b\\u0022rd", "members"},
        {"\"name\": \"", "\"name\": \"aaa", "members"},
    };
    fill_order(1);
    for (size_t i = 0; i < sizeof of_order / sizeof of_order[0]; i++)
        refused_with(&order_kind, &order, of_order[i]);
}

static void wrong_reports(void **state)
{
    (void)state;
    static const char *const of_report[][3] = {
        {"\"report\": \"stored\"", "\"report\": \"\"", "report"},
        {"\"take\": \"" FULL_TAKE "\"", "\"take\": \"\"", "take"},
        {"\"part\": \"00000001-000001\"", "\"part\": \"\"", "part"},
        {"\"camera\": 0", "\"camera\": 16", "camera"},
        {"\"index\": 0", "\"index\": 9", "index"},
        {"\"index\": 0", "\"index\": -1", "index"},
        {"\"within_ns\": \"", "\"within_ns\": \"-", "within_ns"},
        {"\"meters_s\": [[", "\"meters_s\": [1, [", "meters_s"},
        {"\"meters_s\": [[", "\"meters_s\": [[1e-10, ", "meters_s"},
        {"\"meters_s\": [[", "\"meters_s\": [[1, ", "meters_s"}, // ten
        {"\"starts\": [", "\"starts\": 1, \"x\": [", "starts"},
    };
    fill_report(1, 1);
    for (size_t i = 0; i < sizeof of_report / sizeof of_report[0]; i++)
        refused_with(&report_kind, &report, of_report[i]);
}

/* Numbers of 64 bits. */
static void long_numbers(void **state)
{
    (void)state;
    static const char *const bad[] = {"",
                                      "-",
                                      "-1",
                                      "+1",
                                      " 1",
                                      "1 ",
                                      "1e3",
                                      "0x10",
                                      "1.0",
                                      "1-2",
                                      "4000000000000000513", // the next that a double holds
                                      "9223372036854775807",
                                      "9223372036854775808",
                                      "-9223372036854775808",
                                      "18446744073709551616",
                                      "99999999999999999999",
                                      "00000000000000000001"};
    static const char *const good[] = {"0", "0000000000000000001", "4000000000000000000"};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        char to[64];
        snprintf(to, sizeof to, "\"sent_ns\": \"%s\"", bad[i]);
        refused_with(&time_kind, &stamps,
                     (const char *const[3]){"\"sent_ns\": \"1\"", to, "\"sent_ns\""});
    }
    for (size_t i = 0; i < sizeof good / sizeof good[0]; i++) {
        char to[64];
        struct message_time out;
        snprintf(to, sizeof to, "\"sent_ns\": \"%s\"", good[i]);
        read_with(&time_kind, &stamps, (const char *const[2]){"\"sent_ns\": \"1\"", to}, &out);
        assert_true(out.sent_ns == strtoll(good[i], NULL, 10));
    }
}

static void repeat(const struct kind *k, const void *m, const char *const change[3], int times)
{
    const size_t n = strlen(change[1]), head = strlen(change[0]);
    char *to = malloc(head + n * (size_t)times + 1);
    assert_non_null(to);
    memcpy(to, change[0], head + 1);
    for (int i = 0; i < times; i++)
        memcpy(to + head + n * (size_t)i, change[1], n + 1);
    refused_with(k, m, (const char *const[3]){change[0], to, change[2]});
    free(to);
}

static void lists_too_long(void **state)
{
    (void)state;
    fill_member(1);
    fill_order(1);
    fill_report(1, 1);
    repeat(&member_kind, &member,
           (const char *const[3]){"\"holds\": [", "{\"take\": \"a\", \"part\": \"b\"}, ", "holds"},
           MESSAGE_HOLDS);
    repeat(&order_kind, &order,
           (const char *const[3]){"\"members\": [", "{\"name\": \"a\", \"turn\": 0}, ", "members"},
           MESSAGE_MEMBERS);
    repeat(&report_kind, &report, (const char *const[3]){"\"meters_s\": [", "[], ", "meters_s"},
           BRACKET_CAMERAS_MAX);
    repeat(&report_kind, &report, (const char *const[3]){"\"starts\": [", "1, ", "starts"},
           TAKE_FRAMES_MAX);
    repeat(&report_kind, &report, (const char *const[3]){"\"starts\": [", "1, ", "starts"}, 20000);
}

static void expect_sentence(const char *json, const char *want)
{
    struct message_member out;
    fill_member(0);
    snprintf(member.sentence, sizeof member.sentence, "here");
    read_with(&member_kind, &member, (const char *const[2]){"here", json}, &out);
    assert_string_equal(out.sentence, want);
}

static void sentences(void **state)
{
    (void)state;
    char text[TAKE_TEXT * 2 + 1];
    expect_sentence("", "");
    expect_sentence("a\\nb\\tc\\u001b[2J\\u007f", "a b c [2J ");
    expect_sentence("a\x1b[2J", "a [2J");
    expect_sentence("\\u009b1m|\xc2\x85|\xc2\xa0", "  1m|  |\xc2\xa0");
    expect_sentence("a\\u0000b", "a");
    expect_sentence("\xff\xfe \xc3( \xed\xa0\x80 \xf0\x9f\x98\x80", "    (     \xf0\x9f\x98\x80");
    expect_sentence("\\\"}, {\\\"", "\"}, {\"");
    expect_sentence("\xc3", " ");
    memset(text, 'a', sizeof text - 1);
    text[sizeof text - 1] = 0;
    memcpy(text + TAKE_TEXT - 2, "\xc3\xa4", 2); // has no room as a whole
    char want[TAKE_TEXT];
    snprintf(want, sizeof want, "%.*s", TAKE_TEXT - 2, text);
    expect_sentence(text, want);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(round_trips),    cmocka_unit_test(largest_fit),
        cmocka_unit_test(names),          cmocka_unit_test(topics),
        cmocka_unit_test(foreign_topics), cmocka_unit_test(not_objects),
        cmocka_unit_test(too_much),       cmocka_unit_test(keys),
        cmocka_unit_test(wrong_members),  cmocka_unit_test(wrong_orders),
        cmocka_unit_test(wrong_reports),  cmocka_unit_test(long_numbers),
        cmocka_unit_test(lists_too_long), cmocka_unit_test(sentences),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
