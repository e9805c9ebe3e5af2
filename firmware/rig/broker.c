/* What is secret is made in a folder that nobody else can read, hdrig/.new-XXXXXX, and goes from
 * there to its place. The certificates are valid since 2020: a board without a battery for its
 * clock begins with some time of the past. */
#include "firmware/rig/broker.h"

#include "firmware/base/entropy.h"
#include "firmware/base/tool.h"
#include "firmware/rig/message.h"

#include "core/base/base64.h"
#include "drivers/format/textfile.h"
#include "drivers/net/mqtt.h"

#include <arpa/inet.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum { YEARS = 20, USERS_MAX = 1 << 18, PEM_MAX = 1 << 14, PASSWORD_BYTES = 16 };

/* Later versions of mosquitto want to own what they read. */
static const struct textfile_rights all = {0644, NULL, NULL, false},
                                    nobody = {0600, NULL, NULL, false},
                                    broker = {0640, "mosquitto", "mosquitto", false};

struct work {
    const char *dir; // of mosquitto
    char own[FILE_PATH_CAP], tmp[FILE_PATH_CAP];
    int lock;
};

/* ---- the folder ---- */

static err_t own_path(const struct work *w, const char *name, char out[FILE_PATH_CAP])
{
    if (strcmp(name, "hdrig.conf") != 0)
        return file_join(w->own, name, out);
    const err_t e = file_join(w->dir, "conf.d", out);
    char dir[FILE_PATH_CAP];
    memcpy(dir, out, sizeof dir);
    return e ? e : file_join(dir, name, out);
}

