/* The status page as browsers, scripts and strangers see it. */
#include "firmware/daemon/http.h"

#include "tests/unit/tmpdir.h"

#include <arpa/inet.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

static struct http *h;
static char captures[128], results[128], commanded[64], reply[1 << 16];
static err_t command_err;
#define PATIENCE_NS 60000000000 // a busy machine takes its time
static int64_t patience_ns;     // for an answer

static void status(void *ctx, FILE *f)
{
    (void)ctx;
    fputs("{\"state\": \"armed\"}", f);
}

static err_t command(void *ctx, const char *line)
{
    (void)ctx;
    snprintf(commanded, sizeof commanded, "%s", line);
    return command_err ? err_fail(command_err, "a \"capture\" runs") : OK;
}

static err_t live(void *ctx, int camera, void **jpeg, size_t *n)
{
    (void)ctx;
    if (camera > 0)
        return err_fail(ERR_ARG, "camera %d of 1", camera);
    *jpeg = strdup("a jpeg");
    *n = 6;
    return OK;
}

static void open_rig(const char *token, const char *parts_token)
{
    struct http_config c = {"127.0.0.1", 0,      token,   captures, results,
                            NULL,        status, command, live,     parts_token};
    assert_int_equal(http_open(&c, &h), OK);
}

static void open_page(const char *token)
{
    open_rig(token, NULL);
}

static int set_up(void **state)
{
    (void)state;
    tmpdir_make();
    snprintf(captures, sizeof captures, "%s", tmpdir_path("captures"));
    snprintf(results, sizeof results, "%s", tmpdir_path("results"));
    mkdir(captures, 0755);
    mkdir(tmpdir_path("captures/b-1"), 0755);
    mkdir(tmpdir_path("captures/.tmp-x"), 0755);
    tmpdir_text("captures/b-1/manifest.json", "{\"n\": 1}");
    tmpdir_text("captures/.tmp-x/manifest.json", "half");
    tmpdir_text("secret", "secret");
    assert_int_equal(symlink("../../secret", tmpdir_path("captures/b-1/link.json")), 0);
    assert_int_equal(symlink("..", tmpdir_path("captures/up")), 0);
    h = NULL;
    commanded[0] = 0;
    command_err = OK;
    patience_ns = PATIENCE_NS;
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    http_close(h);
    tmpdir_remove();
    return 0;
}

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

/* Send a request as it stands; the status code, 0 if the connection was closed without one. */
static int ask_raw(const char *text)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons((uint16_t)http_port(h))};
    size_t n = 0;
    int code = 0;
    inet_pton(AF_INET, "127.0.0.1", &a.sin_addr);
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    assert_int_equal(connect(fd, (struct sockaddr *)&a, sizeof a), 0);
    assert_true(send(fd, text, strlen(text), MSG_NOSIGNAL) > 0);
    int64_t end = now_ns() + patience_ns;
    for (ssize_t got = 1; got != 0 && now_ns() < end;) {
        int64_t deadline = now_ns() + 20000000;
        struct pollfd p = http_poll(h, now_ns(), &deadline);
        poll(&p, 1, 10);
        http_step(h);
        got = recv(fd, reply + n, sizeof reply - 1 - n, MSG_DONTWAIT);
        n += got > 0 ? (size_t)got : 0;
    }
    close(fd);
    http_step(h);
    reply[n] = 0;
    sscanf(reply, "HTTP/1.1 %d", &code);
    return code;
}

static int request_exposure(const char *method, const char *url, const char *headers)
{
    char text[2000];
    snprintf(text, sizeof text,
             "%s %s HTTP/1.1\r\nHost: localhost:80\r\nConnection: close\r\n%s\r\n", method, url,
             headers);
    return ask_raw(text);
}

static bool says(const char *text)
{
    return strstr(reply, text) != NULL;
}

