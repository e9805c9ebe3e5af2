/* Files from the status page, and from servers that break off, stall and lie. */
#include "drivers/net/fetch.h"

#include "core/base/sha256.h"
#include "firmware/daemon/http.h"
#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <arpa/inet.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { BYTES = 300000, BEGIN = 900 };

/* What the server does with a request for the file. */
enum manner {
    HONEST,
    WHOLE,       // knows no ranges
    CUT,         // the first answer ends after `cut` bytes
    STALLED,     // answers BEGIN bytes and no more
    SILENT,      // does not answer
    LONGER,      // announces and sends one byte more
    ENDLESS,     // sends without a length, for ever
    SHORTER,     // announces and sends one byte less
    OTHER_RANGE, // one byte further than asked
    OTHER_BYTES, // the last one is wrong
    HEADERS,     // without end
    NOISE,       // is no HTTP
    BRIEF        // ends the connection after its answer, unannounced
};

static struct {
    int listener, port;
    pthread_t thread;
    enum manner manner;
    int status; // instead of 200 and 206
    size_t cut;
    atomic_int connections, requests, ranges, alive;
    char request[2000]; // the last
} server;

static uint8_t content[BYTES];
static char hash[SHA256_HEX_CAP], url[64];
static const char *path;
static struct fetcher *fetcher;

/* ---- the server ---- */

static bool send_all(int fd, const void *p, size_t n)
{
    for (size_t i = 0; i < n;) {
        ssize_t put = send(fd, (const char *)p + i, n - i, MSG_NOSIGNAL);
        if (put <= 0)
            return false;
        i += (size_t)put;
    }
    return true;
}

static void wait_for_end(int fd)
{
    char c;
    while (recv(fd, &c, 1, 0) > 0)
        continue;
}

static bool send_endlessly(int fd, const char *head, const char *text)
{
    bool ok = send_all(fd, head, strlen(head));
    while (ok)
        ok = send_all(fd, text, strlen(text));
    return false;
}

/* The answer of the kind for bytes from `from` on; false: the connection ends. */
static bool send_part(int fd, size_t from, bool part)
{
    char head[300], range[100] = "";
    size_t n = BYTES - from;
    size_t length = server.manner == LONGER ? n + 1 : server.manner == SHORTER ? n - 1 : n;
    if (part)
        snprintf(range, sizeof range, "Content-Range: bytes %zu-%d/%d\r\n",
                 from + (server.manner == OTHER_RANGE), BYTES - 1, BYTES);
    snprintf(head, sizeof head, "HTTP/1.1 %s\r\n%sContent-Length: %zu\r\n\r\n",
             part ? "206 Partial Content" : "200 OK", range, length);
    if (!send_all(fd, head, strlen(head)))
        return false;
    if (server.manner == CUT) {
        server.manner = HONEST;
        send_all(fd, content + from, server.cut);
        return false;
    }
    if (server.manner == STALLED) {
        send_all(fd, content + from, BEGIN);
        wait_for_end(fd);
        return false;
    }
    if (server.manner == OTHER_BYTES) {
        send_all(fd, content + from, n - 1);
        return send_all(fd, "?", 1);
    }
    size_t most = length < n ? length : n;
    return send_all(fd, content + from, most) && (length <= n || send_all(fd, "x", length - n));
}

static bool answer(int fd, const char *request)
{
    char text[200];
    size_t from = 0;
    const char *range = strstr(request, "Range: bytes=");
    bool part = range && server.manner != WHOLE;
    atomic_fetch_add(&server.requests, 1);
    atomic_fetch_add(&server.ranges, part);
    if (part)
        sscanf(range, "Range: bytes=%zu-", &from);
    if (server.status) {
        snprintf(text, sizeof text, "HTTP/1.1 %d No\r\nContent-Length: 5\r\n\r\nsorry",
                 server.status);
        return send_all(fd, text, strlen(text));
    }
    switch (server.manner) {
    case SILENT:
        wait_for_end(fd);
        return false;
    case ENDLESS:
        return send_endlessly(fd, "HTTP/1.1 200 OK\r\n\r\n", "more and more");
    case HEADERS:
        return send_endlessly(fd, "HTTP/1.1 200 OK\r\n", "X-More: and more\r\n");
    case NOISE:
        send_all(fd, "hello\r\n\r\nhello\r\n", 16);
        return false;
    default:
        return send_part(fd, from, part) && server.manner != BRIEF;
    }
}

