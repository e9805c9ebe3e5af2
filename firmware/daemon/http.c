/* Requests are small and answered at once; files are sent by the library. */
#include "firmware/daemon/http.h"

#include "drivers/device/clocks.h"
#include "firmware/daemon/connections.h"
#include "firmware/result/embed.h"

#include "drivers/format/json.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <limits.h>
#include <microhttpd.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { TIMEOUT_S = 15, BODY_MAX = 512, NAME_MAX_BYTES = 128, DEPTH = 4 };
#define TURN_NS INT64_C(10000000) // of each turn of the loop, at most

/* The files of the page, in the binary, each with its size. */
EMBED_FILE(http_page_html, "firmware/web/page.html");
EMBED_FILE(http_page_css, "firmware/web/page.css");
EMBED_FILE(http_page_js, "firmware/web/page.js");
EMBED_FILE(http_rig_js, "firmware/web/rig.js");

struct http {
    struct http_config cfg;
    struct MHD_Daemon *mhd;
    int fd; // epoll
    char host[256];
    struct connections connections;
    int64_t expire_ns; // at them
};

struct request { // a request that has a body
    char body[BODY_MAX];
    size_t n;
};

/* Policies of the status page, and of pages of results, which are self-contained. */
static const char page_policy[] =
    "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'";
static const char result_policy[] =
    "default-src 'none'; script-src 'unsafe-inline' blob:; worker-src blob:; "
    "style-src 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'; "
    "form-action 'none'";

static const char *type_of(const char *name)
{
    static const char *const types[][2] = {
        {".json", "application/json"}, {".png", "image/png"},   {".jpg", "image/jpeg"},
        {".html", "text/html"},        {".exr", "image/x-exr"},
    };
    const char *dot = strrchr(name, '.');
    for (size_t i = 0; dot && i < sizeof types / sizeof types[0]; i++)
        if (strcmp(dot, types[i][0]) == 0)
            return types[i][1];
    return "application/octet-stream";
}

static enum MHD_Result send_response(struct MHD_Connection *c, unsigned status, const char *type,
                                     const char *policy, struct MHD_Response *r)
{
    if (!r)
        return MHD_NO;
    MHD_add_response_header(r, "Content-Type", type);
    MHD_add_response_header(r, "Content-Security-Policy", policy);
    MHD_add_response_header(r, "X-Content-Type-Options", "nosniff");
    MHD_add_response_header(r, "Referrer-Policy", "no-referrer");
    MHD_add_response_header(r, "Cache-Control", "no-store");
    enum MHD_Result ok = MHD_queue_response(c, status, r);
    MHD_destroy_response(r);
    return ok;
}

static enum MHD_Result send_text(struct MHD_Connection *c, unsigned status, const char *type,
                                 const char *text, size_t n)
{
    struct MHD_Response *r =
        MHD_create_response_from_buffer(n, (void *)(uintptr_t)text, MHD_RESPMEM_MUST_COPY);
    return send_response(c, status, type, page_policy, r);
}

static enum MHD_Result send_error(struct MHD_Connection *c, unsigned status, const char *sentence)
{
    char *text = NULL;
    size_t n = 0;
    enum MHD_Result r = MHD_NO;
    FILE *f = open_memstream(&text, &n);
    if (!f)
        return MHD_NO;
    fputs("{\"ok\": false, \"error\": ", f);
    json_put_string(f, sentence);
    fputs("}\n", f);
    if (fclose(f) == 0)
        r = send_text(c, status, "application/json", text, n);
    free(text);
    return r;
}

/* ---- access ---- */

static bool same_secret(const char *a, const char *b)
{
    size_t n = strlen(a), m = strlen(b);
    unsigned char differ = n != m;
    for (size_t i = 0; i < n && m > 0; i++)
        differ |= (unsigned char)(a[i] ^ b[i % m]);
    return !differ;
}

static bool bears(struct MHD_Connection *c, const char *token)
{
    const char *auth = MHD_lookup_connection_value(c, MHD_HEADER_KIND, "Authorization");
    return auth && strncmp(auth, "Bearer ", 7) == 0 && same_secret(auth + 7, token);
}

