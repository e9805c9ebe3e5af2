/* Each connection has a client of the library of its own, so that nothing of an earlier one is left
 * in it. The thread
 *   1. looks for an address of the broker that answers (drivers/net/probe.h);
 *   2. connects there, and serves the connection until it ends;
 *   3. tells why, waits, and starts again.
 * Two locks: `lock` is held around calls of the library from outside the thread, and when the
 * thread replaces the client; `queue_lock` belongs to the events and is the only one that
 * callbacks take. A resolver may hold the thread up: then mqtt_close leaves the struct to it. */
#include "drivers/net/mqtt.h"

#include "core/base/log.h"
#include "drivers/device/clocks.h"
#include "drivers/net/probe.h"

#include <errno.h>
#include <fcntl.h>
#include <mosquitto.h>
#include <mqtt_protocol.h>
#include <netdb.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

enum {
    PORT_PLAIN = 1883,
    PORT_TLS = 8883,
    LOOP_MS = 500,      // how soon an end without a packet is seen
    HEADER_BYTES = 1024 // of a packet around its payload, at most
};
#define PAUSE_FIRST_NS 250000000
#define PAUSE_LAST_NS 5000000000
#define GOODBYE_NS 1000000000 // for what was published, and then for the end of the connection
#define CLOSE_NS 2000000000

struct node {
    struct mqtt_event e;
    struct node *next;
};

struct filter {
    char text[MQTT_TOPIC_CAP];
    int qos;
};

struct mqtt {
    struct mqtt_config cfg; // strings are ours
    pthread_t thread;
    pthread_mutex_t lock; // of what follows
    pthread_cond_t changed;
    struct mosquitto *client; // of the present connection
    bool up, stop;
    bool left, abandoned; // the thread has ended; it frees the struct
    int64_t stop_ns;
    int n_filters;
    struct filter filter[MQTT_FILTERS_MAX];

    pthread_mutex_t queue_lock; // of what follows
    struct node *first, *last;
    int n_events;
    int n_unsent; // messages published and not yet sent or, with QoS 1 and 2, acknowledged
    pthread_cond_t sent;
    unsigned n_dropped;
    int fd;

    bool accepted; // from here on: the thread's alone
    char why[MQTT_WHY_CAP], told[MQTT_WHY_CAP];
};

/* ---- URLs ---- */

