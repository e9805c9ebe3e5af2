/* Clients of a real broker, which is started, killed and started again. */
#include "drivers/net/mqtt.h"

#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <arpa/inet.h>
#include <dlfcn.h>
#include <mosquitto.h>
#include <netdb.h>
#include <poll.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#define BROKER "/usr/sbin/mosquitto"
#define PATIENCE_NS 30000000000 // a busy machine takes its time

static pid_t broker;
static int port;
static struct mqtt *a, *b;

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

/* ---- the broker ---- */

static struct sockaddr_in loopback(int at)
{
    struct sockaddr_in s = {.sin_family = AF_INET, .sin_port = htons((uint16_t)at)};
    s.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return s;
}

static int free_port(void)
{
    struct sockaddr_in s = loopback(0);
    socklen_t n = sizeof s;
    int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_int_equal(bind(fd, (struct sockaddr *)&s, n), 0);
    assert_int_equal(getsockname(fd, (struct sockaddr *)&s, &n), 0);
    close(fd);
    return ntohs(s.sin_port);
}

static void run_quietly(const char *command)
{
    char line[2000];
    snprintf(line, sizeof line, "(cd %s && %s) >>%s/log 2>&1", tmpdir_root, command, tmpdir_root);
    if (system(line) != 0)
        fail_msg("failed: %s", line);
}

static void wait_for_port(void)
{
    struct sockaddr_in s = loopback(port);
    int rc = -1;
    for (int64_t end = now_ns() + PATIENCE_NS; rc != 0 && now_ns() < end;) {
        int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
        rc = connect(fd, (struct sockaddr *)&s, sizeof s);
        close(fd);
        if (rc != 0)
            poll(NULL, 0, 10);
    }
    if (rc != 0)
        fail_msg("%s does not listen on port %d", BROKER, port);
}

static void start_broker(const char *more)
{
    char conf[2000];
    if (access(BROKER, X_OK) != 0)
        fail_msg("%s is missing: the package mosquitto has it", BROKER);
    snprintf(conf, sizeof conf,
             "user root\npersistence false\nallow_anonymous true\nlistener %d 127.0.0.1\n%s\n",
             port, more);
    const char *path = tmpdir_text("broker.conf", conf), *log = tmpdir_path("log");
    broker = fork();
    if (broker == 0) {
        if (!freopen(log, "a", stderr))
            _exit(1);
        execl(BROKER, BROKER, "-c", path, (char *)NULL);
        _exit(1);
    }
    wait_for_port();
}

static void kill_broker(void)
{
    if (broker <= 0)
        return;
    kill(broker, SIGKILL);
    waitpid(broker, NULL, 0);
    broker = 0;
}

static int set_up(void **state)
{
    (void)state;
    tmpdir_make();
    port = free_port();
    broker = 0;
    a = b = NULL;
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    mqtt_close(a);
    mqtt_close(b);
    kill_broker();
    tmpdir_remove();
    return 0;
}

/* ---- clients ---- */

static struct mqtt_config config_of(const char *name)
{
    return (struct mqtt_config){.host = "127.0.0.1", .port = port, .client = name};
}

static struct mqtt *client_of(const char *name)
{
    struct mqtt_config c = config_of(name);
    struct mqtt *m;
    expect_ok(mqtt_open(&c, &m));
    return m;
}

static struct mqtt_event next_event(struct mqtt *m)
{
    struct mqtt_event e;
    for (int64_t end = now_ns() + PATIENCE_NS; now_ns() < end;) {
        struct pollfd p = {.fd = mqtt_fd(m), .events = POLLIN};
        poll(&p, 1, 100);
        if (mqtt_next(m, &e) == OK)
            return e;
    }
    fail_msg("no event");
    return (struct mqtt_event){0};
}

static void expect_up(struct mqtt *m)
{
    struct mqtt_event e = next_event(m);
    if (e.kind != MQTT_UP)
        fail_msg("event %d instead of up: %s%s", e.kind, e.why, e.topic);
}