static void the_page_and_the_state(void **state)
{
    (void)state;
    open_page("");
    assert_int_equal(request_exposure("GET", "/", ""), 200);
    assert_true(says("<!doctype html>") && says("</html>") && says("default-src 'self'"));
    assert_int_equal(request_exposure("GET", "/page.js", ""), 200);
    assert_true(says("text/javascript") && says("setInterval"));
    assert_int_equal(request_exposure("GET", "/rig.js", ""), 200);
    assert_true(says("text/javascript") && says("showRig"));
    assert_int_equal(request_exposure("GET", "/page.css", ""), 200);
    assert_int_equal(request_exposure("GET", "/status.json", ""), 200);
    assert_true(says("{\"state\": \"armed\"}"));
    assert_int_equal(request_exposure("GET", "/nothing", ""), 404);
    assert_int_equal(request_exposure("GET", "/live/0.jpg?123", ""), 200);
    assert_true(says("image/jpeg") && says("a jpeg"));
    assert_int_equal(request_exposure("GET", "/live/1.jpg", ""), 404);
    assert_true(says("camera 1 of 1"));
    static const char *const no[] = {"/live/.jpg", "/live/-1.jpg", "/live/0.png",
                                     "/live/99999999999.jpg", "/live/"};
    for (size_t i = 0; i < sizeof no / sizeof no[0]; i++)
        assert_int_equal(request_exposure("GET", no[i], ""), 404);
    assert_int_equal(request_exposure("PUT", "/status.json", ""), 405);
}

static void only_files_of_results_are_served(void **state)
{
    (void)state;
    open_page("");
    assert_int_equal(request_exposure("GET", "/captures/b-1/manifest.json", ""), 200);
    assert_true(says("application/json") && says("{\"n\": 1}"));
    static const char *const no[] = {
        "/captures/b-1",
        "/captures/b-1/",
        "/captures/",
        "/captures/../secret",
        "/captures/b-1/../../secret",
        "/captures/%2e%2e/secret",
        "/captures/b-1/link.json",
        "/captures/up/secret",
        "/captures//etc/passwd",
        "/captures/.tmp-x/manifest.json",
        "/results/x/report.json",
        "/captures/a/b/c/d/e/f",
    };
    for (size_t i = 0; i < sizeof no / sizeof no[0]; i++)
        if (request_exposure("GET", no[i], "") != 404)
            fail_msg("%s: %s", no[i], reply);
}

static void put_result(void)
{
    mkdir(results, 0755);
    mkdir(tmpdir_path("results/b-1"), 0755);
    tmpdir_text("results/b-1/view.html", "<!doctype html>");
}

/* Pages of results have their scripts inside; these may ask nobody, not even the daemon. */
static void pages_of_results(void **state)
{
    (void)state;
    put_result();
    open_page("");
    assert_int_equal(request_exposure("GET", "/results/b-1/view.html", ""), 200);
    assert_true(says("text/html") && says("script-src 'unsafe-inline'") &&
                says("default-src 'none'"));
    assert_false(says("connect-src") || says("default-src 'self'"));
    assert_int_equal(request_exposure("GET", "/", ""), 200);
    assert_false(says("unsafe-inline"));
}

/* The header and the body of an answer to a request for a range. */
static void expect_part(const char *range, int code, const char *content_range, const char *body)
{
    char header[200];
    snprintf(header, sizeof header, "Range: %s\r\n", range);
    int got = request_exposure("GET", "/captures/b-1/digits", header);
    const char *begin = strstr(reply, "\r\n\r\n");
    if (got != code || !begin || strcmp(begin + 4, body) != 0 || !says(content_range))
        fail_msg("%s: %s", range, reply);
    if (!*content_range && says("Content-Range"))
        fail_msg("%s: %s", range, reply);
    if (code != 416) {
        assert_true(says("Accept-Ranges: bytes"));
        snprintf(header + strlen(header), 64, "Content-Length: 0\r\n");
        assert_int_equal(request_exposure("HEAD", "/captures/b-1/digits", header), code);
        begin = strstr(reply, "\r\n\r\n");
        assert_string_equal(begin + 4, "");
        snprintf(header, sizeof header, "Content-Length: %zu\r\n", strlen(body));
        assert_true(says(header) && says(content_range));
    }
}