static void *serve(void *ctx)
{
    int fd = (int)(intptr_t)ctx;
    char request[sizeof server.request];
    bool on = true;
    while (on) {
        size_t n = 0;
        ssize_t got = 1;
        for (request[0] = 0; got > 0 && !strstr(request, "\r\n\r\n"); request[n] = 0) {
            got = recv(fd, request + n, sizeof request - 1 - n, 0);
            n += got > 0 ? (size_t)got : 0;
        }
        if (got > 0 && server.alive == 1)
            memcpy(server.request, request, sizeof request);
        on = got > 0 && answer(fd, request);
    }
    close(fd);
    atomic_fetch_sub(&server.alive, 1);
    return NULL;
}

static void *accept_all(void *ctx)
{
    int fd;
    (void)ctx;
    while ((fd = accept4(server.listener, NULL, NULL, SOCK_CLOEXEC)) >= 0) {
        pthread_t t;
        atomic_fetch_add(&server.connections, 1);
        atomic_fetch_add(&server.alive, 1);
        if (pthread_create(&t, NULL, serve, (void *)(intptr_t)fd) != 0)
            abort();
        pthread_detach(t);
    }
    return NULL;
}

static int listen_somewhere(int *port)
{
    struct sockaddr_in a = {.sin_family = AF_INET};
    socklen_t n = sizeof a;
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (bind(fd, (struct sockaddr *)&a, n) != 0 || listen(fd, 32) != 0 ||
        getsockname(fd, (struct sockaddr *)&a, &n) != 0)
        abort();
    *port = ntohs(a.sin_port);
    return fd;
}

static void hash_of(const void *p, size_t n, char out[SHA256_HEX_CAP])
{
    struct sha256 h;
    sha256_init(&h);
    sha256_add(&h, p, n);
    sha256_hex(&h, out);
}

static int set_up(void **state)
{
    (void)state;
    tmpdir_make();
    memset(&server, 0, sizeof server);
    for (int i = 0; i < BYTES; i++)
        content[i] = (uint8_t)((i * 2654435761u) >> 13);
    hash_of(content, BYTES, hash);
    server.listener = listen_somewhere(&server.port);
    if (pthread_create(&server.thread, NULL, accept_all, NULL) != 0)
        abort();
    snprintf(url, sizeof url, "http://127.0.0.1:%d/file", server.port);
    path = tmpdir_path("file");
    expect_ok(fetch_open(&fetcher));
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    fetch_close(fetcher);
    shutdown(server.listener, SHUT_RDWR);
    pthread_join(server.thread, NULL);
    close(server.listener);
    for (int i = 0; server.alive && i < 1000; i++)
        poll(NULL, 0, 10);
    tmpdir_remove();
    return 0;
}

/* ---- the client ---- */

static const struct fetch_config plain = {.parallel = 2, .stall_s = 1};

static err_t fetch_one(void)
{
    const struct fetch_item item = {url, path, BYTES, hash};
    return fetch_files(fetcher, &plain, &item, 1);
}

static long size_of_file(void)
{
    struct stat st;
    return stat(path, &st) == 0 ? (long)st.st_size : -1;
}

static void expect_file(const char *at, const void *bytes, size_t n)
{
    static char got[BYTES + 1];
    FILE *f = fopen(at, "rb");
    assert_non_null(f);
    assert_int_equal(fread(got, 1, sizeof got, f), n);
    assert_memory_equal(got, bytes, n);
    fclose(f);
}

static void expect_fetched(int requests, int ranges)
{
    server.requests = server.ranges = 0;
    expect_ok(fetch_one());
    expect_file(path, content, BYTES);
    assert_int_equal(server.requests, requests);
    assert_int_equal(server.ranges, ranges);
}

/* ---- tests ---- */

static void a_whole_file(void **state)
{
    (void)state;
    expect_fetched(1, 0);
    expect_fetched(0, 0); // is there
}

static void a_begun_file_is_continued(void **state)
{
    (void)state;
    static const size_t begun[] = {1, 63, 64, 4097, BYTES - 1};
    for (size_t i = 0; i < sizeof begun / sizeof begun[0]; i++) {
        tmpdir_write("file", content, begun[i]);
        expect_fetched(1, 1);
    }
    server.manner = WHOLE;
    tmpdir_write("file", content, 1000);
    expect_fetched(1, 0); // begun anew
}

