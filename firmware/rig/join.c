#include "firmware/rig/join.h"

#include "firmware/base/confedit.h"
#include "firmware/base/entropy.h"

#include "core/base/base64.h"
#include "drivers/device/clocks.h"
#include "drivers/format/textfile.h"
#include "drivers/net/mqtt.h"

#include <poll.h>
#include <stdlib.h>
#include <string.h>

enum { TOKEN_BYTES = 12, TRY_MS = 8000, KEYS = 10 };

static const struct textfile_rights secret = {0640, NULL, "hdrig", false},
                                    open_to_all = {0644, NULL, NULL, false},
                                    settings = {0644, NULL, NULL, true};

struct paths {
    char ca[FILE_PATH_CAP], password[FILE_PATH_CAP], token[FILE_PATH_CAP], conf[FILE_PATH_CAP];
};

static err_t find_paths(const char *dir, struct paths *p)
{
    if (!file_is_dir(dir))
        return err_fail(ERR_ARG, "%.200s: there is no such folder", dir);
    err_t e = file_join(dir, "rig-ca.pem", p->ca);
    if (!e)
        e = file_join(dir, "rig-password", p->password);
    if (!e)
        e = file_join(dir, "http-token", p->token);
    if (!e)
        e = file_join(dir, "hdrig.conf", p->conf);
    if (!e && strlen(p->password) >= CONFIG_TEXT - 32)
        e = err_fail(ERR_ARG, "%.60s...: too long for a setting", dir);
    return e;
}

static err_t write_ca(const char *path, const struct joinline *l)
{
    enum { LINE = 64 };
    char digits[JOINLINE_CA_MAX / 3 * 4 + 8], text[2 * sizeof digits];
    const size_t n = (size_t)(base64_encode(digits, l->ca, l->n_ca) - digits);
    int at = sprintf(text, TEXTFILE_MARK " rig join\n-----BEGIN CERTIFICATE-----\n");
    for (size_t i = 0; i < n; i += LINE)
        at += sprintf(text + at, "%.*s\n", (int)(n - i < LINE ? n - i : LINE), digits + i);
    sprintf(text + at, "-----END CERTIFICATE-----\n");
    return textfile_write(path, &open_to_all, text);
}

static err_t write_secret(const char *path, const char *value)
{
    char text[JOINLINE_PASSWORD_CAP + 2];
    snprintf(text, sizeof text, "%s\n", value);
    const err_t e = textfile_write(path, &secret, text);
    explicit_bzero(text, sizeof text);
    return e;
}

static err_t make_token(char out[JOINLINE_PASSWORD_CAP])
{
    unsigned char raw[TOKEN_BYTES];
    err_t e = entropy_fill(raw, sizeof raw);
    if (e)
        return e;
    *base64_encode_url(out, raw, sizeof raw) = 0;
    return OK;
}

/* The settings that change, and what they are to be. */
struct change {
    struct confedit value[KEYS];
    int n;
    char broker[JOINLINE_HOST_CAP + 32];
};

static void add_value(struct change *c, const char *key, const char *value)
{
    c->value[c->n++] = (struct confedit){key, value};
}

static void list_changes(const struct join *j, const struct paths *p, const struct config *old,
                         struct change *c)
{
    *c = (struct change){0};
    snprintf(c->broker, sizeof c->broker, "mqtts://%s:%d", j->line->host, j->line->port);
    add_value(c, "rig.role", j->conductor ? "conductor" : "member");
    add_value(c, "rig.name", j->line->rig);
    add_value(c, "rig.board", j->line->board);
    add_value(c, "rig.broker", c->broker);
    add_value(c, "rig.ca", p->ca);
    add_value(c, "rig.password_file", p->password);
    if (config_is_loopback(old->http_address))
        add_value(c, "http.address", "0.0.0.0");
    if (!old->http_token[0])
        add_value(c, "http.token_file", p->token);
}

