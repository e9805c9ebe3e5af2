/* A listening socket and a few clients, all non-blocking. Answers are small: bytes that the
 * socket's buffer does not take at once are kept and sent when it is writable. */
#include "firmware/daemon/ctl.h"

#include "drivers/device/clocks.h"

#include <errno.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

struct client {
    int fd; // -1: free
    uint64_t id;
    char in[CTL_LINE_MAX + 1];
    size_t n_in;
    char *out; // CTL_ANSWER_MAX + 1
    size_t n_out, sent;
    bool last; // close when all is sent
};

struct ctl {
    int fd;
    bool bound; // the file is ours
    char path[sizeof((struct sockaddr_un *)0)->sun_path];
    ctl_line_fn *fn;
    void *ctx;
    uint64_t next_id;
    struct client client[CTL_CLIENTS_MAX];
};

static err_t address_of(const char *path, struct sockaddr_un *a)
{
    *a = (struct sockaddr_un){.sun_family = AF_UNIX};
    if (strlen(path) >= sizeof a->sun_path)
        return err_fail(ERR_ARG, "control.socket: %.40s...: longer than %zu bytes", path,
                        sizeof a->sun_path - 1);
    strcpy(a->sun_path, path);
    return OK;
}

/* A socket that refuses connections was left by a crash. */
static err_t clear_stale(const struct sockaddr_un *a)
{
    struct stat st;
    if (lstat(a->sun_path, &st) != 0)
        return OK;
    if (!S_ISSOCK(st.st_mode))
        return err_fail(ERR_IO, "control.socket: %s already exists and is not a socket",
                        a->sun_path);
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (fd < 0)
        return err_fail(ERR_IO, "control.socket: %s", strerror(errno));
    int r = connect(fd, (const struct sockaddr *)a, sizeof *a), why = errno;
    close(fd);
    if (r == 0 || why == EAGAIN)
        return err_fail(ERR_BUSY, "control.socket: another hdrigd serves %s", a->sun_path);
    if (why != ECONNREFUSED)
        return err_fail(ERR_IO, "control.socket: %s: %s", a->sun_path, strerror(why));
    return unlink(a->sun_path) == 0 || errno == ENOENT
               ? OK
               : err_fail(ERR_IO, "control.socket: %s cannot be removed: %s", a->sun_path,
                          strerror(errno));
}

static err_t listen_at(struct ctl *c, const char *path)
{
    struct sockaddr_un a;
    err_t e = address_of(path, &a);
    if (!e)
        e = clear_stale(&a);
    if (e)
        return e;
    strcpy(c->path, path);
    c->fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (c->fd < 0)
        return err_fail(ERR_IO, "control.socket: %s", strerror(errno));
    mode_t mask = umask(0117); // owner and group
    c->bound = bind(c->fd, (struct sockaddr *)&a, sizeof a) == 0;
    int why = errno;
    umask(mask);
    if (!c->bound)
        return err_fail(ERR_IO, "control.socket: %s: %s", path, strerror(why));
    return listen(c->fd, CTL_CLIENTS_MAX) == 0
               ? OK
               : err_fail(ERR_IO, "control.socket: %s: %s", path, strerror(errno));
}

err_t ctl_open(const char *path, ctl_line_fn *fn, void *ctx, struct ctl **out)
{
    struct ctl *c = calloc(1, sizeof *c);
    *out = NULL;
    if (!c)
        return err_fail(ERR_NOMEM, "control.socket: no memory");
    c->fd = -1;
    c->fn = fn;
    c->ctx = ctx;
    for (int i = 0; i < CTL_CLIENTS_MAX; i++)
        c->client[i].fd = -1;
    err_t e = listen_at(c, path);
    for (int i = 0; !e && i < CTL_CLIENTS_MAX; i++)
        if (!(c->client[i].out = malloc(CTL_ANSWER_MAX + 1)))
            e = err_fail(ERR_NOMEM, "control.socket: no memory");
    if (e) {
        ctl_close(c);
        return e;
    }
    *out = c;
    return OK;
}

static void drop_client(struct client *k)
{
    if (k->fd >= 0)
        close(k->fd);
    k->fd = -1;
    k->n_in = k->n_out = k->sent = 0;
    k->last = false;
}