static bool has_token(const struct http *h, struct MHD_Connection *c)
{
    const char *cookie = MHD_lookup_connection_value(c, MHD_COOKIE_KIND, "hdrig");
    return bears(c, h->cfg.token) || (cookie && same_secret(cookie, h->cfg.token));
}

/* Name of a Host header without its port. */
static bool is_own_name(const struct http *h, const char *host)
{
    char name[256];
    struct in6_addr a;
    const char *bracket = host[0] == '[' ? strchr(host, ']') : NULL;
    size_t n = bracket ? (size_t)(bracket - host) - 1 : strcspn(host, ":");
    if (n >= sizeof name)
        return false;
    memcpy(name, host + (bracket != NULL), n);
    name[n] = 0;
    if (inet_pton(bracket ? AF_INET6 : AF_INET, name, &a) == 1)
        return true;
    size_t own = strlen(h->host);
    return strcasecmp(name, "localhost") == 0 || strcasecmp(name, h->host) == 0 ||
           (own && strncasecmp(name, h->host, own) == 0 && strcasecmp(name + own, ".local") == 0);
}

/* ---- files ---- */

static bool plain_name(const char *p, size_t n)
{
    static const char allowed[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"
                                  "_-.";
    return n > 0 && n < NAME_MAX_BYTES && p[0] != '.' && strspn(p, allowed) >= n;
}

/* A regular file below `dir`: plain names only, no links. -1 if there is none. */
static int open_below(const char *dir, const char *path)
{
    int fd = open(dir, O_PATH | O_DIRECTORY | O_CLOEXEC);
    for (int depth = 0; fd >= 0 && depth < DEPTH; depth++) {
        char name[NAME_MAX_BYTES];
        size_t n = strcspn(path, "/");
        bool last = !path[n];
        int next = -1;
        if (plain_name(path, n)) {
            memcpy(name, path, n);
            name[n] = 0;
            next =
                openat(fd, name, O_NOFOLLOW | O_CLOEXEC | (last ? O_RDONLY | O_NONBLOCK : O_PATH));
        }
        close(fd);
        if (last || next < 0)
            return next;
        fd = next;
        path += n + 1;
    }
    if (fd >= 0)
        close(fd);
    return -1;
}

/* A number of HTTP: digits alone, in which more than 18 are no size of a file. */
static bool number_of(const char **p, uint64_t *v)
{
    size_t n = strspn(*p, "0123456789");
    *v = 0;
    for (size_t i = 0; i < n && n <= 18; i++)
        *v = *v * 10 + (uint64_t)((*p)[i] - '0');
    *p += n;
    return n > 0 && n <= 18;
}

/* Whether one range, "bytes=N-" or "bytes=N-M", is asked of a file of `size` bytes: its first byte,
 * and its end. Any other, and one under a condition, asks for the whole file. */
static bool asks_range(struct MHD_Connection *c, uint64_t size, uint64_t *from, uint64_t *end)
{
    const char *p = MHD_lookup_connection_value(c, MHD_HEADER_KIND, "Range");
    uint64_t first, last = UINT64_MAX;
    *from = 0;
    *end = size;
    if (!p || strncmp(p, "bytes=", 6) != 0 ||
        MHD_lookup_connection_value(c, MHD_HEADER_KIND, "If-Range"))
        return false;
    p += 6;
    if (!number_of(&p, &first) || *p++ != '-')
        return false;
    if (*p && (!number_of(&p, &last) || *p || last < first))
        return false;
    *from = first;
    *end = last < size ? last + 1 : size;
    return true;
}

static enum MHD_Result refuse_range(struct MHD_Connection *c, uint64_t size)
{
    char range[64];
    struct MHD_Response *r =
        MHD_create_response_from_buffer(0, (void *)(uintptr_t) "", MHD_RESPMEM_PERSISTENT);
    if (!r)
        return MHD_NO;
    snprintf(range, sizeof range, "bytes */%" PRIu64, size);
    MHD_add_response_header(r, "Content-Range", range);
    return send_response(c, MHD_HTTP_RANGE_NOT_SATISFIABLE, "text/plain", result_policy, r);
}

static enum MHD_Result send_file(struct MHD_Connection *c, const char *dir, const char *path)
{
    struct stat st;
    int fd = open_below(dir, path);
    if (fd < 0 || fstat(fd, &st) != 0 || !S_ISREG(st.st_mode)) {
        if (fd >= 0)
            close(fd);
        return send_error(c, MHD_HTTP_NOT_FOUND, "no such file");
    }
    uint64_t size = (uint64_t)st.st_size, from, end;
    bool part = asks_range(c, size, &from, &end);
    if (part && from >= size) {
        close(fd);
        return refuse_range(c, size);
    }
    struct MHD_Response *r = MHD_create_response_from_fd_at_offset64(end - from, fd, from);
    if (!r) {
        close(fd);
        return MHD_NO;
    }
    char range[96];
    snprintf(range, sizeof range, "bytes %" PRIu64 "-%" PRIu64 "/%" PRIu64, from, end - 1, size);
    MHD_add_response_header(r, "Accept-Ranges", "bytes");
    if (part)
        MHD_add_response_header(r, "Content-Range", range);
    return send_response(c, part ? MHD_HTTP_PARTIAL_CONTENT : MHD_HTTP_OK, type_of(path),
                         result_policy, r);
}

/* ---- requests ---- */

static enum MHD_Result send_status(const struct http *h, struct MHD_Connection *c)
{
    char *text = NULL;
    size_t n = 0;
    FILE *f = open_memstream(&text, &n);
    if (!f)
        return MHD_NO;
    h->cfg.status(h->cfg.ctx, f);
    if (fclose(f) != 0) {
        free(text);
        return MHD_NO;
    }
    enum MHD_Result r = send_text(c, MHD_HTTP_OK, "application/json", text, n);
    free(text);
    return r;
}

static enum MHD_Result send_live(const struct http *h, struct MHD_Connection *c, const char *name)
{
    char *end;
    void *jpeg;
    size_t n;
    const long camera = strtol(name, &end, 10);
    if (*name < '0' || *name > '9' || camera > INT_MAX || strcmp(end, ".jpg") != 0)
        return send_error(c, MHD_HTTP_NOT_FOUND, "no such page");
    if (h->cfg.live(h->cfg.ctx, (int)camera, &jpeg, &n) != OK)
        return send_error(c, MHD_HTTP_NOT_FOUND, err_text());
    enum MHD_Result r = send_text(c, MHD_HTTP_OK, "image/jpeg", jpeg, n);
    free(jpeg);
    return r;
}

static enum MHD_Result get(const struct http *h, struct MHD_Connection *c, const char *url)
{
    if (strncmp(url, "/results/", 9) == 0)
        return send_file(c, h->cfg.results, url + 9);
    if (!h->cfg.status)
        return send_error(c, MHD_HTTP_NOT_FOUND, "only files below /results");
    if (strcmp(url, "/") == 0)
        return send_text(c, MHD_HTTP_OK, "text/html; charset=utf-8", http_page_html,
                         http_page_html_size);
    if (strcmp(url, "/page.css") == 0)
        return send_text(c, MHD_HTTP_OK, "text/css", http_page_css, http_page_css_size);
    if (strcmp(url, "/page.js") == 0)
        return send_text(c, MHD_HTTP_OK, "text/javascript", http_page_js, http_page_js_size);
    if (strcmp(url, "/rig.js") == 0)
        return send_text(c, MHD_HTTP_OK, "text/javascript", http_rig_js, http_rig_js_size);
    if (strcmp(url, "/status.json") == 0)
        return send_status(h, c);
    if (strncmp(url, "/live/", 6) == 0)
        return send_live(h, c, url + 6);
    if (strncmp(url, "/captures/", 10) == 0)
        return send_file(c, h->cfg.captures, url + 10);
    return send_error(c, MHD_HTTP_NOT_FOUND, "no such page");
}

/* The line of ctl.h for a URL; NULL: it is no command. */
static const char *command_of(const char *url)
{
    static const char *const commands[][2] = {{"/capture", "capture"},
                                              {"/cancel", "cancel"},
                                              {"/session/end", "session end"},
                                              {"/session/scene", "session scene"}};
    for (size_t i = 0; i < sizeof commands / sizeof commands[0]; i++)
        if (strcmp(url, commands[i][0]) == 0)
            return commands[i][1];
    return NULL;
}

static enum MHD_Result command(const struct http *h, struct MHD_Connection *c, const char *line)
{
    static const char ok[] = "{\"ok\": true}\n";
    const char *own = MHD_lookup_connection_value(c, MHD_HEADER_KIND, "X-Hdrig");
    if (!own || strcmp(own, "1") != 0)
        return send_error(c, MHD_HTTP_FORBIDDEN, "header X-Hdrig: 1 is missing");
    if (h->cfg.command(h->cfg.ctx, line) != OK)
        return send_error(c, MHD_HTTP_CONFLICT, err_text());
    return send_text(c, MHD_HTTP_OK, "application/json", ok, sizeof ok - 1);
}

/* The form of the page sends token=..., which has no characters that need coding. */
static enum MHD_Result login(const struct http *h, struct MHD_Connection *c,
                             const struct request *q)
{
    char cookie[400];
    if (strncmp(q->body, "token=", 6) != 0 || !same_secret(q->body + 6, h->cfg.token))
        return send_error(c, MHD_HTTP_UNAUTHORIZED, "wrong token");
    struct MHD_Response *r =
        MHD_create_response_from_buffer(0, (void *)(uintptr_t) "", MHD_RESPMEM_PERSISTENT);
    if (!r)
        return MHD_NO;
    snprintf(cookie, sizeof cookie, "hdrig=%s; HttpOnly; SameSite=Strict; Path=/", h->cfg.token);
    MHD_add_response_header(r, "Set-Cookie", cookie);
    MHD_add_response_header(r, "Location", "/");
    return send_response(c, MHD_HTTP_SEE_OTHER, "text/plain", page_policy, r);
}

static enum MHD_Result ask_token(struct MHD_Connection *c, const char *method, const char *url)
{
    static const char form[] =
        "<!doctype html><meta name=viewport content=\"width=device-width\"><title>hdrig</title>"
        "<form method=post action=/login><label>token <input name=token type=password autofocus>"
        "</label> <button>open</button></form>";
    if (strcmp(method, "GET") == 0 && strcmp(url, "/") == 0)
        return send_text(c, MHD_HTTP_UNAUTHORIZED, "text/html; charset=utf-8", form,
                         sizeof form - 1);
    return send_error(c, MHD_HTTP_UNAUTHORIZED, "a token is needed");
}

/* The conductor asks, by whatever name it knows this board. */
static enum MHD_Result part(const struct http *h, struct MHD_Connection *c, const char *method,
                            const char *path)
{
    if (!bears(c, h->cfg.parts_token))
        return send_error(c, MHD_HTTP_UNAUTHORIZED, "the token of the rig is needed");
    if (strcmp(method, "GET") != 0 && strcmp(method, "HEAD") != 0)
        return send_error(c, MHD_HTTP_METHOD_NOT_ALLOWED, "only GET");
    return send_file(c, h->cfg.captures, path);
}

static enum MHD_Result answer(const struct http *h, struct MHD_Connection *c, const char *method,
                              const char *url, const struct request *q)
{
    const char *host = MHD_lookup_connection_value(c, MHD_HEADER_KIND, "Host");
    bool post = strcmp(method, "POST") == 0;
    if (h->cfg.parts_token && strncmp(url, "/parts/", 7) == 0)
        return part(h, c, method, url + 7);
    if (!h->cfg.token[0] && (!host || !is_own_name(h, host)))
        return send_error(c, MHD_HTTP_FORBIDDEN, "the Host header is not a name of this machine");
    if (h->cfg.token[0] && post && strcmp(url, "/login") == 0)
        return login(h, c, q);
    if (h->cfg.token[0] && !has_token(h, c))
        return ask_token(c, method, url);
    if (post && h->cfg.command && command_of(url))
        return command(h, c, command_of(url));
    if (strcmp(method, "GET") == 0 || strcmp(method, "HEAD") == 0)
        return get(h, c, url);
    return send_error(c, MHD_HTTP_METHOD_NOT_ALLOWED, "only GET, and POST of a command");
}

static struct connection *connection_of(struct MHD_Connection *c)
{
    return MHD_get_connection_info(c, MHD_CONNECTION_INFO_SOCKET_CONTEXT)->socket_context;
}

static void on_connection(void *ctx, struct MHD_Connection *c, void **socket,
                          enum MHD_ConnectionNotificationCode code)
{
    struct http *h = ctx;
    if (code == MHD_CONNECTION_NOTIFY_CLOSED) {
        connections_remove(*socket);
        return;
    }
    const struct sockaddr *from =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_CLIENT_ADDRESS)->client_addr;
    int fd = MHD_get_connection_info(c, MHD_CONNECTION_INFO_CONNECTION_FD)->connect_fd;
    *socket = connections_add(&h->connections, fd, from, clocks_now());
}