static void expect_down(struct mqtt *m, const char *words)
{
    struct mqtt_event e = next_event(m);
    char head[64];
    snprintf(head, sizeof head, "broker 127.0.0.1:%d: ", port);
    if (e.kind != MQTT_DOWN || !strstr(e.why, words) || strncmp(e.why, head, strlen(head)) != 0)
        fail_msg("event %d, \"%s\" instead of down with \"%s\"", e.kind, e.why, words);
}

static void expect_message(struct mqtt *m, const char *topic, const char *text, bool retained)
{
    struct mqtt_event e = next_event(m);
    if (e.kind != MQTT_MESSAGE)
        fail_msg("event %d instead of a message: %s", e.kind, e.why);
    assert_string_equal(e.topic, topic);
    assert_string_equal(e.payload, text);
    assert_int_equal(e.n, strlen(text));
    assert_int_equal(e.retained, retained);
    mqtt_event_free(&e);
}

static void expect_silence(struct mqtt *m, int ms)
{
    struct mqtt_event e;
    struct pollfd p = {.fd = mqtt_fd(m), .events = POLLIN};
    assert_int_equal(poll(&p, 1, ms), 0);
    assert_int_equal(mqtt_next(m, &e), ERR_AGAIN);
}

/* ---- tests ---- */

static void both_ways_in_order(void **state)
{
    (void)state;
    char text[32];
    start_broker("");
    a = client_of("a");
    b = client_of("b");
    expect_ok(mqtt_subscribe(a, "rig/+/a", 1)); // before or after it is connected
    expect_up(a);
    expect_up(b);
    expect_ok(mqtt_publish(a, "rig/0/a", "x", 1, false)); // then the broker knows what a wants
    expect_message(a, "rig/0/a", "x", false);
    expect_ok(mqtt_subscribe(b, "rig/#", 1));
    expect_ok(mqtt_publish(b, "rig/wait", "x", 1, false));
    expect_message(b, "rig/wait", "x", false);
    for (int i = 0; i < 200; i++) {
        snprintf(text, sizeof text, "message %d", i);
        expect_ok(mqtt_publish(b, "rig/1/a", text, 1, false));
    }
    for (int i = 0; i < 200; i++) {
        snprintf(text, sizeof text, "message %d", i);
        expect_message(a, "rig/1/a", text, false);
        expect_message(b, "rig/1/a", text, false);
    }
    expect_ok(mqtt_publish(a, "rig/b", "", 1, false));
    expect_message(b, "rig/b", "", false);
    expect_silence(a, 50);
    char address[64];
    expect_ok(mqtt_address(a, address, sizeof address));
    assert_string_equal(address, "127.0.0.1");
    expect_err(mqtt_address(a, address, 4), ERR_LIMIT, "own address");
}

static void what_the_broker_keeps(void **state)
{
    (void)state;
    start_broker("");
    a = client_of("a");
    expect_up(a);
    for (int i = 0; i < 100; i++)
        expect_ok(mqtt_publish(a, "rig/a", i < 99 ? "many" : "hello", 1, true));
    mqtt_close(a); // what was published arrives all the same
    a = client_of("a");
    expect_ok(mqtt_subscribe(a, "rig/a", 1));
    expect_up(a);
    expect_message(a, "rig/a", "hello", true);
    expect_ok(mqtt_publish(a, "rig/a", "", 1, true));
    expect_message(a, "rig/a", "", false);
    b = client_of("b");
    expect_ok(mqtt_subscribe(b, "rig/a", 1));
    expect_up(b);
    expect_silence(b, 100);
}

/* The program once more, as a client that is killed or closes. */
static int run_client(const char *at, const char *how)
{
    struct mqtt_config c = {.host = "127.0.0.1",
                            .port = atoi(at),
                            .client = "member",
                            .will_topic = "rig/member",
                            .will = "gone"};
    struct mqtt *m;
    if (mqtt_open(&c, &m) != OK)
        return 1;
    for (struct mqtt_event e = {.kind = MQTT_DOWN}; e.kind != MQTT_UP;) {
        struct pollfd p = {.fd = mqtt_fd(m), .events = POLLIN};
        poll(&p, 1, 100);
        if (mqtt_next(m, &e) != OK)
            e.kind = MQTT_DOWN;
    }
    if (mqtt_subscribe(m, "rig/member", 1) != OK || mqtt_subscribe(m, "rig/+", 1) != OK ||
        mqtt_publish(m, "rig/member", "here", 1, true) != OK)
        return 1;
    if (strcmp(how, "close") != 0)
        poll(NULL, 0, 60000);
    mqtt_close(m);
    return 0;
}