static void ranges_of_files(void **state)
{
    (void)state;
    tmpdir_text("captures/b-1/digits", "0123456789");
    tmpdir_text("captures/b-1/empty", "");
    open_page("");
    expect_part("bytes=0-", 206, "Content-Range: bytes 0-9/10", "0123456789");
    expect_part("bytes=4-", 206, "Content-Range: bytes 4-9/10", "456789");
    expect_part("bytes=9-", 206, "Content-Range: bytes 9-9/10", "9");
    expect_part("bytes=4-6", 206, "Content-Range: bytes 4-6/10", "456");
    expect_part("bytes=4-4", 206, "Content-Range: bytes 4-4/10", "4");
    expect_part("bytes=4-999999999999", 206, "Content-Range: bytes 4-9/10", "456789");
    expect_part("bytes=10-", 416, "Content-Range: bytes */10", "");
    expect_part("bytes=10-20", 416, "Content-Range: bytes */10", "");
    expect_part("bytes=999999999999999999-", 416, "Content-Range: bytes */10", "");
    static const char *const ignored[] = {
        "bytes=-3",
        "bytes=",
        "bytes=-",
        "bytes=5",
        "bytes=5-4",
        "bytes=1-2,4-5",
        "bytes=a-",
        "bytes=1-b",
        "bytes= 1-",
        "bytes=+1-",
        "lines=1-2",
        "bytes 1-2",
        "bytes=1-2-",
        "bytes=1--2",
        "bytes=99999999999999999999-",
        "bytes=0-99999999999999999999",
    };
    for (size_t i = 0; i < sizeof ignored / sizeof ignored[0]; i++)
        expect_part(ignored[i], 200, "", "0123456789");
    assert_int_equal(
        request_exposure("GET", "/captures/b-1/digits", "Range: bytes=4-\r\nIf-Range: \"x\"\r\n"),
        200);
    assert_int_equal(request_exposure("GET", "/captures/b-1/empty", "Range: bytes=0-\r\n"), 416);
    assert_true(says("bytes */0"));
    assert_int_equal(request_exposure("GET", "/captures/b-1/empty", ""), 200);
    assert_int_equal(request_exposure("GET", "/captures/b-1/none", "Range: bytes=0-\r\n"), 404);
    assert_int_equal(request_exposure("GET", "/status.json", "Range: bytes=0-1\r\n"), 200);
}

#define RIG "Authorization: Bearer rig-token\r\n"

static void parts_have_their_token(void **state)
{
    (void)state;
    static const char *const tokens[] = {"", "page-token"};
    for (int i = 0; i < 2; i++) {
        open_rig(tokens[i], "rig-token");
        assert_int_equal(request_exposure("GET", "/parts/b-1/manifest.json", RIG), 200);
        assert_true(says("{\"n\": 1}"));
        assert_int_equal(
            request_exposure("GET", "/parts/b-1/manifest.json", RIG "Range: bytes=1-3\r\n"), 206);
        assert_int_equal(ask_raw("HEAD /parts/b-1/manifest.json HTTP/1.1\r\nConnection: close\r\n"
                                 "Host: member-2.rig.example:8080\r\n" RIG "\r\n"),
                         200);
        assert_int_equal(
            request_exposure("POST", "/parts/b-1/manifest.json", RIG "Content-Length: 0\r\n"), 405);
        static const char *const others[] = {"",
                                             "Authorization: Bearer page-token\r\n",
                                             "Cookie: hdrig=page-token\r\n",
                                             "Cookie: hdrig=rig-token\r\n",
                                             "Authorization: Bearer rig-toke\r\n",
                                             "Authorization: Bearer \r\n",
                                             "Authorization: rig-token\r\n"};
        for (size_t k = 0; k < sizeof others / sizeof others[0]; k++)
            assert_int_equal(request_exposure("GET", "/parts/b-1/manifest.json", others[k]), 401);
        static const char *const no[] = {"/parts/",           "/parts/b-1",
                                         "/parts/../secret",  "/parts/b-1/link.json",
                                         "/parts/up/secret",  "/parts/.tmp-x/manifest.json",
                                         "/parts//etc/passwd"};
        for (size_t k = 0; k < sizeof no / sizeof no[0]; k++)
            if (request_exposure("GET", no[k], RIG) != 404)
                fail_msg("%s: %s", no[k], reply);
        http_close(h);
    }
    open_rig("page-token", "rig-token"); // it opens nothing else
    assert_int_equal(request_exposure("GET", "/captures/b-1/manifest.json", RIG), 401);
    assert_int_equal(request_exposure("GET", "/status.json", RIG), 401);
    assert_int_equal(request_exposure("GET", "/parts", RIG), 401);
    assert_int_equal(
        request_exposure("POST", "/capture", RIG "X-Hdrig: 1\r\nContent-Length: 0\r\n"), 401);
    assert_string_equal(commanded, "");
}

