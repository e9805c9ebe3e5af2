/* Any bytes of a client at the control socket, cut into pieces as their first byte says: every line
 * handed over is text below the bound, each gets one answer, and another client is served after
 * it. */
#include "firmware/daemon/ctl.h"

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static struct ctl *server;
static char path[64];
static int lines;

static void must(bool truth)
{
    if (!truth)
        abort();
}

static void on_line(void *ctx, uint64_t id, const char *line)
{
    (void)ctx;
    must(strlen(line) <= CTL_LINE_MAX && !strchr(line, '\n'));
    lines++;
    ctl_answer(server, id, "{\"ok\": true}");
}

static void clean_up(void)
{
    ctl_close(server);
}

static int join(void)
{
    struct sockaddr_un a = {.sun_family = AF_UNIX};
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0);
    strcpy(a.sun_path, path);
    must(fd >= 0 && connect(fd, (struct sockaddr *)&a, sizeof a) == 0);
    return fd;
}

static int answers(int fd)
{
    char text[4096];
    int n = 0;
    for (ssize_t got; (got = recv(fd, text, sizeof text, 0)) > 0;)
        for (ssize_t i = 0; i < got; i++)
            n += text[i] == '\n';
    return n;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (!server) {
        snprintf(path, sizeof path, "/tmp/fuzz_ctl.%ld", (long)getpid());
        must(ctl_open(path, on_line, NULL, &server) == OK);
        atexit(clean_up);
    }
    if (size < 1)
        return 0;
    size_t piece = 1 + data[0], at = 1;
    int fd = join(), got = 0;
    lines = 0;
    while (at < size) {
        size_t n = size - at < piece ? size - at : piece;
        ssize_t sent = send(fd, data + at, n, MSG_NOSIGNAL);
        ctl_step(server);
        got += answers(fd);
        if (sent < 0)
            break; // it was dropped
        at += (size_t)sent;
    }
    must(got == lines || got == lines + 1); // one is the reason to drop it
    int other = join();
    must(send(other, "status\n", 7, MSG_NOSIGNAL) == 7);
    ctl_step(server);
    must(answers(other) == 1);
    close(other);
    close(fd);
    ctl_step(server);
    return 0;
}
