#include "firmware/base/entropy.h"
#include "firmware/rig/boards_inner.h"
#include "firmware/store/joint.h"

#include "core/base/log.h"
#include "core/base/rotation.h"
#include "drivers/device/clocks.h"
#include "drivers/format/json.h"
#include "drivers/format/rigfile.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { PASSWORD_MAX = 256 };

/* Whether the joint take is on the disk with that member's part. */
static bool has_joint(void *ctx, const char *take, const char *member)
{
    const struct boards *b = ctx;
    char dir[FILE_PATH_CAP], path[FILE_PATH_CAP];
    struct cJSON *doc;
    bool found = false;
    if (file_join(b->set->store_path, take, dir) != OK ||
        file_join(dir, MANIFEST_FILE, path) != OK || !file_exists(path) ||
        json_read(path, &doc) != OK)
        return false;
    const struct cJSON *list = json_member(json_member(doc, "rig"), "members");
    for (const struct cJSON *x = json_first(list); x && !found; x = json_next(x)) {
        const char *name = json_string(json_member(x, "name"));
        found = name && strcmp(name, member) == 0;
    }
    json_free(doc);
    return found;
}

err_t boards_open_name(const struct config *set, char out[TAKE_MEMBER_CAP])
{
    char host[TAKE_MEMBER_CAP] = "";
    if (!set->rig_board[0] && gethostname(host, sizeof host - 1) != 0)
        return err_fail(ERR_ARG, "rig.board is empty, and this host has no name");
    snprintf(out, TAKE_MEMBER_CAP, "%.31s", set->rig_board[0] ? set->rig_board : host);
    for (char *p = out; *p && !set->rig_board[0]; p++) {
        *p = *p >= 'A' && *p <= 'Z' ? (char)(*p - 'A' + 'a') : *p;
        if (*p == '.')
            *p-- = 0;
    }
    if (strlen(set->rig_board) >= TAKE_MEMBER_CAP || !manifest_is_member(out))
        return err_fail(ERR_ARG,
                        "rig.board: \"%.40s\" is not a name of at most %d small letters, digits "
                        "and -",
                        out, TAKE_MEMBER_CAP - 1);
    return OK;
}

static err_t check_settings(const struct boards_config *cfg)
{
    const struct config *set = cfg->set;
    if (!manifest_is_member(set->rig_name))
        return err_fail(ERR_ARG, "rig.name: \"%.40s\" is not a name of small letters, digits and -",
                        set->rig_name);
    if (!set->rig_broker[0])
        return err_fail(ERR_ARG, "rig.broker is empty: a rig of several boards needs a broker");
    if (set->rig_role == CONFIG_MEMBER && !cfg->cameras)
        return err_fail(ERR_ARG, "rig.role is member, but no camera.1 is set");
    if (cfg->cameras && !cfg->http_port)
        return err_fail(ERR_ARG, "http.port is 0: the conductor could not fetch what this board "
                                 "photographs");
    return OK;
}

static err_t read_password(const char *path, char out[PASSWORD_MAX])
{
    out[0] = 0;
    if (!path[0])
        return OK;
    FILE *f = fopen(path, "re");
    if (!f || !fgets(out, PASSWORD_MAX, f)) {
        if (f)
            fclose(f);
        return err_fail(ERR_IO,
                        "rig.password_file: %s cannot be read, or is empty: hdrig rig join writes "
                        "it",
                        path);
    }
    fclose(f);
    out[strcspn(out, "\r\n")] = 0;
    return OK;
}

static err_t put_random(char *out, size_t digits)
{
    unsigned char raw[16];
    err_t e = entropy_fill(raw, sizeof raw);
    if (e)
        return e;
    for (size_t i = 0; i < digits; i++)
        out[i] = "0123456789abcdef"[i % 2 ? raw[i / 2] >> 4 : raw[i / 2] & 15];
    out[digits] = 0;
    return OK;
}

err_t boards_open_token(char *out)
{
    return put_random(out, MESSAGE_TOKEN_CAP - 1);
}

static err_t open_mqtt(struct boards *b)
{
    char topic[MESSAGE_TOPIC_CAP], will[160], client[CONFIG_TEXT + 64], password[PASSWORD_MAX];
    const bool leads = b->has_conductor;
    struct mqtt_url url;
    message_topic(b->set->rig_name, leads ? MESSAGE_CONDUCTOR : MESSAGE_MEMBER, b->member.name,
                  topic);
    if (leads) // epoch and board tell a later run of it from another conductor
        snprintf(will, sizeof will,
                 "{\"online\": false, \"epoch\": \"%s\", \"board\": \"%s\", \"version\": \"\"}",
                 b->epoch, b->member.name);
    else
        snprintf(will, sizeof will, "{\"online\": false, \"boot\": \"%s\"}", b->boot);
    snprintf(client, sizeof client, "hdrig-%s-%s%s", b->set->rig_name, b->member.name,
             leads ? "-conductor" : "");
    err_t e = mqtt_parse_url(b->set->rig_broker, &url);
    if (e)
        return err_fail(e, "rig.broker: %s", err_text());
    e = read_password(b->set->rig_password_file, password);
    const struct mqtt_config m = {.host = url.host,
                                  .port = url.port,
                                  .tls = url.tls,
                                  .ca = url.tls ? b->set->rig_ca : NULL,
                                  .user = password[0] ? b->member.name : NULL,
                                  .password = password[0] ? password : NULL,
                                  .client = client,
                                  .will_topic = topic,
                                  .will = will};
    if (!e)
        e = mqtt_open(&m, &b->mqtt);
    memset(password, 0, sizeof password);
    return e;
}