static void a_broken_connection_is_continued(void **state)
{
    (void)state;
    static const size_t cuts[] = {0, 1, 5000, BYTES - 1};
    for (size_t i = 0; i < sizeof cuts / sizeof cuts[0]; i++) {
        unlink(path);
        server.manner = CUT;
        server.cut = cuts[i];
        expect_err(fetch_one(), ERR_LOST, url);
        assert_int_equal(size_of_file(), cuts[i]);
        expect_fetched(1, cuts[i] > 0);
    }
}

/* Whoever began it, and with what: in the end the file is right. */
static void wrong_beginnings(void **state)
{
    (void)state;
    static uint8_t other[BYTES + 10];
    memcpy(other, content, BYTES);
    other[7] ^= 1;
    tmpdir_write("file", other, BYTES + 10);
    expect_fetched(1, 0);
    tmpdir_write("file", other, BYTES);
    expect_fetched(1, 0);
    tmpdir_write("file", other, 100);
    expect_fetched(2, 1);
    tmpdir_write("file", content, 100);
    server.status = 416; // the file is shorter there
    expect_err(fetch_one(), ERR_IO, "416");
    assert_int_equal(size_of_file(), 0);
}

static void servers_that_lie(void **state)
{
    (void)state;
    static const struct {
        enum manner manner;
        err_t err;
        const char *words;
    } lies[] = {
        {LONGER, ERR_FORMAT, "has 300001 bytes"},  {ENDLESS, ERR_FORMAT, "more than"},
        {SHORTER, ERR_FORMAT, "has 299999 bytes"}, {OTHER_BYTES, ERR_FORMAT, "wrong SHA-256"},
        {HEADERS, ERR_FORMAT, "headers"},          {NOISE, ERR_FORMAT, "HTTP/0.9"},
    };
    for (size_t i = 0; i < sizeof lies / sizeof lies[0]; i++) {
        server.manner = lies[i].manner;
        unlink(path);
        expect_err(fetch_one(), lies[i].err, lies[i].words);
        assert_true(strstr(err_text(), url) && strstr(err_text(), path));
        assert_true(size_of_file() <= BYTES);
    }
    server.manner = OTHER_RANGE;
    tmpdir_write("file", content, 100);
    expect_err(fetch_one(), ERR_FORMAT, "another range");
    expect_file(path, content, 100);
    server.manner = OTHER_BYTES; // once more from the start, and no more
    server.requests = 0;
    expect_err(fetch_one(), ERR_FORMAT, "wrong SHA-256");
    assert_int_equal(server.requests, 2);
    assert_int_equal(size_of_file(), -1);
}

static void refusals(void **state)
{
    (void)state;
    static const struct {
        int status;
        err_t err;
        const char *words;
    } all[] = {
        {401, ERR_ARG, "token"}, {403, ERR_ARG, "token"}, {404, ERR_IO, "no such file"},
        {302, ERR_IO, "302"},    {503, ERR_BUSY, "503"},  {500, ERR_IO, "500"},
        {206, ERR_IO, "206"},    {204, ERR_IO, "204"},
    };
    for (size_t i = 0; i < sizeof all / sizeof all[0]; i++) {
        server.status = all[i].status;
        expect_err(fetch_one(), all[i].err, all[i].words);
        assert_true(size_of_file() <= 0);
    }
}

static void servers_that_stall(void **state)
{
    (void)state;
    server.manner = STALLED;
    expect_err(fetch_one(), ERR_TIMEOUT, "too slow");
    assert_int_equal(size_of_file(), BEGIN);
    server.manner = SILENT;
    expect_err(fetch_one(), ERR_TIMEOUT, "too slow");
    server.manner = HONEST;
    expect_fetched(1, 1);
    unlink(path);
    int port;
    close(listen_somewhere(&port)); // nobody listens there now
    snprintf(url, sizeof url, "http://127.0.0.1:%d/file", port);
    expect_err(fetch_one(), ERR_LOST, "connect");
}

static void *cancel_soon(void *ctx)
{
    poll(NULL, 0, 200);
    atomic_store((atomic_bool *)ctx, true);
    return NULL;
}