static void no_parts_without_a_token(void **state)
{
    (void)state;
    static const char *const none[] = {NULL, ""};
    for (int i = 0; i < 2; i++) {
        open_rig("", none[i]);
        assert_int_equal(request_exposure("GET", "/parts/b-1/manifest.json", ""), 404);
        assert_int_equal(
            request_exposure("GET", "/parts/b-1/manifest.json", "Authorization: Bearer \r\n"), 404);
        http_close(h);
    }
    struct http_config c = {
        .address = "127.0.0.1", .token = "", .results = results, .parts_token = "rig-token"};
    assert_int_equal(http_open(&c, &h), OK); // there are no captures
    assert_int_equal(request_exposure("GET", "/parts/b-1/manifest.json", RIG), 404);
}

static void results_alone(void **state)
{
    (void)state;
    struct http_config c = {.address = "127.0.0.1", .token = "", .results = results};
    put_result();
    assert_int_equal(http_open(&c, &h), OK);
    assert_int_equal(request_exposure("GET", "/results/b-1/view.html", ""), 200);
    assert_int_equal(request_exposure("GET", "/", ""), 404);
    assert_int_equal(request_exposure("GET", "/status.json", ""), 404);
    assert_int_equal(request_exposure("GET", "/captures/b-1/manifest.json", ""), 404);
    assert_int_equal(request_exposure("POST", "/capture", "X-Hdrig: 1\r\nContent-Length: 0\r\n"),
                     405);
}

static void commands_need_the_header(void **state)
{
    (void)state;
    open_page("");
    assert_int_equal(request_exposure("POST", "/capture", "Content-Length: 0\r\n"), 403);
    assert_string_equal(commanded, "");
    assert_int_equal(request_exposure("GET", "/capture", "X-Hdrig: 1\r\n"), 404);
    assert_int_equal(request_exposure("POST", "/capture", "X-Hdrig: 1\r\nContent-Length: 0\r\n"),
                     200);
    assert_string_equal(commanded, "capture");
    assert_int_equal(
        request_exposure("POST", "/session/end", "X-Hdrig: 1\r\nContent-Length: 0\r\n"), 200);
    assert_string_equal(commanded, "session end");
    assert_int_equal(
        request_exposure("POST", "/session/scene", "X-Hdrig: 1\r\nContent-Length: 0\r\n"), 200);
    assert_string_equal(commanded, "session scene");
    assert_int_equal(request_exposure("POST", "/session", "X-Hdrig: 1\r\nContent-Length: 0\r\n"),
                     405);
    command_err = ERR_BUSY;
    assert_int_equal(request_exposure("POST", "/cancel", "X-Hdrig: 1\r\nContent-Length: 0\r\n"),
                     409);
    assert_string_equal(commanded, "cancel");
    assert_true(says("\"error\": \"a \\\"capture\\\" runs\""));
    commanded[0] = 0;
    static const char *const values[] = {"", "0", "2", "11", "yes", "1, 1"};
    for (size_t i = 0; i < sizeof values / sizeof values[0]; i++) {
        char header[64];
        snprintf(header, sizeof header, "X-Hdrig: %s\r\nContent-Length: 0\r\n", values[i]);
        assert_int_equal(request_exposure("POST", "/capture", header), 403);
    }
    assert_string_equal(commanded, "");
}