static pid_t start_client(const char *how)
{
    char at[16];
    snprintf(at, sizeof at, "%d", port);
    pid_t child = fork();
    if (child == 0) {
        execl("/proc/self/exe", "mqtt_test", at, how, (char *)NULL);
        _exit(1);
    }
    return child;
}

static void the_last_will(void **state)
{
    (void)state;
    start_broker("");
    a = client_of("a");
    expect_ok(mqtt_subscribe(a, "rig/member", 1));
    expect_up(a);
    pid_t child;
    for (int i = 0; i < 5; i++) { // with messages under way to it
        child = start_client("close");
        expect_message(a, "rig/member", "here", false);
        waitpid(child, NULL, 0);
        expect_silence(a, 30);
    }
    child = start_client("wait");
    expect_message(a, "rig/member", "here", false);
    kill(child, SIGKILL);
    waitpid(child, NULL, 0);
    expect_message(a, "rig/member", "gone", false);
}

static void a_broker_that_goes_and_comes(void **state)
{
    (void)state;
    a = client_of("a");
    expect_down(a, "Connection refused");
    expect_err(mqtt_publish(a, "rig/a", "x", 1, false), ERR_LOST, "not connected");
    char address[64];
    expect_err(mqtt_address(a, address, sizeof address), ERR_LOST, "not connected");
    expect_ok(mqtt_subscribe(a, "rig/a", 1));
    start_broker("");
    expect_up(a);
    for (int i = 0; i < 2; i++) {
        expect_ok(mqtt_publish(a, "rig/a", "x", 1, false));
        expect_message(a, "rig/a", "x", false);
        kill_broker();
        expect_down(a, "lost");
        expect_err(mqtt_publish(a, "rig/a", "old", 1, false), ERR_LOST, "not connected");
        if (i == 0)
            expect_down(a, "Connection refused");
        start_broker("");
        struct mqtt_event e = next_event(a); // refused or not: it depends on who was faster
        if (e.kind == MQTT_DOWN)
            expect_up(a);
    }
    expect_silence(a, 100); // nothing old is sent
}

static void a_wrong_password(void **state)
{
    (void)state;
    char more[700];
    run_quietly("mosquitto_passwd -b -c passwords rig right");
    snprintf(more, sizeof more, "allow_anonymous false\npassword_file %s",
             tmpdir_path("passwords"));
    start_broker(more);
    struct mqtt_config c = config_of("a");
    c.user = "rig";
    c.password = "wrong";
    expect_ok(mqtt_open(&c, &a));
    expect_down(a, "Not authorized");
    expect_silence(a, 600); // the same reason again is no event
    c.password = "right";
    c.client = "b";
    expect_ok(mqtt_open(&c, &b));
    expect_up(b);
}

static void the_same_name_twice(void **state)
{
    (void)state;
    start_broker("");
    a = client_of("a");
    expect_up(a);
    b = client_of("a");
    expect_up(b);
    expect_down(a, ""); // later brokers say why
}

static void make_certificates(void)
{
    static const char key[] = "-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2";
    char line[1000];
    static const char *const names[] = {"ca", "otherca"};
    for (int i = 0; i < 2; i++) {
        snprintf(line, sizeof line, "openssl req -x509 %s -subj /CN=%s -keyout %s.key -out %s.pem",
                 key, names[i], names[i], names[i]);
        run_quietly(line);
    }
    tmpdir_text("san", "subjectAltName=DNS:localhost,IP:127.0.0.1\n");
    tmpdir_text("othersan", "subjectAltName=DNS:elsewhere.example\n");
    snprintf(line, sizeof line, "openssl req %s -subj /CN=broker -keyout broker.key -out b.csr",
             key);
    run_quietly(line);
    run_quietly("openssl x509 -req -in b.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days 2 "
                "-extfile san -out broker.pem");
    run_quietly("openssl x509 -req -in b.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days 2 "
                "-extfile othersan -out other.pem");
}