void ctl_close(struct ctl *c)
{
    if (!c)
        return;
    for (int i = 0; i < CTL_CLIENTS_MAX; i++) {
        drop_client(&c->client[i]);
        free(c->client[i].out);
    }
    if (c->fd >= 0)
        close(c->fd);
    if (c->bound)
        unlink(c->path);
    free(c);
}

int ctl_poll(const struct ctl *c, struct pollfd *fds, int cap)
{
    int n = 0;
    if (n < cap)
        fds[n++] = (struct pollfd){.fd = c->fd, .events = POLLIN};
    for (int i = 0; i < CTL_CLIENTS_MAX; i++) {
        const struct client *k = &c->client[i];
        if (k->fd < 0 || n == cap)
            continue;
        short out = k->sent < k->n_out ? POLLOUT : 0;
        fds[n++] = (struct pollfd){.fd = k->fd, .events = (short)(k->last ? out : out | POLLIN)};
    }
    return n;
}

static void flush_client(struct client *k)
{
    while (k->sent < k->n_out) {
        ssize_t n = send(k->fd, k->out + k->sent, k->n_out - k->sent, MSG_NOSIGNAL);
        if (n < 0 && errno == EINTR)
            continue;
        if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK))
            return;
        if (n <= 0) {
            drop_client(k);
            return;
        }
        k->sent += (size_t)n;
    }
    k->sent = k->n_out = 0;
    if (k->last)
        drop_client(k);
}

static void put_line(struct client *k, const char *json)
{
    size_t n = strlen(json);
    if (n + 1 > CTL_ANSWER_MAX - k->n_out) { // does not read its answers
        drop_client(k);
        return;
    }
    memcpy(k->out + k->n_out, json, n);
    k->out[k->n_out + n] = '\n';
    k->n_out += n + 1;
    flush_client(k);
}

void ctl_answer(struct ctl *c, uint64_t id, const char *json)
{
    for (int i = 0; i < CTL_CLIENTS_MAX; i++)
        if (c->client[i].fd >= 0 && c->client[i].id == id)
            put_line(&c->client[i], json);
}

static void refuse_client(struct client *k, const char *why)
{
    char text[128];
    snprintf(text, sizeof text, "{\"ok\": false, \"error\": \"%s\"}", why);
    k->last = true;
    put_line(k, text);
}

static void accept_clients(struct ctl *c)
{
    for (;;) {
        int fd = accept4(c->fd, NULL, NULL, SOCK_CLOEXEC | SOCK_NONBLOCK);
        if (fd < 0)
            return;
        struct client *k = NULL;
        for (int i = 0; i < CTL_CLIENTS_MAX && !k; i++)
            if (c->client[i].fd < 0)
                k = &c->client[i];
        if (!k) {
            static const char full[] = "{\"ok\": false, \"error\": \"too many clients\"}\n";
            ssize_t n = send(fd, full, sizeof full - 1, MSG_NOSIGNAL);
            (void)n; // it is closed in any case
            close(fd);
            continue;
        }
        k->fd = fd;
        k->id = ++c->next_id;
    }
}

/* Hand over each line of the buffer; the handler may answer and so drop the client. */
static void take_lines(struct ctl *c, struct client *k)
{
    char *end;
    while (k->fd >= 0 && !k->last && (end = memchr(k->in, '\n', k->n_in))) {
        char line[CTL_LINE_MAX + 1];
        size_t n = (size_t)(end - k->in);
        bool zero = memchr(k->in, 0, n) != NULL;
        memcpy(line, k->in, n);
        line[n] = 0;
        k->n_in -= n + 1;
        memmove(k->in, end + 1, k->n_in);
        if (zero)
            refuse_client(k, "zero byte");
        else
            c->fn(c->ctx, k->id, line);
    }
    if (k->fd >= 0 && k->n_in == sizeof k->in)
        refuse_client(k, "line too long");
}