static void other_names_are_refused(void **state)
{
    (void)state;
    open_page("");
    const char *request = "GET /status.json HTTP/1.1\r\nConnection: close\r\nHost: %s\r\n\r\n";
    static const char *const hosts[] = {
        "evil.example", "evil.example:8080", "localhost.evil.example", "127.0.0.1.evil.example", "",
        "[::1"};
    char text[300];
    for (size_t i = 0; i < sizeof hosts / sizeof hosts[0]; i++) {
        snprintf(text, sizeof text, request, hosts[i]);
        assert_int_equal(ask_raw(text), 403);
    }
    assert_int_equal(ask_raw("GET /status.json HTTP/1.0\r\n\r\n"), 403); // names no host at all
    static const char *const own[] = {"127.0.0.1:8080", "192.168.1.7", "[::1]:8080", "LOCALHOST"};
    for (size_t i = 0; i < sizeof own / sizeof own[0]; i++) {
        snprintf(text, sizeof text, request, own[i]);
        assert_int_equal(ask_raw(text), 200);
    }
}

static void a_token_guards_everything(void **state)
{
    (void)state;
    open_page("open-sesame");
    assert_int_equal(request_exposure("GET", "/", ""), 401);
    assert_true(says("<form method=post"));
    assert_int_equal(request_exposure("GET", "/status.json", ""), 401);
    assert_int_equal(request_exposure("GET", "/captures/b-1/manifest.json", ""), 401);
    assert_int_equal(request_exposure("POST", "/capture", "X-Hdrig: 1\r\nContent-Length: 0\r\n"),
                     401);
    assert_string_equal(commanded, "");
    assert_int_equal(
        request_exposure("GET", "/status.json", "Authorization: Bearer open-sesam\r\n"), 401);
    assert_int_equal(
        request_exposure("GET", "/status.json", "Authorization: Bearer open-sesamee\r\n"), 401);
    assert_int_equal(request_exposure("GET", "/status.json", "Authorization: Bearer \r\n"), 401);
    assert_int_equal(
        request_exposure("GET", "/status.json", "Authorization: Bearer open-sesame\r\n"), 200);
    assert_int_equal(request_exposure("GET", "/status.json", "Cookie: hdrig=open-sesame\r\n"), 200);
    assert_int_equal(request_exposure("POST", "/login", "Content-Length: 9\r\n\r\ntoken=foo"), 401);
    assert_int_equal(
        request_exposure("POST", "/login", "Content-Length: 17\r\n\r\ntoken=open-sesame"), 303);
    assert_true(says("Set-Cookie: hdrig=open-sesame; HttpOnly; SameSite=Strict"));

    /* the longest body, and one byte more: it would lack its final 0 */
    char text[700];
    for (int n = 511; n <= 512; n++) {
        snprintf(text, sizeof text, "Content-Length: %d\r\n\r\ntoken=%0*d", n, n - 6, 0);
        patience_ns = n == 511 ? PATIENCE_NS : 300000000;
        assert_int_equal(request_exposure("POST", "/login", text), n == 511 ? 401 : 0);
    }
}

/* ---- many at once ---- */

static int connection(void)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons((uint16_t)http_port(h))};
    inet_pton(AF_INET, "127.0.0.1", &a.sin_addr);
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    assert_int_equal(connect(fd, (struct sockaddr *)&a, sizeof a), 0);
    return fd;
}

/* Whoever connects and says little or nothing does not lock others out. */
static void slow_and_idle_connections(void **state)
{
    (void)state;
    enum { N = 200 };
    int fd[N];
    static const char part[] = "GET / HTTP/1.1\r\nHost: local";
    open_page("");
    for (int i = 0; i < N; i++) {
        fd[i] = connection();
        if (i % 2)
            assert_true(send(fd[i], part, sizeof part - 1, MSG_NOSIGNAL) > 0);
        if (i % 16 == 0) // else the queue of the socket is full, and connect waits for us
            http_step(h);
    }
    int64_t start = now_ns();
    assert_int_equal(request_exposure("GET", "/status.json", ""), 200);
    assert_true(now_ns() - start < 9000000000); // before any of them has had its 10 s
    for (int i = 0; i < N; i++)
        close(fd[i]);
    assert_int_equal(request_exposure("GET", "/status.json", ""), 200);
}

