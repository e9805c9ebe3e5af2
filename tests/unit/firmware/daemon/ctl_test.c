/* The control socket from both ends, with clients that behave and clients that do not. */
#include "firmware/daemon/ctl.h"

#include "tests/unit/tmpdir.h"

#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cmocka.h>

static struct ctl *server;
static char path[256], last_line[CTL_LINE_MAX + 1];
static uint64_t last_id;
static int lines;

static void on_line(void *ctx, uint64_t id, const char *line)
{
    (void)ctx;
    lines++;
    last_id = id;
    strcpy(last_line, line);
    if (strcmp(line, "later") != 0)
        ctl_answer(server, id, "{\"ok\": true}");
}

static int set_up(void **state)
{
    (void)state;
    tmpdir_make();
    snprintf(path, sizeof path, "%s", tmpdir_path("control"));
    lines = 0;
    return ctl_open(path, on_line, NULL, &server);
}

static int tear_down(void **state)
{
    (void)state;
    ctl_close(server);
    tmpdir_remove();
    return 0;
}

static int client(void)
{
    struct sockaddr_un a = {.sun_family = AF_UNIX};
    strcpy(a.sun_path, path);
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0);
    assert_true(fd >= 0);
    assert_int_equal(connect(fd, (struct sockaddr *)&a, sizeof a), 0);
    return fd;
}

static void say(int fd, const char *text)
{
    assert_int_equal(send(fd, text, strlen(text), MSG_NOSIGNAL), strlen(text));
    ctl_step(server);
}

static const char *hear(int fd)
{
    static char text[512];
    ssize_t n = recv(fd, text, sizeof text - 1, 0);
    text[n > 0 ? n : 0] = 0;
    return n < 0 && errno == EAGAIN ? "nothing" : text;
}

static void lines_are_answered(void **state)
{
    (void)state;
    int a = client(), b = client();
    say(a, "sta");
    assert_int_equal(lines, 0);
    say(a, "tus\ncancel\n");
    assert_int_equal(lines, 2);
    assert_string_equal(last_line, "cancel");
    assert_string_equal(hear(a), "{\"ok\": true}\n{\"ok\": true}\n");
    assert_string_equal(hear(b), "nothing");
    say(b, "later\n");
    assert_string_equal(hear(b), "nothing");
    uint64_t id = last_id;
    ctl_answer(server, id, "{}");
    assert_string_equal(hear(b), "{}\n");
    close(b);
    ctl_step(server);
    ctl_answer(server, id, "{}"); // nobody there any more
    close(a);
}

static void bad_clients_are_dropped(void **state)
{
    (void)state;
    int fd = client();
    char text[2 * CTL_LINE_MAX + 1];
    memset(text, 'x', sizeof text - 1);
    text[sizeof text - 1] = 0;
    say(fd, text);
    assert_string_equal(hear(fd), "{\"ok\": false, \"error\": \"line too long\"}\n");
    assert_int_equal(lines, 0);
    close(fd);

    fd = client();
    assert_int_equal(send(fd, "a\0b\n", 4, 0), 4);
    ctl_step(server);
    assert_string_equal(hear(fd), "{\"ok\": false, \"error\": \"zero byte\"}\n");
    assert_string_equal(hear(fd), ""); // closed
    close(fd);

    fd = client(); // longest line that is allowed
    text[CTL_LINE_MAX] = '\n';
    text[CTL_LINE_MAX + 1] = 0;
    say(fd, text);
    assert_int_equal(lines, 1);
    assert_int_equal(strlen(last_line), CTL_LINE_MAX);
    close(fd);
}

static void a_client_that_does_not_read_is_dropped(void **state)
{
    (void)state;
    static char big[30000];
    memset(big, 'y', sizeof big - 1);
    int fd = client();
    say(fd, "later\n");
    for (int i = 0; i < 100; i++)
        ctl_answer(server, last_id, big);
    struct pollfd p[1 + CTL_CLIENTS_MAX];
    assert_int_equal(ctl_poll(server, p, 1 + CTL_CLIENTS_MAX), 1);
    close(fd);
}