static void start_tls_broker(const char *certificate)
{
    char more[2000];
    snprintf(more, sizeof more, "certfile %s\nkeyfile %s", tmpdir_path(certificate),
             tmpdir_path("broker.key"));
    start_broker(more);
}

static void tls_proves_the_broker(void **state)
{
    (void)state;
    char text[20001] = {0};
    make_certificates();
    start_tls_broker("broker.pem");
    struct mqtt_config c = config_of("a");
    c.tls = true;
    c.ca = tmpdir_path("ca.pem");
    expect_ok(mqtt_open(&c, &a));
    expect_up(a);
    expect_ok(mqtt_subscribe(a, "rig/a", 1));
    memset(text, 'x', sizeof text - 1);
    for (int i = 0; i < 20; i++)
        expect_ok(mqtt_publish(a, "rig/a", text, 1, false));
    for (int i = 0; i < 20; i++)
        expect_message(a, "rig/a", text, false);

    c.ca = tmpdir_path("otherca.pem");
    c.client = "b";
    expect_ok(mqtt_open(&c, &b));
    expect_down(b, "certificate verify failed");
    mqtt_close(b);
    c.ca = tmpdir_path("san");
    expect_ok(mqtt_open(&c, &b));
    expect_down(b, "CA certificates");
    kill_broker();
    expect_down(a, "lost");
    start_tls_broker("other.pem");
    struct mqtt_event e = next_event(a);
    if (!strstr(e.why, "host name"))
        expect_down(a, "host name");
    mqtt_close(a);
    a = client_of("plain");
    expect_down(a, "lost");
}

static void more_than_is_read(void **state)
{
    (void)state;
    enum { N = MQTT_EVENTS_MAX + 300 };
    char text[32];
    start_broker("max_queued_messages 0");
    a = client_of("a");
    b = client_of("b");
    expect_ok(mqtt_subscribe(a, "many", 1));
    expect_ok(mqtt_subscribe(b, "many", 1));
    expect_up(b);
    struct pollfd p = {.fd = mqtt_fd(a), .events = POLLIN};
    assert_int_equal(poll(&p, 1, 30000), 1); // up, but not read
    for (int i = 0; i < N; i++) {
        snprintf(text, sizeof text, "%d", i);
        expect_ok(mqtt_publish(b, "many", text, 1, false));
        expect_message(b, "many", text, false);
    }
    poll(NULL, 0, 100);
    expect_up(a);
    snprintf(text, sizeof text, "%d", N - MQTT_EVENTS_MAX + 1);
    expect_message(a, "many", text, false);
    mqtt_close(a);
    a = client_of("a");
}

static void what_is_refused(void **state)
{
    (void)state;
    static char big[MQTT_PAYLOAD_MAX + 2], topic[MQTT_TOPIC_CAP + 1];
    struct mqtt *m;
    struct mqtt_config c = config_of("");
    expect_err(mqtt_open(&c, &m), ERR_ARG, "no name");
    assert_null(m);
    c.client = "a";
    c.port = 70000;
    expect_err(mqtt_open(&c, &m), ERR_ARG, "65535");
    c.port = port;
    c.tls = true;
    expect_err(mqtt_open(&c, &m), ERR_ARG, "authority");
    c.ca = tmpdir_path("nothing.pem");
    expect_err(mqtt_open(&c, &m), ERR_IO, "nothing.pem");
    c.tls = false;
    c.will_topic = "with/#";
    c.will = "x";
    expect_err(mqtt_open(&c, &m), ERR_ARG, "with/#");
    c.will_topic = "will";
    c.will = NULL;
    expect_err(mqtt_open(&c, &m), ERR_ARG, "last will");

    start_broker("message_size_limit 1000000");
    a = client_of("a");
    expect_up(a);
    memset(topic, 't', sizeof topic - 1);
    memset(big, 'x', sizeof big - 1);
    expect_err(mqtt_subscribe(a, "rig/#/a", 0), ERR_ARG, "rig/#/a");
    expect_err(mqtt_subscribe(a, topic, 0), ERR_ARG, "fewer than");
    expect_err(mqtt_subscribe(a, "rig", 3), ERR_ARG, "QoS");
    expect_err(mqtt_publish(a, "rig/+", "x", 0, false), ERR_ARG, "rig/+");
    expect_err(mqtt_publish(a, topic, "x", 0, false), ERR_ARG, "at most 127");
    expect_err(mqtt_publish(a, "rig", big, 0, false), ERR_LIMIT, "at most 65536");
    expect_ok(mqtt_subscribe(a, "rig", 1));
    big[MQTT_PAYLOAD_MAX] = 0;
    expect_ok(mqtt_publish(a, "rig", big, 1, false));
    expect_message(a, "rig", big, false);
    for (int i = 1; i < MQTT_FILTERS_MAX; i++) {
        snprintf(topic, sizeof topic, "f/%d", i);
        expect_ok(mqtt_subscribe(a, topic, 0));
    }
    expect_ok(mqtt_subscribe(a, "f/1", 1));
    expect_err(mqtt_subscribe(a, "one/more", 0), ERR_LIMIT, "32 already");
}