static err_t subscribe(struct boards *b, enum message_topic t, const char *member)
{
    char topic[MESSAGE_TOPIC_CAP];
    message_topic(b->set->rig_name, t, member, topic);
    return mqtt_subscribe(b->mqtt, topic, t == MESSAGE_ASK || t == MESSAGE_TIME ? 0 : 1);
}

static err_t read_views(struct boards *b)
{
    struct rig rig;
    if (!b->set->rig_file[0])
        return OK;
    err_t e = rigfile_read(b->set->rig_file, &rig);
    if (e)
        return err_fail(e, "rig.file: %s", err_text());
    for (int i = 0; i < rig.n; i++) {
        const struct camera *cam = &rig.views[i].cam;
        int k, exposure;
        double centre[3], r[9];
        if (!manifest_picture_is(rig.views[i].name, &k, &exposure))
            continue;
        rotation_centre(cam, centre);
        rotation_of_camera(cam, r); // its last row is the axis of the view in the world
        b->view[k] = (struct boards_view){true, (float)centre[0], (float)centre[2], (float)r[6],
                                          (float)r[8]};
    }
    cameras_free(&rig);
    return OK;
}

static err_t open_conductor(struct boards *b)
{
    char ids[CONDUCTOR_TAKES][STORE_ID_CAP];
    const struct clocks now = clocks_at(clocks_now());
    struct conductor_config c = {.set = b->set,
                                 .version = b->cfg.version,
                                 .common_ns = now.realtime_ns - now.monotonic_ns,
                                 .has = has_joint,
                                 .ctx = b};
    memcpy(c.epoch, b->epoch, sizeof c.epoch);
    memcpy(c.board, b->member.name, sizeof c.board);
    err_t e = conductor_init(&b->conductor, &c);
    if (!e)
        e = read_views(b);
    for (int i = 0; i < BOARDS_FETCHERS && !e; i++)
        e = tasks_open("fetch", b->cfg.store, b->set->store_path, &b->fetch[i]);
    for (int i = e ? 0 : joint_pending(b->set->store_path, ids, CONDUCTOR_TAKES) - 1; !e && i >= 0;
         i--) {
        struct message_order o;
        char *text = NULL;
        if (joint_order(b->set->store_path, ids[i], &text) == OK &&
            message_read_order(text, strlen(text), &o) == OK)
            boards_act_tell(b, (struct conductor_event){.kind = CONDUCTOR_MEMORY, .order = &o});
        else
            log_warn("rig: %s waits for its parts, but %s", ids[i], err_text());
        free(text);
    }
    static const enum message_topic heard[] = {MESSAGE_MEMBER, MESSAGE_REPORT, MESSAGE_ASK,
                                               MESSAGE_PRESS};
    for (size_t i = 0; !e && i < sizeof heard / sizeof heard[0]; i++)
        e = subscribe(b, heard[i], "+");
    return e;
}

static err_t open_member(struct boards *b)
{
    struct task k = {.kind = TASK_HOLDS};
    err_t e = subscribe(b, MESSAGE_ORDER, NULL);
    if (!e)
        e = subscribe(b, MESSAGE_TIME, b->member.name);
    return e ? e : tasks_add(b->disk, &k);
}

err_t boards_open(const struct boards_config *cfg, struct boards **out)
{
    *out = NULL;
    struct boards *b = calloc(1, sizeof *b);
    char name[TAKE_MEMBER_CAP];
    if (!b)
        return err_fail(ERR_NOMEM, "rig: no memory for its state");
    b->cfg = *cfg;
    b->set = cfg->set;
    b->has_conductor = cfg->set->rig_role == CONFIG_CONDUCTOR;
    b->has_member = cfg->cameras > 0;
    snprintf(b->epoch, sizeof b->epoch, "%016" PRIx64,
             (uint64_t)clocks_at(clocks_now()).realtime_ns);
    snprintf(b->token, sizeof b->token, "%s", cfg->token);
    snprintf(b->broker, sizeof b->broker, "the broker is not reached yet");
    err_t e = check_settings(cfg);
    if (!e)
        e = put_random(b->boot, MESSAGE_EPOCH_CAP - 1);
    if (!e)
        e = boards_open_name(cfg->set, name);
    if (!e) {
        member_init(&b->member, name);
        e = tasks_open("rig-disk", cfg->store, cfg->set->store_path, &b->disk);
    }
    if (!e)
        e = open_mqtt(b);
    if (!e)
        e = subscribe(b, MESSAGE_CONDUCTOR, NULL);
    if (!e && b->has_conductor)
        e = open_conductor(b);
    if (!e && b->has_member)
        e = open_member(b);
    if (e) {
        boards_close(b);
        return e;
    }
    *out = b;
    return OK;
}