/* Cameras may need seconds for each turn of the loop: a page is there after one. */
static void one_turn_serves_a_page(void **state)
{
    static const char get[] = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    static char got[1 << 17];
    (void)state;
    open_page("");
    int fd = connection();
    assert_int_equal(send(fd, get, sizeof get - 1, 0), sizeof get - 1);
    http_step(h);
    size_t n = 0;
    for (ssize_t k = 1; k > 0; n += k > 0 ? (size_t)k : 0)
        k = recv(fd, got + n, sizeof got - 1 - n, MSG_DONTWAIT);
    got[n] = '\0';
    assert_non_null(strstr(got, "200 OK"));
    assert_non_null(strstr(got, "</html>"));
    close(fd);
}

static void hostile_requests(void **state)
{
    (void)state;
    static char big[9000];
    open_page("");
    patience_ns = 200000000; // some are never answered
    memset(big, 'a', sizeof big - 1);
    ask_raw(big); // with any answer it must go on
    ask_raw("\r\n\r\n\r\n");
    ask_raw("GET\r\n\r\n");
    assert_int_equal(request_exposure("POST", "/capture", "X-Hdrig: 1\r\nContent-Length: 5000\r\n"),
                     0);
    snprintf(big, sizeof big,
             "POST /capture HTTP/1.1\r\nHost: localhost\r\nX-Hdrig: 1\r\n"
             "Connection: close\r\nContent-Length: 5000\r\n\r\n%05000d",
             0);
    assert_int_equal(ask_raw(big), 0);
    assert_string_equal(commanded, "");
    patience_ns = PATIENCE_NS;
    assert_int_equal(request_exposure("GET", "/status.json", ""), 200);
}

static void what_cannot_be_opened(void **state)
{
    (void)state;
    struct http *other;
    struct http_config c = {"nowhere", 0, "", captures, results, NULL, status, command, live, NULL};
    assert_int_equal(http_open(&c, &other), ERR_ARG);
    assert_null(other);
    c.address = "127.0.0.1";
    c.token = "two words";
    assert_int_equal(http_open(&c, &other), ERR_ARG);
    c.token = "";
    c.parts_token = "two words";
    assert_int_equal(http_open(&c, &other), ERR_ARG);
    c.parts_token = NULL;
    open_page("");
    c.token = "";
    c.port = http_port(h);
    assert_int_equal(http_open(&c, &other), ERR_BUSY);
    c.address = "::1";
    c.port = 0;
    if (http_open(&c, &other) == OK) // where there is IPv6
        http_close(other);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(the_page_and_the_state, set_up, tear_down),
        cmocka_unit_test_setup_teardown(only_files_of_results_are_served, set_up, tear_down),
        cmocka_unit_test_setup_teardown(pages_of_results, set_up, tear_down),
        cmocka_unit_test_setup_teardown(ranges_of_files, set_up, tear_down),
        cmocka_unit_test_setup_teardown(parts_have_their_token, set_up, tear_down),
        cmocka_unit_test_setup_teardown(no_parts_without_a_token, set_up, tear_down),
        cmocka_unit_test_setup_teardown(results_alone, set_up, tear_down),
        cmocka_unit_test_setup_teardown(commands_need_the_header, set_up, tear_down),
        cmocka_unit_test_setup_teardown(other_names_are_refused, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_token_guards_everything, set_up, tear_down),
        cmocka_unit_test_setup_teardown(slow_and_idle_connections, set_up, tear_down),
        cmocka_unit_test_setup_teardown(one_turn_serves_a_page, set_up, tear_down),
        cmocka_unit_test_setup_teardown(hostile_requests, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_cannot_be_opened, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