static void serve_client(struct ctl *c, struct client *k)
{
    flush_client(k);
    while (k->fd >= 0 && !k->last) {
        ssize_t n = recv(k->fd, k->in + k->n_in, sizeof k->in - k->n_in, 0);
        if (n < 0 && errno == EINTR)
            continue;
        if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK))
            return;
        if (n <= 0) {
            drop_client(k);
            return;
        }
        k->n_in += (size_t)n;
        take_lines(c, k);
    }
}

void ctl_step(struct ctl *c)
{
    accept_clients(c);
    for (int i = 0; i < CTL_CLIENTS_MAX; i++)
        if (c->client[i].fd >= 0)
            serve_client(c, &c->client[i]);
}

static err_t connect_to(const char *path, int *fd)
{
    struct sockaddr_un a;
    err_t e = address_of(path, &a);
    if (e)
        return e;
    *fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (*fd < 0)
        return err_fail(ERR_IO, "control.socket: %s", strerror(errno));
    if (connect(*fd, (struct sockaddr *)&a, sizeof a) == 0)
        return OK;
    int why = errno;
    close(*fd);
    if (why == EACCES)
        return err_fail(ERR_IO, "%s: no permission: users of the rig are in group hdrig", path);
    return err_fail(ERR_LOST,
                    "%s: no daemon answers (%s); start it: systemctl start hdrigd, or give the "
                    "--config FILE that yours was started with",
                    path, strerror(why));
}

/* more: NULL, or a function that returns true for lines before the answer. */
struct listener {
    int fd;
    const char *path;
    int64_t end_ns; // INT64_MAX: none
    ctl_more_fn *more;
    void *ctx;
};

/* Whether the answer is at the start of out; lines before it are passed to more() and removed. */
static bool take_answer(const struct listener *l, char *out, size_t *n)
{
    for (char *end; (end = memchr(out, '\n', *n));) {
        *end = 0;
        if (!l->more || !l->more(l->ctx, out))
            return true;
        *n -= (size_t)(end + 1 - out);
        memmove(out, end + 1, *n);
    }
    return false;
}

static err_t receive_answer(const struct listener *l, char *out)
{
    for (size_t n = 0; n < CTL_ANSWER_MAX;) {
        struct pollfd p = {.fd = l->fd, .events = POLLIN};
        int64_t left = (l->end_ns - clocks_now()) / 1000000;
        int ready = poll(&p, 1, l->end_ns == INT64_MAX ? -1 : left > 0 ? (int)left : 0);
        if (ready < 0 && errno == EINTR)
            return err_fail(ERR_CANCELLED, "interrupted");
        if (ready == 0)
            return err_fail(ERR_TIMEOUT, "%s: the daemon does not answer", l->path);
        ssize_t got = recv(l->fd, out + n, CTL_ANSWER_MAX - n, 0);
        if (got <= 0)
            return err_fail(ERR_IO, "%s: the daemon closed the connection", l->path);
        n += (size_t)got;
        if (take_answer(l, out, &n))
            return OK;
    }
    return err_fail(ERR_IO, "%s: answer longer than %d bytes", l->path, CTL_ANSWER_MAX);
}

static err_t send_and_receive(struct listener *l, const char *line, char *out)
{
    char text[CTL_LINE_MAX + 2];
    err_t e = connect_to(l->path, &l->fd);
    if (e)
        return e;
    int n = snprintf(text, sizeof text, "%.*s\n", CTL_LINE_MAX, line);
    if (send(l->fd, text, (size_t)n, MSG_NOSIGNAL) != n)
        e = err_fail(ERR_IO, "%s: %s", l->path, strerror(errno));
    else
        e = receive_answer(l, out);
    close(l->fd);
    return e;
}

err_t ctl_ask(const char *path, const char *line, double timeout_s, char *out)
{
    struct listener l = {.path = path, .end_ns = INT64_MAX};
    if (timeout_s > 0)
        l.end_ns = clocks_now() + (int64_t)(timeout_s * 1e9);
    return send_and_receive(&l, line, out);
}

err_t ctl_follow(const char *path, const char *line, ctl_more_fn *more, void *ctx, char *out)
{
    struct listener l = {.path = path, .end_ns = INT64_MAX, .more = more, .ctx = ctx};
    return send_and_receive(&l, line, out);
}