static void cancelled(void **state)
{
    (void)state;
    atomic_bool cancel = false;
    struct fetch_config c = {.parallel = 1, .cancel = &cancel};
    const struct fetch_item item = {url, path, BYTES, hash};
    pthread_t t;
    server.manner = STALLED;
    if (pthread_create(&t, NULL, cancel_soon, &cancel) != 0)
        abort();
    expect_err(fetch_files(fetcher, &c, &item, 1), ERR_CANCELLED, "cancelled");
    pthread_join(t, NULL);
    assert_int_equal(size_of_file(), BEGIN);
    server.requests = 0;
    expect_err(fetch_files(fetcher, &c, &item, 1), ERR_CANCELLED, "cancelled");
    assert_int_equal(server.requests, 0);
}

static uint64_t told_done, told_all;

static void progress(void *ctx, uint64_t done, uint64_t all)
{
    *(int *)ctx += 1;
    assert_true(done <= all);
    told_done = done;
    told_all = all;
}

static void many_files(void **state)
{
    (void)state;
    enum { N = 40 };
    static char paths[N][512];
    struct fetch_item items[N];
    char nothing[SHA256_HEX_CAP];
    int calls = 0;
    struct fetch_config c = {.token = "secret", .parallel = 4, .progress = progress, .ctx = &calls};
    hash_of("", 0, nothing);
    for (int i = 0; i < N; i++) {
        char name[16];
        snprintf(name, sizeof name, "%d", i);
        snprintf(paths[i], sizeof paths[i], "%s", tmpdir_path(name));
        items[i] = (struct fetch_item){url, paths[i], i % 4 ? BYTES : 0, i % 4 ? hash : nothing};
    }
    expect_ok(fetch_files(fetcher, &c, items, N));
    for (int i = 0; i < N; i++)
        expect_file(paths[i], content, i % 4 ? BYTES : 0);
    assert_int_equal(server.requests, 30); // none for an empty file
    assert_true(server.connections <= 4);
    assert_true(calls >= 1);
    assert_int_equal(told_done, 30 * BYTES);
    assert_int_equal(told_all, 30 * BYTES);

    c.parallel = 1;
    unlink(paths[1]);
    expect_ok(fetch_files(fetcher, &c, items, N));
    assert_int_equal(server.requests, 31);
    assert_true(server.connections <= 4); // kept
    server.manner = OTHER_BYTES;
    unlink(paths[1]);
    unlink(paths[2]);
    c.parallel = 4;
    expect_err(fetch_files(fetcher, &c, items, N), ERR_FORMAT, "wrong SHA-256");
    assert_null(strstr(err_text(), "secret"));
}

static void connections_are_kept(void **state)
{
    const struct fetch_config c = {.token = "secret", .parallel = 4};
    const struct fetch_item item = {url, path, BYTES, hash};
    (void)state;
    for (int i = 0; i < 3; i++) {
        server.request[0] = 0;
        expect_ok(fetch_files(fetcher, &c, &item, 1));
        assert_non_null(strstr(server.request, "\r\nAuthorization: Bearer secret\r\n"));
        unlink(path);
    }
    assert_int_equal(server.connections, 1);
    server.manner = BRIEF;
    for (int i = 0; i < 3; i++) {
        expect_ok(fetch_one());
        expect_file(path, content, BYTES);
        unlink(path);
    }
    assert_int_equal(server.connections, 3);
    assert_int_equal(server.requests, 6);
}

static void what_is_no_request(void **state)
{
    (void)state;
    struct fetch_config c = plain;
    struct fetch_item item = {url, path, BYTES, hash};
    expect_ok(fetch_files(fetcher, &c, NULL, 0));
    for (int k = 0; k < 18; k += 17) {
        c.parallel = k;
        expect_err(fetch_files(fetcher, &c, &item, 1), ERR_ARG, "1 to 16");
    }
    c.parallel = 1;
    c.token = "a\r\nX: b";
    expect_err(fetch_files(fetcher, &c, &item, 1), ERR_ARG, "token");
    c.token = NULL;
    static const char *const hashes[] = {"", "12", "x"};
    for (int i = 0; i < 3; i++) {
        item.sha256 = hashes[i];
        expect_err(fetch_files(fetcher, &c, &item, 1), ERR_ARG, "64 hexadecimal");
    }
    item.sha256 = hash;
    static const char *const urls[] = {"file:///etc/passwd", "ftp://127.0.0.1/", "", "127.0.0.1"};
    for (int i = 0; i < 4; i++) {
        item.url = urls[i];
        expect_err(fetch_files(fetcher, &c, &item, 1), ERR_ARG, "neither http");
    }
    item.url = "http://";
    expect_err(fetch_files(fetcher, &c, &item, 1), ERR_ARG, "http://");
    item.url = url;
    item.path = tmpdir_path("no/folder");
    expect_err(fetch_files(fetcher, &c, &item, 1), ERR_IO, "no/folder");
    item.path = tmpdir_root;
    expect_err(fetch_files(fetcher, &c, &item, 1), ERR_IO, tmpdir_root);
    assert_int_equal(symlink(path, tmpdir_path("link")), 0);
    item.path = tmpdir_path("link");
    expect_err(fetch_files(fetcher, &c, &item, 1), ERR_IO, "link");
    assert_int_equal(mkfifo(tmpdir_path("pipe"), 0600), 0);
    item.path = tmpdir_path("pipe");
    expect_err(fetch_files(fetcher, &c, &item, 1), ERR_ARG, "no regular file");
}