static err_t work_open(const char *dir, struct work *w)
{
    *w = (struct work){.dir = dir, .lock = -1};
    err_t e = file_join(dir, "hdrig", w->own);
    if (!e && !file_is_dir(w->own))
        e = err_fail(ERR_LOST, "%s: hdrig rig broker has not been called on this machine", w->own);
    if (!e)
        e = file_join(w->own, ".new-XXXXXX", w->tmp);
    if (e)
        return e;
    w->lock = open(w->own, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (w->lock >= 0 && flock(w->lock, LOCK_EX) == 0 && mkdtemp(w->tmp))
        return OK;
    e = err_fail(file_code(errno), "%s: %s", w->own, strerror(errno));
    if (w->lock >= 0)
        close(w->lock);
    *w = (struct work){.lock = -1};
    return e;
}

static void work_close(struct work *w)
{
    char path[FILE_PATH_CAP];
    DIR *d = w->lock >= 0 ? opendir(w->tmp) : NULL;
    for (const struct dirent *x = d ? readdir(d) : NULL; x; x = readdir(d))
        if (x->d_type != DT_DIR && file_join(w->tmp, x->d_name, path) == OK)
            unlink(path);
    if (d)
        closedir(d);
    if (w->lock >= 0) {
        rmdir(w->tmp);
        close(w->lock);
    }
}

static err_t tmp_write(const struct work *w, const char *name, const char *text)
{
    char path[FILE_PATH_CAP];
    const err_t e = file_join(w->tmp, name, path);
    return e ? e : textfile_write(path, &nobody, text);
}

/* A file of tmp under its name, with our mark. */
static err_t show(const struct work *w, const char *from, const char *name,
                  const struct textfile_rights *r)
{
    char path[FILE_PATH_CAP], *text = NULL, *marked = NULL;
    err_t e = file_join(w->tmp, from, path);
    if (!e)
        e = textfile_read(path, PEM_MAX, &text);
    if (!e && asprintf(&marked, TEXTFILE_MARK "\n%s", text) < 0)
        e = err_fail(ERR_NOMEM, "%s: no memory", path);
    if (!e)
        e = own_path(w, name, path);
    if (!e)
        e = textfile_write(path, r, marked);
    if (text)
        explicit_bzero(text, strlen(text));
    if (marked)
        explicit_bzero(marked, strlen(marked));
    free(text);
    free(marked);
    return e;
}

/* ---- certificates ---- */

static err_t write_conf(const struct work *w, const char *host)
{
    char text[1024], bare[JOINLINE_HOST_CAP];
    unsigned char address[16];
    snprintf(bare, sizeof bare, "%.*s", (int)strcspn(host + (*host == '['), "]"),
             host + (*host == '['));
    const bool is_address =
        inet_pton(AF_INET, bare, address) == 1 || inet_pton(AF_INET6, bare, address) == 1;
    snprintf(text, sizeof text,
             "[req]\ndistinguished_name = name\n[name]\n"
             "[ca]\ndefault_ca = us\n[us]\ndatabase = index\nnew_certs_dir = .\nrand_serial = yes\n"
             "default_md = sha256\npolicy = any\nemail_in_dn = no\nunique_subject = no\n"
             "[any]\ncommonName = supplied\n"
             "[authority]\nbasicConstraints = critical, CA:TRUE\nkeyUsage = critical, keyCertSign\n"
             "subjectKeyIdentifier = none\nauthorityKeyIdentifier = none\n"
             "[server]\nbasicConstraints = critical, CA:FALSE\nextendedKeyUsage = serverAuth\n"
             "subjectKeyIdentifier = none\nauthorityKeyIdentifier = none\n"
             "subjectAltName = %s:%s\n",
             is_address ? "IP" : "DNS", bare);
    err_t e = tmp_write(w, "conf", text);
    return e ? e : tmp_write(w, "index", "");
}

/* openssl, with `cd` to tmp: its settings have relative paths, since ours may have any letters. */
static err_t openssl(const struct work *w, const char *words)
{
    char line[1024];
    char *const argv[] = {"sh", "-c", line, "hdrig", (char *)w->tmp, NULL};
    snprintf(line, sizeof line, "cd \"$1\" && umask 077 && exec openssl %s", words);
    const err_t e = tool_run(argv);
    return e ? err_fail(e, "openssl: %s", err_text()) : OK;
}

static err_t sign(const struct work *w, const char *who)
{
    char line[512], until[24];
    time_t now = time(NULL);
    struct tm t;
    gmtime_r(&now, &t);
    t.tm_year = t.tm_year < 120 ? 120 : t.tm_year;
    snprintf(until, sizeof until, "%04d0101000000Z", 1900 + t.tm_year + YEARS + 1);
    snprintf(line, sizeof line,
             "ca -batch -config conf -notext -in csr -keyfile %s -startdate 20200101000000Z "
             "-enddate %s -out pem",
             strcmp(who, "authority") == 0 ? "key -selfsign -extensions authority"
                                           : "ca.key -cert ca.pem -extensions server",
             until);
    return openssl(w, line);
}

static err_t make_certificate(const struct work *w, const char *who)
{
    char line[256];
    uint32_t number = 0; // tells this authority from others, so that refusals say so
    err_t e = entropy_fill(&number, sizeof number);
    if (!e)
        e = openssl(w, "ecparam -name prime256v1 -genkey -noout -out key");
    snprintf(line, sizeof line,
             "req -new -config conf -key key -subj \"/CN=hdrig %s %08" PRIx32 "\" -out csr", who,
             number);
    if (!e)
        e = openssl(w, line);
    return e ? e : sign(w, who);
}

/* A file of ours for openssl, without our mark. */
static err_t copy_in(const struct work *w, const char *name)
{
    char path[FILE_PATH_CAP], *text = NULL;
    err_t e = own_path(w, name, path);
    if (!e)
        e = textfile_read(path, PEM_MAX, &text);
    if (!e)
        e = tmp_write(w, name, text);
    if (text)
        explicit_bzero(text, strlen(text));
    free(text);
    return e;
}

static err_t make_authority(const struct work *w)
{
    char path[FILE_PATH_CAP];
    err_t e = own_path(w, "ca.pem", path);
    if (e || file_exists(path)) // which is written last
        return e;
    e = make_certificate(w, "authority");
    if (!e)
        e = show(w, "key", "ca.key", &nobody);
    return e ? e : show(w, "pem", "ca.pem", &all);
}

static err_t make_server(const struct work *w)
{
    err_t e = copy_in(w, "ca.key");
    if (!e)
        e = copy_in(w, "ca.pem");
    if (!e)
        e = make_certificate(w, "server");
    if (!e)
        e = show(w, "key", "server.key", &broker);
    return e ? e : show(w, "pem", "server.pem", &all);
}

/* ---- settings ---- */

/* Members write under their own names only. */
static err_t write_rules(const struct work *w, const struct broker_site *s)
{
    static const char *const writes[] = {"member", "report", "ask", "press"};
    char text[2048], path[FILE_PATH_CAP];
    int n = snprintf(text, sizeof text,
                     TEXTFILE_MARK " rig broker\nuser %s\ntopic readwrite hdrig/1/%s/#\n",
                     s->conductor, s->rig);
    for (size_t i = 0; i < sizeof writes / sizeof writes[0]; i++)
        n += snprintf(text + n, sizeof text - (size_t)n, "pattern write hdrig/1/%s/%s/%%u\n",
                      s->rig, writes[i]);
    snprintf(text + n, sizeof text - (size_t)n,
             "pattern read hdrig/1/%s/conductor\npattern read hdrig/1/%s/order\n"
             "pattern read hdrig/1/%s/time/%%u\n",
             s->rig, s->rig, s->rig);
    const err_t e = own_path(w, "acl", path);
    return e ? e : textfile_write(path, &broker, text);
}

static err_t write_settings(const struct work *w, const struct broker_site *s)
{
    char text[4 * FILE_PATH_CAP + 1024], path[FILE_PATH_CAP];
    snprintf(text, sizeof text,
             TEXTFILE_MARK " rig broker, which changes it\n"
                           "# host=%s port=%d rig=%s conductor=%s\n"
                           "listener %d\nallow_anonymous false\n"
                           "password_file %s/users\nacl_file %s/acl\n"
                           "certfile %s/server.pem\nkeyfile %s/server.key\ntls_version tlsv1.2\n"
                           "max_packet_size %d\nset_tcp_nodelay true\n",
             s->host, s->port, s->rig, s->conductor, s->port, w->own, w->own, w->own, w->own,
             2 * MESSAGE_MAX);
    const err_t e = own_path(w, "hdrig.conf", path);
    return e ? e : textfile_write(path, &all, text);
}

static err_t write_users(const struct work *w)
{
    char path[FILE_PATH_CAP];
    const err_t e = own_path(w, "users", path);
    return e || file_exists(path) ? e : textfile_write(path, &broker, TEXTFILE_MARK " rig add\n");
}

static err_t check_site(const char *dir, const struct broker_site *s)
{
    char url[JOINLINE_HOST_CAP + 32];
    struct mqtt_url parts;
    snprintf(url, sizeof url, "mqtts://%s:%d", s->host, s->port);
    if (mqtt_parse_url(url, &parts) != OK || parts.port != s->port)
        return err_fail(ERR_ARG,
                        "\"%s\" is neither a name of a host nor an address, like "
                        "192.168.1.5 or [fd00::5]",
                        s->host);
    if (!manifest_is_member(s->rig) || !manifest_is_member(s->conductor))
        return err_fail(ERR_ARG,
                        "\"%s\": names of rigs and boards have small letters, digits and "
                        "-, at most %d",
                        manifest_is_member(s->rig) ? s->conductor : s->rig, TAKE_MEMBER_CAP - 1);
    if (dir[0] != '/' || strpbrk(dir, "\n\r"))
        return err_fail(ERR_ARG, "%.200s: the folder's path must begin with /", dir);
    if (!file_is_dir(dir))
        return err_fail(ERR_ARG, "there is no folder %.200s: is mosquitto installed?", dir);
    return OK;
}

static err_t check_places(const char *dir)
{
    static const char *const files[] = {"ca.key",     "ca.pem", "server.key", "server.pem",
                                        "hdrig.conf", "acl",    "users"};
    struct work w = {.dir = dir};
    char path[FILE_PATH_CAP];
    err_t e = file_join(dir, "hdrig", w.own);
    for (size_t i = 0; !e && i < sizeof files / sizeof files[0]; i++) {
        e = own_path(&w, files[i], path);
        if (!e)
            e = textfile_check(path);
    }
    if (e)
        return e;
    if (mkdir(w.own, 0755) != 0 && errno != EEXIST)
        return err_fail(file_code(errno), "%s: %s", w.own, strerror(errno));
    e = file_join(dir, "conf.d", path);
    if (!e && mkdir(path, 0755) != 0 && errno != EEXIST)
        e = err_fail(file_code(errno), "%s: %s", path, strerror(errno));
    return e;
}

err_t broker_make(const char *dir, const struct broker_site *site)
{
    struct work w;
    err_t e = check_site(dir, site);
    if (!e)
        e = check_places(dir);
    if (!e)
        e = work_open(dir, &w);
    if (e)
        return e;
    e = write_conf(&w, site->host);
    if (!e)
        e = make_authority(&w);
    if (!e)
        e = make_server(&w);
    if (!e)
        e = write_rules(&w, site);
    if (!e)
        e = write_users(&w);
    if (!e)
        e = write_settings(&w, site);
    work_close(&w);
    return e;
}

static err_t read_own(const char *dir, const char *name, char **out)
{
    struct work w = {.dir = dir};
    char path[FILE_PATH_CAP];
    *out = NULL;
    err_t e = file_join(dir, "hdrig", w.own);
    if (!e)
        e = own_path(&w, name, path);
    if (!e && !file_exists(path))
        return err_fail(ERR_LOST,
                        "%s is not there: hdrig rig broker makes it, on the machine of "
                        "the broker",
                        path);
    return e ? e : textfile_read(path, USERS_MAX, out);
}

err_t broker_site(const char *dir, struct broker_site *out)
{
    char *text;
    *out = (struct broker_site){0};
    err_t e = read_own(dir, "hdrig.conf", &text);
    const char *line = e ? NULL : strstr(text, "\n# host=");
    if (!e && (!line || sscanf(line + 1, "# host=%127s port=%d rig=%31s conductor=%31s", out->host,
                               &out->port, out->rig, out->conductor) != 4))
        e = err_fail(ERR_FORMAT,
                     "%s/conf.d/hdrig.conf: the line \"# host=\" is missing: hdrig rig "
                     "broker writes it",
                     dir);
    free(text);
    return e;
}

/* ---- users ---- */

/* The line of a user; NULL: there is none. */
static const char *find_user(const char *users, const char *board)
{
    const size_t n = strlen(board);
    for (const char *p = users; p && *p; p = strchr(p, '\n'), p = p ? p + 1 : NULL)
        if (strncmp(p, board, n) == 0 && p[n] == ':')
            return p;
    return NULL;
}

err_t broker_knows(const char *dir, const char *board, bool *out)
{
    char *text;
    const err_t e = read_own(dir, "users", &text);
    *out = !e && find_user(text, board);
    free(text);
    return e;
}

/* mosquitto_passwd turns the plain passwords of a file into hashes. */
static err_t hash_password(const struct work *w, const struct joinline *j, char **out)
{
    char path[FILE_PATH_CAP], text[TAKE_MEMBER_CAP + JOINLINE_PASSWORD_CAP + 2];
    char *const argv[] = {"mosquitto_passwd", "-U", path, NULL};
    *out = NULL;
    snprintf(text, sizeof text, "%s:%s\n", j->board, j->password);
    err_t e = tmp_write(w, "user", text);
    if (!e)
        e = file_join(w->tmp, "user", path);
    if (!e)
        e = tool_run(argv);
    if (!e)
        e = textfile_read(path, PEM_MAX, out);
    if (!e && (strstr(*out, j->password) || !strstr(*out, ":$")))
        e = err_fail(ERR_IO, "mosquitto_passwd has made no hash");
    explicit_bzero(text, sizeof text);
    return e;
}

/* hash: the new line of the board; "": it is no user any more. */
static err_t put_user(const struct work *w, const char *board, const char *hash)
{
    char path[FILE_PATH_CAP], *text = NULL, *all_users = NULL;
    err_t e = own_path(w, "users", path);
    if (!e)
        e = textfile_check(path);
    if (!e)
        e = textfile_read(path, USERS_MAX, &text);
    const char *old = e ? NULL : find_user(text, board);
    const char *rest = old ? strchr(old, '\n') : NULL;
    if (!e && !old && !*hash)
        e = err_fail(ERR_ARG, "%s: \"%.40s\" is no board of this rig", path, board);
    if (!e && asprintf(&all_users, "%.*s%s%s", (int)(old ? old - text : (long)strlen(text)), text,
                       rest ? rest + 1 : "", hash) < 0)
        e = err_fail(ERR_NOMEM, "%s: no memory", path);
    if (!e)
        e = textfile_write(path, &broker, all_users);
    free(all_users);
    free(text);
    return e;
}

/* DER, as it is in the line. */
static err_t read_authority(const struct work *w, struct joinline *j)
{
    char path[FILE_PATH_CAP];
    struct file_map m;
    err_t e = copy_in(w, "ca.pem");
    if (!e)
        e = openssl(w, "x509 -in ca.pem -outform DER -out der");
    if (!e)
        e = file_join(w->tmp, "der", path);
    if (!e)
        e = file_map(path, sizeof j->ca, &m);
    if (e)
        return e;
    memcpy(j->ca, m.p, m.n);
    j->n_ca = m.n;
    file_unmap(&m);
    return OK;
}

static err_t make_line(const char *dir, const char *board, struct joinline *j)
{
    unsigned char raw[PASSWORD_BYTES];
    struct broker_site site;
    err_t e = broker_site(dir, &site);
    if (e)
        return e;
    if (!manifest_is_member(board))
        return err_fail(ERR_ARG,
                        "\"%.40s\": a board's name has small letters, digits and -, at "
                        "most %d",
                        board, TAKE_MEMBER_CAP - 1);
    e = entropy_fill(raw, sizeof raw);
    if (e)
        return e;
    *j = (struct joinline){.port = site.port};
    snprintf(j->host, sizeof j->host, "%s", site.host);
    snprintf(j->rig, sizeof j->rig, "%s", site.rig);
    snprintf(j->board, sizeof j->board, "%s", board);
    *base64_encode_url(j->password, raw, sizeof raw) = 0;
    explicit_bzero(raw, sizeof raw);
    return OK;
}

err_t broker_add(const char *dir, const char *board, struct joinline *out)
{
    struct work w;
    char *hash = NULL;
    *out = (struct joinline){0};
    err_t e = make_line(dir, board, out);
    if (!e)
        e = work_open(dir, &w);
    if (e)
        return e;
    e = read_authority(&w, out);
    if (!e)
        e = hash_password(&w, out, &hash);
    if (!e)
        e = put_user(&w, board, hash);
    free(hash);
    work_close(&w);
    if (e)
        explicit_bzero(out, sizeof *out);
    return e;
}

err_t broker_remove(const char *dir, const char *board)
{
    struct broker_site site;
    struct work w;
    err_t e = broker_site(dir, &site);
    if (!e && strcmp(board, site.conductor) == 0)
        e = err_fail(ERR_ARG,
                     "%s leads the rig, which is nothing without it: hdrig rig broker --conductor "
                     "names another",
                     board);
    if (!e)
        e = work_open(dir, &w);
    if (e)
        return e;
    e = put_user(&w, board, "");
    work_close(&w);
    return e;
}