/* As another program may, by the library itself. */
static void publish_any(const char *topic, const char *bytes, int n)
{
    struct mosquitto *c = mosquitto_new("other", true, NULL);
    assert_non_null(c);
    assert_int_equal(mosquitto_connect(c, "127.0.0.1", port, 10), 0);
    assert_int_equal(mosquitto_publish(c, NULL, topic, n, bytes, 1, false), 0);
    for (int64_t end = now_ns() + PATIENCE_NS; mosquitto_want_write(c) && now_ns() < end;)
        assert_int_equal(mosquitto_loop(c, 100, 1), 0);
    for (int i = 0; i < 5; i++)
        mosquitto_loop(c, 10, 1);
    mosquitto_disconnect(c);
    mosquitto_destroy(c);
}

/* Messages of other programs have any length, and topics too. */
static void longer_messages_do_not_arrive(void **state)
{
    (void)state;
    static char big[200000];
    char topic[MQTT_TOPIC_CAP + 1] = {0};
    start_broker("");
    a = client_of("a");
    expect_ok(mqtt_subscribe(a, "#", 1));
    expect_up(a);
    memset(topic, 't', sizeof topic - 1);
    publish_any("rig", big, sizeof big);
    publish_any("rig", big, MQTT_PAYLOAD_MAX + 1);
    publish_any(topic, "x", 1);
    topic[MQTT_TOPIC_CAP - 1] = 0;
    publish_any(topic, "x", 1);
    expect_message(a, topic, "x", false);
    publish_any("rig", big, 3); // bytes of 0 are bytes
    struct mqtt_event e = next_event(a);
    assert_int_equal(e.n, 3);
    assert_memory_equal(e.payload, big, 4);
    mqtt_event_free(&e);
    expect_silence(a, 50);
}

/* ---- names ---- */

enum { SLOW_MS = 3000 };
static atomic_bool asked, resolved;

/* The resolver of the C library, with one name that takes its time. */
int getaddrinfo(const char *name, const char *service, const struct addrinfo *hints,
                struct addrinfo **out)
{
    typedef int resolver(const char *, const char *, const struct addrinfo *, struct addrinfo **);
    resolver *real = (resolver *)(uintptr_t)dlsym(RTLD_NEXT, "getaddrinfo");
    if (!name || strcmp(name, "slow.invalid") != 0)
        return real(name, service, hints, out);
    atomic_store(&asked, true);
    poll(NULL, 0, SLOW_MS);
    atomic_store(&resolved, true);
    return EAI_AGAIN;
}

/* Nothing can interrupt a resolver: its thread is left to itself. */
static void a_slow_resolver(void **state)
{
    (void)state;
    struct mqtt_config c = config_of("a");
    c.host = "slow.invalid";
    int64_t start = now_ns();
    expect_ok(mqtt_open(&c, &a));
    assert_true(now_ns() - start < 1000000000);
    while (!asked)
        poll(NULL, 0, 1);
    mqtt_close(a);
    a = NULL;
    assert_true(now_ns() - start < SLOW_MS * 1000000LL && !resolved);
    while (!resolved)
        poll(NULL, 0, 10);
    poll(NULL, 0, 50); // it frees what it has
}