/* Called when the header is complete, for each piece of the body, and at its end. */
static enum MHD_Result on_request(void *ctx, struct MHD_Connection *c, const char *url,
                                  const char *method, const char *version, const char *body,
                                  size_t *n, void **state)
{
    struct request *q = *state;
    (void)version;
    if (!q) {
        q = *state = calloc(1, sizeof *q);
        return q ? MHD_YES : MHD_NO;
    }
    if (*n) {
        if (*n >= sizeof q->body - q->n)
            return MHD_NO; // no request is so long: close
        memcpy(q->body + q->n, body, *n);
        q->n += *n;
        *n = 0;
        return MHD_YES;
    }
    connections_begin(connection_of(c));
    return answer(ctx, c, method, url, q);
}

static void on_end(void *ctx, struct MHD_Connection *c, void **state,
                   enum MHD_RequestTerminationCode code)
{
    (void)ctx;
    (void)code;
    connections_end(connection_of(c), clocks_now());
    free(*state);
    *state = NULL;
}

/* ---- life ---- */

union address {
    struct sockaddr any;
    struct sockaddr_in v4;
    struct sockaddr_in6 v6;
};

static err_t parse_address(const struct http_config *cfg, union address *a)
{
    memset(a, 0, sizeof *a);
    if (inet_pton(AF_INET, cfg->address, &a->v4.sin_addr) == 1) {
        a->v4.sin_family = AF_INET;
        a->v4.sin_port = htons((uint16_t)cfg->port);
        return OK;
    }
    if (inet_pton(AF_INET6, cfg->address, &a->v6.sin6_addr) == 1) {
        a->v6.sin6_family = AF_INET6;
        a->v6.sin6_port = htons((uint16_t)cfg->port);
        return OK;
    }
    return err_fail(ERR_ARG, "http.address: \"%s\" is not an IPv4 or IPv6 address", cfg->address);
}