static bool host_allowed(const char *host, size_t n, bool bracket)
{
    static const char name[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-._";
    static const char v6[] = "0123456789abcdefABCDEF:.";
    return n > 0 && n < MQTT_HOST_CAP && strspn(host, bracket ? v6 : name) >= n;
}

static bool port_of(const char *p, int *port)
{
    int v = 0;
    if (!*p)
        return false;
    for (; *p >= '0' && *p <= '9' && v <= 65535; p++)
        v = 10 * v + (*p - '0');
    *port = v;
    return !*p && v >= 1 && v <= 65535;
}

err_t mqtt_parse_url(const char *url, struct mqtt_url *out)
{
    *out = (struct mqtt_url){0};
    bool tls = strncmp(url, "mqtts://", 8) == 0;
    if (!tls && strncmp(url, "mqtt://", 7) != 0)
        return err_fail(ERR_ARG, "broker \"%.64s\": mqtts://HOST[:PORT] or mqtt://HOST[:PORT]",
                        url);
    const char *host = url + (tls ? 8 : 7), *end;
    bool bracket = *host == '[';
    host += bracket;
    size_t n = strcspn(host, bracket ? "]" : ":");
    if (!host_allowed(host, n, bracket) || (bracket && host[n] != ']'))
        return err_fail(ERR_ARG,
                        "broker \"%.64s\": the host is a name of fewer than %d letters, digits, "
                        "- . and _, an IPv4 address, or an IPv6 address in brackets",
                        url, MQTT_HOST_CAP);
    int port = tls ? PORT_TLS : PORT_PLAIN;
    end = host + n + bracket;
    if (*end && (*end != ':' || !port_of(end + 1, &port)))
        return err_fail(ERR_ARG, "broker \"%.64s\": a port of 1 to 65535 ends it", url);
    memcpy(out->host, host, n);
    out->port = port;
    out->tls = tls;
    return OK;
}

/* ---- events ---- */

/* The oldest message makes place; without any, the oldest event. */
static void drop_oldest(struct mqtt *m)
{
    struct node *before = NULL, *k = m->first;
    while (k && k->e.kind != MQTT_MESSAGE) {
        before = k;
        k = k->next;
    }
    if (!k) {
        before = NULL;
        k = m->first;
    }
    *(before ? &before->next : &m->first) = k->next;
    if (m->last == k)
        m->last = before;
    m->n_events--;
    free(k->e.payload);
    free(k);
    if (m->n_dropped++ == 0)
        log_warn("broker %s: messages come faster than they are read; the oldest are dropped",
                 m->cfg.host);
}

/* k may be NULL: there was no memory for it. */
static void append_event(struct mqtt *m, struct node *k)
{
    pthread_mutex_lock(&m->queue_lock);
    if (!k && m->n_dropped++ == 0)
        log_warn("broker %s: no memory for a message", m->cfg.host);
    if (k && m->n_events >= MQTT_EVENTS_MAX)
        drop_oldest(m);
    if (k) {
        *(m->last ? &m->last->next : &m->first) = k;
        m->last = k;
        m->n_events++;
        eventfd_write(m->fd, 1);
    }
    pthread_mutex_unlock(&m->queue_lock);
}

static void append_state(struct mqtt *m, enum mqtt_kind kind, const char *why)
{
    struct node *k = calloc(1, sizeof *k);
    if (k) {
        k->e.kind = kind;
        snprintf(k->e.why, sizeof k->e.why, "%s", why);
    }
    append_event(m, k);
}

err_t mqtt_next(struct mqtt *m, struct mqtt_event *out)
{
    eventfd_t count;
    *out = (struct mqtt_event){0};
    pthread_mutex_lock(&m->queue_lock);
    struct node *k = m->first;
    if (k) {
        m->first = k->next;
        m->n_events--;
    }
    if (k && !m->first) {
        m->last = NULL;
        eventfd_read(m->fd, &count);
        if (m->n_dropped)
            log_warn("broker %s: %u messages were dropped", m->cfg.host, m->n_dropped);
        m->n_dropped = 0;
    }
    pthread_mutex_unlock(&m->queue_lock);
    if (!k)
        return ERR_AGAIN;
    *out = k->e;
    free(k);
    return OK;
}

void mqtt_event_free(struct mqtt_event *e)
{
    free(e->payload);
    *e = (struct mqtt_event){0};
}

/* ---- messages on their way out ---- */

static void count_unsent(struct mqtt *m, int change)
{
    pthread_mutex_lock(&m->queue_lock);
    m->n_unsent += change;
    pthread_cond_broadcast(&m->sent);
    pthread_mutex_unlock(&m->queue_lock);
}

static void forget_unsent(struct mqtt *m)
{
    pthread_mutex_lock(&m->queue_lock);
    m->n_unsent = 0;
    pthread_cond_broadcast(&m->sent);
    pthread_mutex_unlock(&m->queue_lock);
}

static void wait_until_sent(struct mqtt *m, int64_t end_ns)
{
    struct timespec t = {.tv_sec = end_ns / 1000000000, .tv_nsec = end_ns % 1000000000};
    pthread_mutex_lock(&m->queue_lock);
    while (m->n_unsent > 0 && pthread_cond_timedwait(&m->sent, &m->queue_lock, &t) == 0)
        continue;
    pthread_mutex_unlock(&m->queue_lock);
}

/* ---- callbacks of the library, in the thread ---- */

static void on_connect(struct mosquitto *c, void *ctx, int reason, int flags,
                       const mosquitto_property *p)
{
    struct mqtt *m = ctx;
    (void)c;
    (void)flags;
    (void)p;
    m->accepted = reason == 0;
    if (reason)
        snprintf(m->why, sizeof m->why, "%s", mosquitto_reason_string(reason));
}

/* Reasons of the broker; the others are errors of the library. */
static void on_disconnect(struct mosquitto *c, void *ctx, int reason, const mosquitto_property *p)
{
    struct mqtt *m = ctx;
    (void)c;
    (void)p;
    if (reason >= MQTT_RC_UNSPECIFIED)
        snprintf(m->why, sizeof m->why, "%s", mosquitto_reason_string(reason));
}

static void on_message(struct mosquitto *c, void *ctx, const struct mosquitto_message *got,
                       const mosquitto_property *p)
{
    (void)c;
    (void)p;
    size_t n = (size_t)got->payloadlen;
    if (strlen(got->topic) >= MQTT_TOPIC_CAP || n > MQTT_PAYLOAD_MAX)
        return;
    struct node *k = calloc(1, sizeof *k);
    char *payload = malloc(n + 1);
    if (k && payload) {
        if (n)
            memcpy(payload, got->payload, n);
        payload[n] = 0;
        k->e = (struct mqtt_event){
            .kind = MQTT_MESSAGE, .retained = got->retain, .payload = payload, .n = n};
        memcpy(k->e.topic, got->topic, strlen(got->topic));
    } else {
        free(k);
        free(payload);
        k = NULL;
    }
    append_event(ctx, k);
}

static void on_subscribe(struct mosquitto *c, void *ctx, int id, int n, const int *granted,
                         const mosquitto_property *p)
{
    const struct mqtt *m = ctx;
    (void)c;
    (void)id;
    (void)p;
    for (int i = 0; i < n; i++)
        if (granted[i] >= MQTT_RC_UNSPECIFIED)
            log_error("broker %s: a subscription of %s is refused: %s", m->cfg.host, m->cfg.client,
                      mosquitto_reason_string(granted[i]));
}

static void on_publish(struct mosquitto *c, void *ctx, int id, int reason,
                       const mosquitto_property *p)
{
    struct mqtt *m = ctx;
    (void)c;
    (void)id;
    (void)p;
    count_unsent(m, -1);
    if (reason >= MQTT_RC_UNSPECIFIED)
        log_error("broker %s: a message of %s is refused: %s", m->cfg.host, m->cfg.client,
                  mosquitto_reason_string(reason));
}

/* Why TLS failed at the start is known from here alone, as "OpenSSL Error[0]: error:...:REASON". */
static void on_log(struct mosquitto *c, void *ctx, int level, const char *text)
{
    struct mqtt *m = ctx;
    (void)c;
    if (level != MOSQ_LOG_ERR || m->why[0] || m->accepted)
        return;
    const char *colon = strncmp(text, "OpenSSL", 7) == 0 ? strrchr(text, ':') : NULL;
    text += strncmp(text, "Error: ", 7) == 0 ? 7 : 0;
    snprintf(m->why, sizeof m->why, "TLS: %s", colon && colon[1] ? colon + 1 : text);
    m->why[strcspn(m->why, "\n")] = 0;
}

/* ---- a client of the library ---- */

static err_t code_of(int rc)
{
    switch (rc) {
    case MOSQ_ERR_NOMEM:
        return ERR_NOMEM;
    case MOSQ_ERR_NO_CONN:
    case MOSQ_ERR_CONN_LOST:
        return ERR_LOST;
    case MOSQ_ERR_PAYLOAD_SIZE:
    case MOSQ_ERR_OVERSIZE_PACKET:
        return ERR_LIMIT;
    default:
        return ERR_ARG;
    }
}

static err_t broker_fail(const struct mqtt_config *g, const char *what, int rc)
{
    return err_fail(code_of(rc), "broker %s:%d: %s: %s", g->host, g->port, what,
                    mosquitto_strerror(rc));
}

static err_t make_client(struct mqtt *m, struct mosquitto **out)
{
    const struct mqtt_config *g = &m->cfg;
    *out = NULL;
    struct mosquitto *c = mosquitto_new(g->client, true, m);
    if (!c)
        return err_fail(ERR_NOMEM, "broker %s: no memory for a connection", g->host);
    const char *what = "MQTT 5";
    int rc = mosquitto_int_option(c, MOSQ_OPT_PROTOCOL_VERSION, MQTT_PROTOCOL_V5);
    if (!rc)
        rc = mosquitto_threaded_set(c, true);
    if (!rc && g->user) {
        what = "user and password";
        rc = mosquitto_username_pw_set(c, g->user, g->password);
    }
    if (!rc && g->will_topic) {
        what = g->will_topic;
        rc = mosquitto_will_set_v5(c, g->will_topic, (int)strlen(g->will), g->will, 1, true, NULL);
    }
    if (!rc && g->tls) {
        what = g->ca;
        rc = mosquitto_tls_set(c, g->ca, NULL, NULL, NULL, NULL);
    }
    if (rc) {
        mosquitto_destroy(c);
        return broker_fail(g, what, rc);
    }
    mosquitto_connect_v5_callback_set(c, on_connect);
    mosquitto_disconnect_v5_callback_set(c, on_disconnect);
    mosquitto_message_v5_callback_set(c, on_message);
    mosquitto_subscribe_v5_callback_set(c, on_subscribe);
    mosquitto_publish_v5_callback_set(c, on_publish);
    mosquitto_log_callback_set(c, on_log);
    *out = c;
    return OK;
}

/* ---- the thread ---- */

static bool is_stopping(struct mqtt *m, int64_t after_ns)
{
    pthread_mutex_lock(&m->lock);
    bool stop = m->stop && clocks_now() >= m->stop_ns + after_ns;
    pthread_mutex_unlock(&m->lock);
    return stop;
}

static bool is_over(void *ctx)
{
    return is_stopping(ctx, 0);
}

/* The certificate is of the name, so with TLS the library finds the address once more. */
static int connect_client(struct mqtt *m, struct mosquitto *c, const char *address)
{
    mosquitto_property *p = NULL;
    int rc = mosquitto_property_add_int32(&p, MQTT_PROP_MAXIMUM_PACKET_SIZE,
                                          MQTT_PAYLOAD_MAX + HEADER_BYTES);
    if (!rc)
        rc = mosquitto_connect_bind_v5(c, m->cfg.tls ? m->cfg.host : address, m->cfg.port,
                                       MQTT_KEEPALIVE_S, NULL, p);
    mosquitto_property_free_all(&p);
    return rc;
}

/* What failed in the library, unless a callback knows better. */
static void explain(struct mqtt *m, int rc, int error)
{
    if (m->why[0])
        return;
    const char *text = mosquitto_strerror(rc);
    if (rc == MOSQ_ERR_ERRNO && error && error != EPROTO)
        text = strerror(error);
    else if (rc == MOSQ_ERR_SUCCESS || rc == MOSQ_ERR_CONN_LOST || rc == MOSQ_ERR_ERRNO)
        text = "the connection was lost";
    else if (rc == MOSQ_ERR_KEEPALIVE)
        text = "it does not answer";
    snprintf(m->why, sizeof m->why, "%s", text);
}

/* Subscriptions come before the event, so that its reader misses nothing that he causes. */
static void go_up(struct mqtt *m, struct mosquitto *c)
{
    pthread_mutex_lock(&m->lock);
    m->up = true;
    for (int i = 0; i < m->n_filters; i++)
        if (mosquitto_subscribe_v5(c, NULL, m->filter[i].text, m->filter[i].qos, 0, NULL) != 0)
            log_error("broker %s: %s cannot be subscribed", m->cfg.host, m->filter[i].text);
    pthread_mutex_unlock(&m->lock);
    m->told[0] = 0;
    append_state(m, MQTT_UP, "");
}

/* The library closes the socket behind its last packet. Were something unread then, the broker
 * would be sent a reset, might not read that packet, and would publish the will: so `fd`, a
 * duplicate, keeps the connection until the broker ends it. */
static void wait_for_end(int fd, int64_t end_ns)
{
    char bytes[4096];
    shutdown(fd, SHUT_WR);
    for (int64_t left = end_ns - clocks_now(); left > 0; left = end_ns - clocks_now()) {
        struct pollfd p = {.fd = fd, .events = POLLIN};
        if (poll(&p, 1, (int)(left / 1000000) + 1) > 0 && read(fd, bytes, sizeof bytes) <= 0)
            break;
    }
}

static void serve_client(struct mqtt *m, struct mosquitto *c)
{
    int rc = 0, error = 0, twin = fcntl(mosquitto_socket(c), F_DUPFD_CLOEXEC, 0);
    bool up = false;
    pthread_mutex_lock(&m->lock);
    bool stop = m->stop;
    m->client = stop ? NULL : c;
    pthread_mutex_unlock(&m->lock);
    while (!stop && rc == 0 && mosquitto_socket(c) >= 0) {
        errno = 0;
        rc = mosquitto_loop(c, LOOP_MS, 1);
        error = errno;
        if (m->accepted && !up)
            go_up(m, c);
        up = m->accepted;
        stop = is_stopping(m, GOODBYE_NS);
    }
    pthread_mutex_lock(&m->lock);
    m->client = NULL;
    m->up = false;
    stop = m->stop;
    forget_unsent(m);
    pthread_mutex_unlock(&m->lock);
    if (stop && twin >= 0)
        wait_for_end(twin, m->stop_ns + GOODBYE_NS);
    if (twin >= 0)
        close(twin);
    explain(m, rc, error);
}

/* One connection from its beginning to its end. Returns whether the broker accepted it. */
static bool run_connection(struct mqtt *m)
{
    char address[PROBE_ADDRESS_CAP];
    struct mosquitto *c;
    m->accepted = false;
    const char *why = probe_host(m->cfg.host, m->cfg.port, is_over, m, address);
    snprintf(m->why, sizeof m->why, "%s", why ? why : "");
    if (why)
        return false;
    if (make_client(m, &c) != OK) {
        snprintf(m->why, sizeof m->why, "%s", err_text());
        return false;
    }
    errno = 0;
    int rc = connect_client(m, c, address);
    if (rc)
        explain(m, rc, errno);
    else
        serve_client(m, c);
    mosquitto_destroy(c);
    return m->accepted;
}

static void tell_down(struct mqtt *m, bool was_up)
{
    char why[MQTT_WHY_CAP];
    if (!was_up && strcmp(m->why, m->told) == 0)
        return;
    snprintf(why, sizeof why, "broker %.80s:%d: %.150s", m->cfg.host, m->cfg.port, m->why);
    memcpy(m->told, m->why, sizeof m->told);
    append_state(m, MQTT_DOWN, why);
}

static void wait_or_stop(struct mqtt *m, int64_t ns)
{
    int64_t end = clocks_now() + ns;
    struct timespec t = {.tv_sec = end / 1000000000, .tv_nsec = end % 1000000000};
    pthread_mutex_lock(&m->lock);
    while (!m->stop && pthread_cond_timedwait(&m->changed, &m->lock, &t) == 0)
        continue;
    pthread_mutex_unlock(&m->lock);
}

static void free_all(struct mqtt *m)
{
    while (m->first) {
        struct node *k = m->first;
        m->first = k->next;
        free(k->e.payload);
        free(k);
    }
    const char *strings[] = {m->cfg.host,     m->cfg.ca,   m->cfg.user,      m->cfg.client,
                             m->cfg.password, m->cfg.will, m->cfg.will_topic};
    for (size_t i = 0; i < sizeof strings / sizeof strings[0]; i++)
        free((void *)(uintptr_t)strings[i]);
    if (m->fd >= 0)
        close(m->fd);
    pthread_cond_destroy(&m->changed);
    pthread_cond_destroy(&m->sent);
    pthread_mutex_destroy(&m->queue_lock);
    pthread_mutex_destroy(&m->lock);
    free(m);
}

static void *keep_connected(void *ctx)
{
    struct mqtt *m = ctx;
    int64_t pause = PAUSE_FIRST_NS;
    while (!is_stopping(m, 0)) {
        bool was_up = run_connection(m);
        if (is_stopping(m, 0))
            break;
        tell_down(m, was_up);
        pause = was_up ? PAUSE_FIRST_NS : pause;
        wait_or_stop(m, pause);
        pause = 2 * pause < PAUSE_LAST_NS ? 2 * pause : PAUSE_LAST_NS;
    }
    pthread_mutex_lock(&m->lock);
    bool abandoned = m->abandoned;
    m->left = true;
    pthread_cond_broadcast(&m->changed);
    pthread_mutex_unlock(&m->lock);
    if (abandoned)
        free_all(m);
    return NULL;
}

/* ---- life ---- */

static void init_library(void)
{
    mosquitto_lib_init();
}

static bool copy_string(const char **at, const char *from)
{
    *at = from ? strdup(from) : NULL;
    return !from || *at;
}

static err_t copy_config(struct mqtt_config *to, const struct mqtt_config *from)
{
    to->port = from->port;
    to->tls = from->tls;
    bool ok = copy_string(&to->host, from->host) && copy_string(&to->ca, from->ca) &&
              copy_string(&to->user, from->user) && copy_string(&to->password, from->password) &&
              copy_string(&to->client, from->client) && copy_string(&to->will, from->will) &&
              copy_string(&to->will_topic, from->will_topic);
    return ok ? OK : err_fail(ERR_NOMEM, "broker %s: no memory for its settings", from->host);
}

static err_t check_config(const struct mqtt_config *g)
{
    if (!g->host || !*g->host || g->port < 1 || g->port > 65535)
        return err_fail(ERR_ARG, "broker: a host and a port of 1 to 65535 are needed");
    if (!g->client || !*g->client)
        return err_fail(ERR_ARG, "broker %s: the client has no name", g->host);
    if (g->will_topic && (!g->will || strlen(g->will) > MQTT_PAYLOAD_MAX))
        return err_fail(ERR_ARG, "broker %s: a last will of at most %d bytes is needed", g->host,
                        MQTT_PAYLOAD_MAX);
    if (g->tls && !g->ca)
        return err_fail(ERR_ARG, "broker %s: TLS needs the file of its authority", g->host);
    if (g->tls && access(g->ca, R_OK) != 0)
        return err_fail(ERR_IO, "%s: %s", g->ca, strerror(errno));
    return OK;
}

/* All signals go to other threads. */
static err_t start_thread(struct mqtt *m)
{
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    int why = pthread_create(&m->thread, NULL, keep_connected, m);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    if (why)
        return err_fail(ERR_NOMEM, "broker: cannot start its thread: %s", strerror(why));
    pthread_setname_np(m->thread, "mqtt");
    return OK;
}

err_t mqtt_open(const struct mqtt_config *cfg, struct mqtt **out)
{
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    pthread_condattr_t attr;
    struct mosquitto *trial;
    *out = NULL;
    err_t e = check_config(cfg);
    if (e)
        return e;
    pthread_once(&once, init_library);
    struct mqtt *m = calloc(1, sizeof *m);
    if (!m)
        return err_fail(ERR_NOMEM, "broker %s: no memory for its state", cfg->host);
    pthread_mutex_init(&m->lock, NULL);
    pthread_mutex_init(&m->queue_lock, NULL);
    pthread_condattr_init(&attr);
    pthread_condattr_setclock(&attr, CLOCK_MONOTONIC);
    pthread_cond_init(&m->changed, &attr);
    pthread_cond_init(&m->sent, &attr);
    pthread_condattr_destroy(&attr);
    m->fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    e = m->fd < 0 ? err_fail(ERR_IO, "broker: eventfd: %s", strerror(errno))
                  : copy_config(&m->cfg, cfg);
    if (!e)
        e = make_client(m, &trial); // so that wrong settings are known at once
    if (!e) {
        mosquitto_destroy(trial);
        e = start_thread(m);
    }
    if (e) {
        free_all(m);
        return e;
    }
    *out = m;
    return OK;
}

void mqtt_close(struct mqtt *m)
{
    if (!m)
        return;
    pthread_t thread = m->thread;
    wait_until_sent(m, clocks_now() + GOODBYE_NS);
    pthread_mutex_lock(&m->lock);
    m->stop = true;
    m->stop_ns = clocks_now();
    if (m->client)
        mosquitto_disconnect_v5(m->client, 0, NULL);
    pthread_cond_broadcast(&m->changed);
    int64_t end = m->stop_ns + CLOSE_NS;
    struct timespec t = {.tv_sec = end / 1000000000, .tv_nsec = end % 1000000000};
    while (!m->left && pthread_cond_timedwait(&m->changed, &m->lock, &t) == 0)
        continue;
    bool left = m->left;
    m->abandoned = !left;
    pthread_mutex_unlock(&m->lock);
    if (!left) {
        pthread_detach(thread);
        return;
    }
    pthread_join(thread, NULL);
    free_all(m);
}

int mqtt_fd(const struct mqtt *m)
{
    return m->fd;
}

/* ---- what the caller asks for ---- */

err_t mqtt_subscribe(struct mqtt *m, const char *filter, int qos)
{
    size_t n = strlen(filter);
    if (n >= MQTT_TOPIC_CAP || mosquitto_sub_topic_check(filter) != 0 || qos < 0 || qos > 2)
        return err_fail(ERR_ARG, "filter \"%.64s\" with QoS %d: fewer than %d bytes, QoS 0 to 2",
                        filter, qos, MQTT_TOPIC_CAP);
    int i = 0, rc = 0;
    pthread_mutex_lock(&m->lock);
    while (i < m->n_filters && strcmp(m->filter[i].text, filter) != 0)
        i++;
    bool room = i < MQTT_FILTERS_MAX;
    if (room) {
        memcpy(m->filter[i].text, filter, n + 1);
        m->filter[i].qos = qos;
        m->n_filters = i < m->n_filters ? m->n_filters : i + 1;
    }
    if (room && m->up)
        rc = mosquitto_subscribe_v5(m->client, NULL, filter, qos, 0, NULL);
    pthread_mutex_unlock(&m->lock);
    if (!room)
        return err_fail(ERR_LIMIT, "filter \"%.64s\": there are %d already", filter,
                        MQTT_FILTERS_MAX);
    // a connection that was just lost subscribes when it comes back
    return rc == 0 || code_of(rc) == ERR_LOST ? OK : broker_fail(&m->cfg, filter, rc);
}

err_t mqtt_publish(struct mqtt *m, const char *topic, const char *text, int qos, bool retain)
{
    size_t n = strlen(text);
    if (n > MQTT_PAYLOAD_MAX)
        return err_fail(ERR_LIMIT, "message to %.64s: %zu bytes, at most %d", topic, n,
                        MQTT_PAYLOAD_MAX);
    if (strlen(topic) >= MQTT_TOPIC_CAP)
        return err_fail(ERR_ARG, "topic \"%.64s...\": at most %d bytes", topic, MQTT_TOPIC_CAP - 1);
    int rc = MOSQ_ERR_NO_CONN;
    pthread_mutex_lock(&m->lock);
    if (m->up) {
        count_unsent(m, 1);
        rc = mosquitto_publish_v5(m->client, NULL, topic, (int)n, text, qos, retain, NULL);
        if (rc)
            count_unsent(m, -1);
    }
    pthread_mutex_unlock(&m->lock);
    if (rc == MOSQ_ERR_NO_CONN)
        return err_fail(ERR_LOST, "broker %s:%d: not connected", m->cfg.host, m->cfg.port);
    return rc ? broker_fail(&m->cfg, topic, rc) : OK;
}

err_t mqtt_address(const struct mqtt *m, char *out, size_t cap)
{
    pthread_mutex_t *lock = (pthread_mutex_t *)(uintptr_t)&m->lock;
    struct sockaddr_storage a;
    socklen_t n = sizeof a;
    pthread_mutex_lock(lock);
    int fd = m->up ? mosquitto_socket(m->client) : -1;
    int why = fd >= 0 && getsockname(fd, (struct sockaddr *)&a, &n) != 0 ? errno : 0;
    pthread_mutex_unlock(lock);
    if (fd < 0)
        return err_fail(ERR_LOST, "broker %s:%d: not connected", m->cfg.host, m->cfg.port);
    if (why)
        return err_fail(ERR_IO, "broker %s: own address: %s", m->cfg.host, strerror(why));
    int rc = getnameinfo((struct sockaddr *)&a, n, out, (socklen_t)cap, NULL, 0, NI_NUMERICHOST);
    return rc ? err_fail(rc == EAI_OVERFLOW ? ERR_LIMIT : ERR_IO, "broker %s: own address: %s",
                         m->cfg.host, gai_strerror(rc))
              : OK;
}