/* The environment of a service has no say in where files come from. */
static void no_proxy(void **state)
{
    (void)state;
    setenv("http_proxy", "http://127.0.0.1:1", 1);
    setenv("ALL_PROXY", "http://127.0.0.1:1", 1);
    err_t e = fetch_one();
    unsetenv("http_proxy");
    unsetenv("ALL_PROXY");
    expect_ok(e);
}

/* ---- the status page as the server ---- */

static struct http *page;
static atomic_bool page_ends;

static void *serve_page(void *ctx)
{
    (void)ctx;
    while (!page_ends) {
        int64_t deadline = INT64_MAX;
        struct pollfd p = http_poll(page, 0, &deadline);
        poll(&p, 1, 10);
        http_step(page);
    }
    return NULL;
}

static void parts_of_the_status_page(void **state)
{
    (void)state;
    struct http_config h = {.address = "127.0.0.1",
                            .token = "",
                            .captures = tmpdir_mkdir("captures"),
                            .results = tmpdir_path("results"),
                            .parts_token = "rig"};
    struct fetch_config c = {.token = "rig", .parallel = 3};
    struct fetch_item item = {url, path, BYTES, hash};
    pthread_t t;
    tmpdir_mkdir("captures/b-1");
    tmpdir_write("captures/b-1/frame", content, BYTES);
    expect_ok(http_open(&h, &page));
    page_ends = false;
    if (pthread_create(&t, NULL, serve_page, NULL) != 0)
        abort();
    snprintf(url, sizeof url, "http://127.0.0.1:%d/parts/b-1/frame", http_port(page));
    err_t whole = fetch_files(fetcher, &c, &item, 1);
    tmpdir_write("file", content, 1234);
    err_t rest = fetch_files(fetcher, &c, &item, 1);
    expect_file(path, content, BYTES);
    tmpdir_write("file", content, 10);
    c.token = "other";
    err_t refused = fetch_files(fetcher, &c, &item, 1);
    c.token = "rig";
    tmpdir_text("captures/b-1/frame", "short");
    err_t gone = fetch_files(fetcher, &c, &item, 1);
    page_ends = true;
    pthread_join(t, NULL);
    http_close(page);
    assert_int_equal(whole, OK);
    assert_int_equal(rest, OK);
    assert_int_equal(refused, ERR_ARG);
    expect_err(gone, ERR_FORMAT, "has 5 bytes");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_whole_file, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_begun_file_is_continued, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_broken_connection_is_continued, set_up, tear_down),
        cmocka_unit_test_setup_teardown(wrong_beginnings, set_up, tear_down),
        cmocka_unit_test_setup_teardown(servers_that_lie, set_up, tear_down),
        cmocka_unit_test_setup_teardown(refusals, set_up, tear_down),
        cmocka_unit_test_setup_teardown(servers_that_stall, set_up, tear_down),
        cmocka_unit_test_setup_teardown(cancelled, set_up, tear_down),
        cmocka_unit_test_setup_teardown(many_files, set_up, tear_down),
        cmocka_unit_test_setup_teardown(connections_are_kept, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_is_no_request, set_up, tear_down),
        cmocka_unit_test_setup_teardown(no_proxy, set_up, tear_down),
        cmocka_unit_test_setup_teardown(parts_of_the_status_page, set_up, tear_down),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests(tests, NULL, NULL);
}