static err_t check_token(const char *what, const char *token)
{
    return plain_name(token, strlen(token)) || !*token
               ? OK
               : err_fail(ERR_ARG,
                          "%s: letters, digits, - _ and . only, not . first, fewer than %d", what,
                          NAME_MAX_BYTES);
}

// Not left to the library: its version 1 says nothing of why it could not listen.
static err_t listen_at(const struct http_config *cfg, const union address *a, int *fd)
{
    bool v6 = a->any.sa_family == AF_INET6;
    int on = 1;
    *fd = socket(a->any.sa_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (*fd >= 0 && setsockopt(*fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) == 0 &&
        (!v6 || setsockopt(*fd, IPPROTO_IPV6, IPV6_V6ONLY, &on, sizeof on) == 0) &&
        bind(*fd, &a->any, v6 ? sizeof a->v6 : sizeof a->v4) == 0 && listen(*fd, SOMAXCONN) == 0)
        return OK;
    int why = errno;
    if (*fd >= 0)
        close(*fd);
    return err_fail(why == EADDRINUSE ? ERR_BUSY : ERR_IO, "status page: %s port %d: %s",
                    cfg->address, cfg->port, strerror(why));
}

err_t http_open(const struct http_config *cfg, struct http **out)
{
    union address a;
    *out = NULL;
    err_t e = parse_address(cfg, &a);
    if (!e)
        e = check_token("http.token", cfg->token);
    if (!e && cfg->parts_token)
        e = check_token("token of the rig", cfg->parts_token);
    if (e)
        return e;
    int fd;
    e = listen_at(cfg, &a, &fd);
    if (e)
        return e;
    struct http *h = calloc(1, sizeof *h);
    if (!h) {
        close(fd);
        return err_fail(ERR_NOMEM, "status page: no memory");
    }
    h->cfg = *cfg;
    if (!cfg->captures || (cfg->parts_token && !*cfg->parts_token))
        h->cfg.parts_token = NULL;
    connections_init(&h->connections);
    if (gethostname(h->host, sizeof h->host - 1) != 0)
        h->host[0] = 0;
    unsigned flags = MHD_USE_EPOLL | (a.any.sa_family == AF_INET6 ? MHD_USE_IPv6 : 0);
    h->mhd = MHD_start_daemon(flags, 0, NULL, NULL, on_request, h, MHD_OPTION_LISTEN_SOCKET, fd,
                              MHD_OPTION_CONNECTION_LIMIT, (unsigned)CONNECTIONS_MAX,
                              MHD_OPTION_NOTIFY_CONNECTION, on_connection, h,
                              MHD_OPTION_CONNECTION_TIMEOUT, (unsigned)TIMEOUT_S,
                              MHD_OPTION_NOTIFY_COMPLETED, on_end, NULL, MHD_OPTION_END);
    if (!h->mhd) { // the socket is the library's
        free(h);
        return err_fail(ERR_IO, "status page: %s port %d cannot be served", cfg->address,
                        cfg->port);
    }
    h->fd = MHD_get_daemon_info(h->mhd, MHD_DAEMON_INFO_EPOLL_FD)->epoll_fd;
    *out = h;
    return OK;
}

void http_close(struct http *h)
{
    if (!h)
        return;
    MHD_stop_daemon(h->mhd);
    free(h);
}

int http_port(const struct http *h)
{
    return MHD_get_daemon_info(h->mhd, MHD_DAEMON_INFO_BIND_PORT)->port;
}

struct pollfd http_poll(const struct http *h, int64_t now, int64_t *deadline_ns)
{
    MHD_UNSIGNED_LONG_LONG ms;
    if (MHD_get_timeout(h->mhd, &ms) == MHD_YES && now + (int64_t)ms * 1000000 < *deadline_ns)
        *deadline_ns = now + (int64_t)ms * 1000000;
    if (h->expire_ns < *deadline_ns)
        *deadline_ns = h->expire_ns;
    return (struct pollfd){.fd = h->fd, .events = POLLIN};
}

/* Whether the library has work that need not wait for anybody. */
static bool is_ready(const struct http *h)
{
    MHD_UNSIGNED_LONG_LONG ms;
    struct pollfd p = {.fd = h->fd, .events = POLLIN};
    return (MHD_get_timeout(h->mhd, &ms) == MHD_YES && ms == 0) || poll(&p, 1, 0) > 0;
}

/* The library moves each connection by one step at a time, and cameras may need a whole turn of the
 * loop for each. */
void http_step(struct http *h)
{
    const int64_t until = clocks_now() + TURN_NS;
    do
        MHD_run(h->mhd);
    while (is_ready(h) && clocks_now() < until);
    h->expire_ns = connections_expire(&h->connections, clocks_now());
}