/* The new text means what it should: somebody's way to write settings may be beyond confedit. */
static err_t check_text(const char *path, const char *text, const struct change *c,
                        struct config *set)
{
    struct config want;
    err_t e = config_parse(set, path, text, strlen(text));
    want = *set;
    for (int i = 0; !e && i < c->n; i++)
        e = config_set(&want, path, c->value[i].key, c->value[i].value);
    if (!e && memcmp(&want, set, sizeof want) != 0)
        e = err_fail(ERR_FORMAT,
                     "%s: lines that begin with a blank or the like: its settings must "
                     "be changed by hand",
                     path);
    return e;
}

static void tell_changes(const char *old, const struct change *c, FILE *told)
{
    char line[2 * CONFIG_TEXT];
    for (int i = 0; i < c->n; i++) {
        snprintf(line, sizeof line, "%s = %s\n", c->value[i].key, c->value[i].value);
        const char *at = strstr(old, line);
        if (!at || (at > old && at[-1] != '\n'))
            fputs(line, told);
    }
}

static err_t write_files(const struct join *j, const struct paths *p, struct join_outcome *out)
{
    err_t e = write_ca(p->ca, j->line);
    if (!e)
        e = write_secret(p->password, j->line->password);
    if (e || out->set.http_token[0] || file_exists(p->token))
        return e;
    e = make_token(out->token);
    return e ? e : write_secret(p->token, out->token);
}

err_t join_write(const struct join *j, FILE *told, struct join_outcome *out)
{
    struct paths p;
    struct change c;
    char *old = NULL, *text = NULL;
    config_defaults(&out->set);
    out->token[0] = 0;
    err_t e = find_paths(j->dir, &p);
    if (!e)
        e = config_load(&out->set, j->dir);
    if (!e)
        e = file_exists(p.conf) ? textfile_read(p.conf, CONFIG_FILE_MAX, &old) : OK;
    if (e)
        return e;
    list_changes(j, &p, &out->set, &c);
    e = confedit_apply(old ? old : "", c.value, c.n, &text);
    if (!e)
        e = check_text(p.conf, text, &c, &out->set);
    if (!e)
        e = write_files(j, &p, out);
    if (!e && (!old || strcmp(old, text) != 0))
        e = textfile_write(p.conf, &settings, text);
    if (!e)
        tell_changes(old ? old : "", &c, told);
    free(old);
    free(text);
    return e;
}

err_t join_try(const struct config *set, const struct joinline *line)
{
    char client[2 * TAKE_MEMBER_CAP + 16], why[MQTT_WHY_CAP] = "no answer";
    struct mqtt *m;
    struct mqtt_event ev;
    struct mqtt_url url;
    bool up = false, down = false;
    const int64_t end = clocks_now() + TRY_MS * INT64_C(1000000);
    snprintf(client, sizeof client, "hdrig-%s-%s-join", line->rig, line->board);
    err_t e = mqtt_parse_url(set->rig_broker, &url);
    const struct mqtt_config c = {.host = url.host,
                                  .port = url.port,
                                  .tls = true,
                                  .ca = set->rig_ca,
                                  .user = line->board,
                                  .password = line->password,
                                  .client = client};
    if (!e)
        e = mqtt_open(&c, &m);
    if (e)
        return e;
    while (!up && !down && clocks_now() < end) {
        struct pollfd p = {.fd = mqtt_fd(m), .events = POLLIN};
        poll(&p, 1, 100);
        while (mqtt_next(m, &ev) == OK) {
            up = up || ev.kind == MQTT_UP;
            down = down || ev.kind == MQTT_DOWN;
            if (ev.kind == MQTT_DOWN)
                snprintf(why, sizeof why, "%s", ev.why);
            mqtt_event_free(&ev);
        }
    }
    mqtt_close(m);
    return up ? OK : err_fail(ERR_LOST, "%s", why);
}