static void the_ninth_client_is_told(void **state)
{
    (void)state;
    int fd[CTL_CLIENTS_MAX + 1];
    for (int i = 0; i <= CTL_CLIENTS_MAX; i++) {
        fd[i] = client();
        ctl_step(server);
    }
    assert_string_equal(hear(fd[CTL_CLIENTS_MAX]),
                        "{\"ok\": false, \"error\": \"too many clients\"}\n");
    close(fd[0]);
    ctl_step(server);
    fd[0] = client();
    say(fd[0], "x\n");
    assert_string_equal(hear(fd[0]), "{\"ok\": true}\n");
    for (int i = 0; i <= CTL_CLIENTS_MAX; i++)
        close(fd[i]);
}

static void one_daemon_per_socket(void **state)
{
    (void)state;
    struct ctl *other;
    struct stat st;
    assert_int_equal(ctl_open(path, on_line, NULL, &other), ERR_BUSY);
    assert_null(other);
    assert_int_equal(stat(path, &st), 0); // the first one's is still there
    assert_int_equal(st.st_mode & 0777, 0660);

    /* what a crash leaves */
    char stale[256];
    snprintf(stale, sizeof stale, "%s", tmpdir_path("stale"));
    struct sockaddr_un a = {.sun_family = AF_UNIX};
    strcpy(a.sun_path, stale);
    int fd = socket(AF_UNIX, SOCK_STREAM, 0);
    assert_int_equal(bind(fd, (struct sockaddr *)&a, sizeof a), 0);
    close(fd);
    assert_int_equal(ctl_open(stale, on_line, NULL, &other), OK);
    ctl_close(other);
    assert_int_equal(access(stale, F_OK), -1);

    /* a daemon whose queue is full is no crash: connecting to it says EAGAIN */
    int waiting[8], n = 0;
    snprintf(stale, sizeof stale, "%s", tmpdir_path("busy"));
    strcpy(a.sun_path, stale);
    fd = socket(AF_UNIX, SOCK_STREAM, 0);
    assert_int_equal(bind(fd, (struct sockaddr *)&a, sizeof a), 0);
    assert_int_equal(listen(fd, 0), 0);
    do
        waiting[n] = socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0);
    while (connect(waiting[n++], (struct sockaddr *)&a, sizeof a) == 0 && n < 8);
    assert_int_equal(errno, EAGAIN);
    assert_int_equal(ctl_open(stale, on_line, NULL, &other), ERR_BUSY);
    assert_int_equal(access(stale, F_OK), 0);
    while (n > 0)
        close(waiting[--n]);
    close(fd);

    tmpdir_text("file", "not ours");
    snprintf(stale, sizeof stale, "%s", tmpdir_path("file"));
    assert_int_equal(ctl_open(stale, on_line, NULL, &other), ERR_IO);
    assert_int_equal(access(stale, F_OK), 0);
    char text[300];
    memset(text, 'p', sizeof text - 1);
    text[sizeof text - 1] = 0;
    assert_int_equal(ctl_open(text, on_line, NULL, &other), ERR_ARG);
}

static void *serve_one_line(void *unused)
{
    (void)unused;
    while (!*last_line) { // who asks may have connected and written already, or not
        struct pollfd p[1 + CTL_CLIENTS_MAX];
        int n = ctl_poll(server, p, 1 + CTL_CLIENTS_MAX);
        if (poll(p, (nfds_t)n, 60000) <= 0)
            break;
        ctl_step(server);
    }
    return NULL;
}

static void asking(void **state)
{
    (void)state;
    static char out[CTL_ANSWER_MAX];
    pthread_t t;
    *last_line = 0;
    assert_int_equal(pthread_create(&t, NULL, serve_one_line, NULL), 0);
    assert_int_equal(ctl_ask(path, "status", 60, out), OK);
    assert_string_equal(out, "{\"ok\": true}");
    pthread_join(t, NULL);
    assert_string_equal(last_line, "status");
    assert_int_equal(ctl_ask(path, "status", 0.05, out), ERR_TIMEOUT); // nobody serves now
    assert_int_equal(ctl_ask(tmpdir_path("nobody"), "status", 1, out), ERR_LOST);
    assert_non_null(strstr(err_text(), "systemctl start hdrigd"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(lines_are_answered, set_up, tear_down),
        cmocka_unit_test_setup_teardown(bad_clients_are_dropped, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_client_that_does_not_read_is_dropped, set_up, tear_down),
        cmocka_unit_test_setup_teardown(the_ninth_client_is_told, set_up, tear_down),
        cmocka_unit_test_setup_teardown(one_daemon_per_socket, set_up, tear_down),
        cmocka_unit_test_setup_teardown(asking, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