static void hosts_that_do_not_answer(void **state)
{
    (void)state;
    struct mqtt_config c = config_of("a");
    c.host = "192.0.2.1"; // RFC 5737: nobody has it
    expect_ok(mqtt_open(&c, &a));
    poll(NULL, 0, 50);
    int64_t start = now_ns();
    mqtt_close(a);
    assert_true(now_ns() - start < 5000000000);
    c.host = "no-such-host.invalid";
    expect_ok(mqtt_open(&c, &a));
    start = now_ns();
    mqtt_close(a);
    a = NULL;
    mqtt_close(NULL);
    assert_true(now_ns() - start < 5000000000);
}

static void urls(void **state)
{
    (void)state;
    static const struct {
        const char *url, *host;
        int port;
        bool tls;
    } good[] = {
        {"mqtt://broker", "broker", 1883, false},
        {"mqtts://rig-1.local", "rig-1.local", 8883, true},
        {"mqtts://10.0.0.7:1", "10.0.0.7", 1, true},
        {"mqtt://[fe80::1]", "fe80::1", 1883, false},
        {"mqtts://[::1]:65535", "::1", 65535, true},
    };
    struct mqtt_url u;
    for (size_t i = 0; i < sizeof good / sizeof good[0]; i++) {
        expect_ok(mqtt_parse_url(good[i].url, &u));
        assert_string_equal(u.host, good[i].host);
        assert_int_equal(u.port, good[i].port);
        assert_int_equal(u.tls, good[i].tls);
    }
    static const char *const bad[][2] = {
        {"", "mqtts://HOST"},          {"broker", "mqtts://HOST"},
        {"http://broker", "mqtts:"},   {"mqtt:/broker", "mqtts:"},
        {"MQTT://broker", "mqtts:"},   {"mqtt://", "the host"},
        {"mqtt://:1883", "the host"},  {"mqtt://a b", "the host"},
        {"mqtt://u:p@host", "65535"},  {"mqtt://a/b", "the host"},
        {"mqtt://[::1", "the host"},   {"mqtt://[]", "the host"},
        {"mqtt://[host]", "the host"}, {"mqtt://[::1]x", "65535"},
        {"mqtt://a:", "65535"},        {"mqtt://a:0", "65535"},
        {"mqtt://a:65536", "65535"},   {"mqtt://a:99999999999", "65535"},
        {"mqtt://a:1x", "65535"},      {"mqtt://a:-1", "65535"},
        {"mqtt://a:1/", "65535"},      {"mqtt://a: 1", "65535"},
    };
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        expect_err(mqtt_parse_url(bad[i][0], &u), ERR_ARG, bad[i][1]);
        assert_string_equal(u.host, "");
    }
    char url[400] = "mqtt://";
    memset(url + 7, 'h', MQTT_HOST_CAP - 1);
    expect_ok(mqtt_parse_url(url, &u));
    url[7 + MQTT_HOST_CAP - 1] = 'h';
    expect_err(mqtt_parse_url(url, &u), ERR_ARG, "fewer than 256");
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(both_ways_in_order, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_the_broker_keeps, set_up, tear_down),
        cmocka_unit_test_setup_teardown(the_last_will, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_broker_that_goes_and_comes, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_wrong_password, set_up, tear_down),
        cmocka_unit_test_setup_teardown(the_same_name_twice, set_up, tear_down),
        cmocka_unit_test_setup_teardown(tls_proves_the_broker, set_up, tear_down),
        cmocka_unit_test_setup_teardown(more_than_is_read, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_is_refused, set_up, tear_down),
        cmocka_unit_test_setup_teardown(longer_messages_do_not_arrive, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_slow_resolver, set_up, tear_down),
        cmocka_unit_test_setup_teardown(hosts_that_do_not_answer, set_up, tear_down),
        cmocka_unit_test(urls),
    };
    signal(SIGPIPE, SIG_IGN);
    if (argc == 3)
        return run_client(argv[1], argv[2]);
    return cmocka_run_group_tests(tests, NULL, NULL);
}
