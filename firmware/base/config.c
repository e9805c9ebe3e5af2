/* inih splits the lines; this file checks the values. Our own reader counts the lines and refuses
 * long lines and zero bytes, which inih would cut silently. */
#include "firmware/base/config.h"

#include "drivers/device/memory.h"

#include <errno.h>
#include <ini.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MEMORY_MAX_MB = 1048576 };

enum kind { WHOLE, WORD, TEXT };

struct key {
    const char *name;              // without the number, for numbered keys
    size_t offset;                 // in struct config: of an int, or of count char[CONFIG_TEXT]
    int min, max, multiple, value; // multiple: of which the value must be; value: the default,
                                   // which may lie outside
    const char *help;
    enum kind kind;
    const char *text; // default of a TEXT; the words of a WORD, separated by '|'; of a WHOLE those
                      // that stand for 0, -1, ..., or NULL
    int count;        // 0: not numbered
};

#define FIELD(f) offsetof(struct config, f)

static const char formats[] =
    "any|rgb8|bgr8|yuyv|nv12|mjpg|grey|grey16|rggb16|bggr16|grbg16|gbrg16|"
    "rggb10p|bggr10p|grbg10p|gbrg10p|rggb12p|bggr12p|grbg12p|gbrg12p";

static const struct key keys[] = {
    {"threads", FIELD(threads), 0, 64, 1, 0, "worker threads, 0 = one per core", WHOLE, NULL, 0},
    {"max_memory_mb", FIELD(max_memory_mb), 64, MEMORY_MAX_MB, 1, 0,
     "refuse jobs that need more, MB; 0 = 3/4 of the machine's", WHOLE, NULL, 0},
    {"size", FIELD(size), 56, 4080, 1, CONFIG_SIZE_AUTO,
     "longer edge of pictures, px; full = the photographs'", WHOLE, "auto|full", 0},
    {"seed", FIELD(seed), 0, 2147483647, 1, 0, "seed of the random numbers", WHOLE, NULL, 0},
    {"job.budget_s", FIELD(job_budget_s), 0, 86400, 1, 0,
     "seconds that a scene should take: size and steps are chosen for it; 0 = any", WHOLE, NULL, 0},
    {"job.checkpoint_s", FIELD(job_checkpoint_s), 0, 86400, 1, 30,
     "seconds between two checkpoints, which --resume goes on from; 0 = none", WHOLE, NULL, 0},
    {"refine.steps", FIELD(refine_steps), 0, 100000, 1, 1000, "steps of refinement, 0 = none",
     WHOLE, NULL, 0},
    {"refine.sh_degree_max", FIELD(refine_sh_degree_max), 0, 4, 1, 4,
     "highest degree of the spherical harmonics", WHOLE, NULL, 0},
    {"refine.gaussians_max", FIELD(refine_gaussians_max), 1000, 4000000, 1, 200000,
     "most Gaussians in a refined scene", WHOLE, NULL, 0},
    {"cameras.polish", FIELD(cameras_polish), 0, 1, 1, 1,
     "cameras by bundle adjustment, depth by stereo; 0 = as the network says", WHOLE, NULL, 0},
    {"cameras.fov_deg", FIELD(cameras_fov_deg), 0, 150, 1, 0,
     "horizontal field of view of cameras that are not known; 0 = to be found", WHOLE, NULL, 0},
    {"cameras.lens", FIELD(cameras_lens), 0, 0, 1, 0,
     "lens of cameras that are not known; auto finds the distortion that shows", WORD,
     "auto|pinhole|fisheye", 0},
    {"cameras.principal", FIELD(cameras_principal), 0, 1, 1, 0,
     "1 = find where the axis of an unknown lens meets the sensor; 0 = in the middle", WHOLE, NULL,
     0},
    {"cameras.same", FIELD(cameras_same), 0, 0, 1, 0,
     "which photographs share a lens: by EXIF, all of one size, or none", WORD, "exif|size|each",
     0},
    {"start.stereo", FIELD(start_stereo), 0, 1, 1, 1,
     "refinement starts from 1 = stereo, 0 = the network's Gaussians", WHOLE, NULL, 0},
    {"net.float_parts", FIELD(net_float_parts), 0, 15, 1, 0,
     "int8 parts in floats, summed: 1 blocks, 2 attention, 4 heads, 8 special tokens", WHOLE, NULL,
     0},

    {"rig.file", FIELD(rig_file), 0, 0, 1, 0,
     "calibration of a rig of several cameras, of hdrig rig calibrate", TEXT, "", 0},
    {"rig.moved", FIELD(rig_moved), 0, 0, 1, 0,
     "a camera that has moved since: its new place is found, used as it was, or refused", WORD,
     "solve|warn|refuse", 0},
    {"rig.role", FIELD(rig_role), 0, 0, 1, 0,
     "alone, or one of several boards: a member photographs, the conductor leads and collects",
     WORD, "alone|member|conductor", 0},
    {"rig.name", FIELD(rig_name), 0, 0, 1, 0, "name of the rig: one broker may serve several", TEXT,
     "rig", 0},
    {"rig.board", FIELD(rig_board), 0, 0, 1, 0, "name of this board; empty = the host's", TEXT, "",
     0},
    {"rig.broker", FIELD(rig_broker), 0, 0, 1, 0,
     "MQTT broker of the rig: mqtts://HOST[:PORT], or mqtt:// without encryption", TEXT, "", 0},
    {"rig.ca", FIELD(rig_ca), 0, 0, 1, 0, "certificate that signs the broker's", TEXT,
     "/etc/hdrig/rig-ca.pem", 0},
    {"rig.password_file", FIELD(rig_password_file), 0, 0, 1, 0,
     "file with this board's password at the broker, where rig.board is its user", TEXT,
     "/etc/hdrig/rig-password", 0},
    {"rig.member.", FIELD(rig_member), 0, 0, 1, 0,
     "boards of the rig, in the order of their cameras; none = all", TEXT, "", CONFIG_MEMBERS},
    {"rig.meter", FIELD(rig_meter), 0, 0, 1, 0,
     "boards that meter for all, separated by blanks; none = each of them", TEXT, "", 0},
    {"rig.partial", FIELD(rig_partial), 0, 1, 1, 0,
     "1 = a capture that lacks a board is used; 0 = it is not", WHOLE, NULL, 0},
    {"camera.", FIELD(camera), 0, 0, 1, 0,
     "cameras of the rig: v4l2:PATH, libcamera:ID, replay:DIR, sim:seed=N", TEXT, "",
     CONFIG_CAMERAS},
    {"camera.width", FIELD(camera_w), 0, 16384, 1, 0, "width of pictures, px; 0 = the camera's own",
     WHOLE, NULL, 0},
    {"camera.height", FIELD(camera_h), 0, 16384, 1, 0,
     "height of pictures, px; 0 = the camera's own", WHOLE, NULL, 0},
    {"camera.format", FIELD(camera_format), 0, 0, 1, 0, "format of the pixels", WORD, formats, 0},
    {"trigger.", FIELD(trigger), 0, 0, 1, 0,
     "triggers: gpio:CHIP/LINE, gpiod:CHIP/LINE, evdev:PATH, timer:SECONDS", TEXT, "",
     CONFIG_TRIGGERS},
    {"trigger.lockout_ms", FIELD(trigger_lockout_ms), 0, 60000, 1, 200,
     "presses within this time after another are only counted, ms", WHOLE, NULL, 0},
    {"trigger.busy", FIELD(trigger_busy), 0, 0, 1, 0, "effect of a press while a capture runs",
     WORD, "reject|queue|coalesce", 0},
    {"trigger.queue", FIELD(trigger_queue), 1, 16, 1, 4, "presses that the queue holds", WHOLE,
     NULL, 0},
    {"session.collect", FIELD(session_collect), 0, 0, 1, 0,
     "1 = captures are places of one scene, 0 = each is one; auto = 1 with one camera, no timer",
     WORD, "auto|0|1", 0},
    {"session.hold_ms", FIELD(session_hold_ms), 500, 60000, 1, 2000,
     "a button held for this long ends the session, ms", WHOLE, NULL, 0},
    {"lamp", FIELD(lamp), 0, 0, 1, 0, "lamp that shows the state: gpio:CHIP/LINE", TEXT, "", 0},
    {"bracket.mode", FIELD(bracket_mode), 0, 0, 1, 0,
     "the fewest exposures that cover the scene, or those of bracket.ev", WORD, "auto|list", 0},
    {"bracket.ev", FIELD(bracket_ev), 0, 0, 1, 0, "exposures in stops around the middle one", TEXT,
     "-4 0 4", 0},
    {"bracket.middle_us", FIELD(bracket_middle_us), 0, 60000000, 1, 0,
     "exposure of 0 stops, us; 0 = metered", WHOLE, NULL, 0},
    {"bracket.stagger", FIELD(bracket_stagger), 0, 1, 1, 0, "1 = one exposure per camera, in turn",
     WHOLE, NULL, 0},
    {"bracket.snr_db", FIELD(bracket_snr_db), 6, 40, 1, 20,
     "least signal-to-noise ratio of covered radiance, dB", WHOLE, NULL, 0},
    {"bracket.skew_ms", FIELD(bracket_skew_ms), 0, 10000, 1, 0,
     "longest time between the cameras' exposures, ms; 0 = any", WHOLE, NULL, 0},
    {"bracket.moved", FIELD(bracket_moved), 0, 100, 1, 5,
     "percent of a picture that may move before it should be retaken; 0 = any", WHOLE, NULL, 0},
    {"store.path", FIELD(store_path), 0, 0, 1, 0, "folder of the captures", TEXT,
     "/var/lib/hdrig/captures", 0},
    {"store.reserve_mb", FIELD(store_reserve_mb), 0, 1048576, 1, 500, "space that stays free, MB",
     WHOLE, NULL, 0},
    {"store.keep", FIELD(store_keep), 0, 1000000, 1, 0,
     "captures that are kept, older ones are removed; 0 = all", WHOLE, NULL, 0},
    {"store.merge", FIELD(store_merge), 0, 1, 1, 1, "1 = merge full brackets to OpenEXR", WHOLE,
     NULL, 0},
    {"calibration.path", FIELD(calibration_path), 0, 0, 1, 0, "folder of hdrig calibrate", TEXT,
     "/var/lib/hdrig/calibration", 0},
    {"results.path", FIELD(results_path), 0, 0, 1, 0, "folder of the scenes", TEXT,
     "/var/lib/hdrig/results", 0},
    {"job.run", FIELD(job_run), 0, 1, 1, 1,
     "1 = reconstruct every capture, or every session that has ended", WHOLE, NULL, 0},
    {"job.launcher", FIELD(job_launcher), 0, 0, 1, 0,
     "what starts jobs on several boards: mpirun --hostfile FILE ...", TEXT, "", 0},
    {"control.socket", FIELD(control_socket), 0, 0, 1, 0, "socket of the daemon", TEXT,
     "/run/hdrig/control", 0},
    {"http.port", FIELD(http_port), 0, 65535, 1, 8080, "port of the status page; 0 = no page",
     WHOLE, NULL, 0},
    {"http.address", FIELD(http_address), 0, 0, 1, 0, "address of the status page", TEXT,
     "127.0.0.1", 0},
    {"http.token", FIELD(http_token), 0, 0, 1, 0, "password of the status page", TEXT, "", 0},
    {"http.token_file", FIELD(http_token_file), 0, 0, 1, 0,
     "file with that password, which others need not be able to read, if http.token is empty", TEXT,
     "", 0},
};

enum { N_KEYS = sizeof keys / sizeof keys[0], QUOTE_MAX = 100, LINE_MAX_WORDS = 90 };

static int *key_field(struct config *c, const struct key *k)
{
    return (int *)(void *)((char *)c + k->offset);
}

static char *text_field(struct config *c, const struct key *k, int i)
{
    return (char *)c + k->offset + (size_t)i * CONFIG_TEXT;
}

void config_defaults(struct config *c)
{
    memset(c, 0, sizeof *c);
    for (int i = 0; i < N_KEYS; i++) {
        if (keys[i].kind != TEXT)
            *key_field(c, &keys[i]) = keys[i].value;
        else if (!keys[i].count)
            strcpy(text_field(c, &keys[i], 0), keys[i].text);
    }
}

/* Key of that name; for a numbered key also the position in its array. */
static const struct key *find_key(const char *name, int *index)
{
    *index = 0;
    for (int i = 0; i < N_KEYS; i++) {
        const struct key *k = &keys[i];
        size_t n = strlen(k->name);
        if (!k->count && strcmp(k->name, name) == 0)
            return k;
        if (!k->count || strncmp(name, k->name, n) != 0 || name[n] < '1' || name[n] > '9')
            continue;
        char *end;
        long number = strtol(name + n, &end, 10);
        if (*end || number > k->count)
            continue;
        *index = (int)number - 1;
        return k;
    }
    return NULL;
}

/* Position of a word in a list like "auto|full"; -1: it is none of them. */
static int find_word(const char *words, const char *value)
{
    const size_t len = strlen(value);
    int index = 0;
    for (const char *w = words; w; index++) {
        const size_t n = strcspn(w, "|");
        if (n == len && memcmp(w, value, n) == 0)
            return index;
        w = w[n] ? w + n + 1 : NULL;
    }
    return -1;
}

static err_t set_whole(struct config *c, const char *where, const struct key *k, const char *value)
{
    const int word = k->text ? find_word(k->text, value) : -1;
    char *end;
    if (word >= 0) {
        *key_field(c, k) = -word;
        return OK;
    }
    errno = 0;
    long long n = strtoll(value, &end, 10);
    if (end == value || *end)
        return err_fail(ERR_ARG, "%s: %s: \"%.*s\" is not a whole number", where, k->name,
                        QUOTE_MAX, value);
    if (n != k->value && (errno || n < k->min || n > k->max))
        return err_fail(ERR_ARG, "%s: %s: %.*s is not in %d..%d", where, k->name, QUOTE_MAX, value,
                        k->min, k->max);
    if (n % k->multiple)
        return err_fail(ERR_ARG, "%s: %s: %lld is not a multiple of %d", where, k->name, n,
                        k->multiple);
    *key_field(c, k) = (int)n;
    return OK;
}

static err_t set_word(struct config *c, const char *where, const struct key *k, const char *value)
{
    const int index = find_word(k->text, value);
    if (index >= 0) {
        *key_field(c, k) = index;
        return OK;
    }
    return err_fail(ERR_ARG, "%s: %s: \"%.*s\" is none of %s", where, k->name, QUOTE_MAX, value,
                    k->text);
}

static err_t set_text(char *field_of, const char *where, const char *key, const char *value)
{
    size_t len = strlen(value);
    if (len >= CONFIG_TEXT)
        return err_fail(ERR_ARG, "%s: %s: %zu bytes, at most %d", where, key, len, CONFIG_TEXT - 1);
    for (size_t i = 0; i < len; i++)
        if ((unsigned char)value[i] < ' ' || value[i] == 127)
            return err_fail(ERR_ARG, "%s: %s: control character %d", where, key, value[i]);
    memset(field_of, 0, CONFIG_TEXT);
    memcpy(field_of, value, len);
    return OK;
}

err_t config_set(struct config *c, const char *where, const char *key, const char *value)
{
    int index;
    const struct key *k = find_key(key, &index);
    if (!k)
        return err_fail(ERR_ARG, "%s: unknown key \"%.*s\"", where, QUOTE_MAX, key);
    if (k->kind == TEXT)
        return set_text(text_field(c, k, index), where, key, value);
    return k->kind == WORD ? set_word(c, where, k, value) : set_whole(c, where, k, value);
}

err_t config_assign(struct config *c, const char *text)
{
    char key[64];
    const char *equal = strchr(text, '=');
    size_t len = equal ? (size_t)(equal - text) : 0;
    while (len > 0 && text[len - 1] == ' ')
        len--;
    if (len == 0 || len >= sizeof key)
        return err_fail(ERR_ARG, "--set: \"%.*s\" is not key=value", QUOTE_MAX, text);
    memcpy(key, text, len);
    key[len] = 0;
    return config_set(c, "--set", key, equal + 1);
}

int config_memory_mb(const struct config *c)
{
    const uint64_t share = memory_total("") / 4 * 3 / 1000000;
    if (c->max_memory_mb)
        return c->max_memory_mb;
    return share < MEMORY_MAX_MB ? (int)share : MEMORY_MAX_MB;
}

struct source {
    struct config *c;
    const char *name, *text;
    size_t size, at;
    int line;     // number of the line read last, from 1
    int bad_line; // first refused one, 0 = none
    err_t code;   // why
};

static void refuse_line(struct source *s, err_t code)
{
    s->code = code;
    s->bad_line = s->line;
}

/* The ini_reader: one line like fgets, NULL at the end and after an error. */
static char *next_line(char *out, int cap, void *ctx)
{
    struct source *s = ctx;
    if (s->at == s->size || s->bad_line)
        return NULL;
    s->line++;
    const char *start = s->text + s->at;
    const char *newline = memchr(start, '\n', s->size - s->at);
    size_t len = newline ? (size_t)(newline - start) + 1 : s->size - s->at;
    if (len >= (size_t)cap) {
        refuse_line(s, err_fail(ERR_FORMAT, "%s:%d: line of %zu bytes, at most %d", s->name,
                                s->line, len, cap - 1));
        return NULL;
    }
    if (memchr(start, 0, len)) {
        refuse_line(s, err_fail(ERR_FORMAT, "%s:%d: zero byte", s->name, s->line));
        return NULL;
    }
    memcpy(out, start, len);
    out[len] = 0;
    s->at += len;
    return out;
}

static int handle_pair(void *ctx, const char *section, const char *key, const char *value)
{
    struct source *s = ctx;
    char where[256];
    snprintf(where, sizeof where, "%s:%d", s->name, s->line);
    err_t e = *section ? err_fail(ERR_FORMAT, "%s: key inside [%.*s], sections are not used", where,
                                  QUOTE_MAX, section)
                       : config_set(s->c, where, key, value);
    if (e)
        refuse_line(s, ERR_FORMAT);
    return e == OK;
}

err_t config_parse(struct config *c, const char *name, const char *text, size_t size)
{
    struct config new = *c;
    struct source s = {.c = &new, .name = name, .text = text, .size = size};
    if (size > CONFIG_FILE_MAX)
        return err_fail(ERR_FORMAT, "%s: more than %d bytes", name, CONFIG_FILE_MAX);
    int line = ini_parse_stream(next_line, &s, handle_pair, &s);
    if (line > 0 && (!s.bad_line || line < s.bad_line))
        return err_fail(ERR_FORMAT, "%s:%d: not \"key = value\"", name, line);
    if (s.bad_line)
        return s.code;
    *c = new;
    return OK;
}

err_t config_read(struct config *c, const char *path)
{
    char text[CONFIG_FILE_MAX + 1]; // one more byte shows that the file is too long
    FILE *f = fopen(path, "rb");
    if (!f)
        return err_fail(ERR_IO, "%s: %s", path, strerror(errno));
    size_t n = fread(text, 1, sizeof text, f);
    bool bad = ferror(f) != 0;
    fclose(f);
    if (bad)
        return err_fail(ERR_IO, "%s: cannot be read", path);
    return config_parse(c, path, text, n);
}

err_t config_load(struct config *c, const char *dir)
{
    static const char *const layers[] = {"defaults.conf", "board.conf", "hdrig.conf"};
    struct config new = *c;
    for (size_t i = 0; i < sizeof layers / sizeof layers[0]; i++) {
        char path[512];
        if (snprintf(path, sizeof path, "%s/%s", dir, layers[i]) >= (int)sizeof path)
            return err_fail(ERR_ARG, "%.*s...: path longer than %zu bytes", QUOTE_MAX, dir,
                            sizeof path - 1);
        if (access(path, F_OK) != 0 && errno == ENOENT)
            continue;
        err_t e = config_read(&new, path);
        if (e)
            return e;
    }
    *c = new;
    return OK;
}

err_t config_stops(const char *where, const char *text, double *ev, int cap, int *n)
{
    const char *blank = " ,";
    *n = 0;
    for (text += strspn(text, blank); *text; text += strspn(text, blank)) {
        char *end;
        double v = strtod(text, &end);
        size_t len = strcspn(text, blank);
        if (end != text + len || !(fabs(v) <= CONFIG_STOPS_MAX))
            return err_fail(ERR_ARG, "%s: \"%.*s\" is not a number in -%d..%d", where,
                            (int)(len < QUOTE_MAX ? len : QUOTE_MAX), text, CONFIG_STOPS_MAX,
                            CONFIG_STOPS_MAX);
        if (*n == cap)
            return err_fail(ERR_ARG, "%s: more than %d exposures", where, cap);
        ev[(*n)++] = v;
        text += len;
    }
    return OK;
}

bool config_collects(const struct config *c)
{
    bool one = c->camera[0][0] && !c->camera[1][0] && c->rig_role == CONFIG_ALONE;
    for (int i = 0; i < CONFIG_TRIGGERS; i++)
        one = one && strncmp(c->trigger[i], "timer:", 6) != 0; // no user carries the camera around
    return c->session_collect == CONFIG_COLLECT_YES ||
           (c->session_collect == CONFIG_COLLECT_AUTO && one);
}

bool config_is_loopback(const char *address)
{
    return strncmp(address, "127.", 4) == 0 || strcmp(address, "::1") == 0;
}

err_t config_check_rig(const struct config *c)
{
    double ev[9];
    int n;
    for (int i = 1; i < CONFIG_CAMERAS; i++)
        if (c->camera[i][0] && !c->camera[i - 1][0])
            return err_fail(ERR_ARG, "camera.%d is set, but camera.%d is not", i + 1, i);
    for (int i = 0; i < CONFIG_CAMERAS; i++)
        for (int j = 0; j < i; j++)
            if (c->camera[i][0] && strcmp(c->camera[i], c->camera[j]) == 0)
                return err_fail(ERR_ARG, "camera.%d and camera.%d are both %s", j + 1, i + 1,
                                c->camera[i]);
    err_t e = config_stops("bracket.ev", c->bracket_ev, ev, sizeof ev / sizeof ev[0], &n);
    if (e)
        return e;
    if (c->bracket_mode == CONFIG_LIST && n == 0)
        return err_fail(ERR_ARG, "bracket.mode is list, but bracket.ev has no exposures");
    if (c->bracket_mode == CONFIG_AUTO && c->bracket_middle_us)
        return err_fail(ERR_ARG, "bracket.mode is auto, which has no use for bracket.middle_us");
    if (c->session_collect == CONFIG_COLLECT_YES && c->rig_role != CONFIG_ALONE)
        return err_fail(ERR_ARG, "session.collect is for one board alone, but rig.role is set");
    if (c->http_port && !config_is_loopback(c->http_address) && !c->http_token[0] &&
        !c->http_token_file[0])
        return err_fail(ERR_ARG,
                        "http.address %s is open to others: http.token must be set, or the address "
                        "be 127.0.0.1",
                        c->http_address);
    return OK;
}

static void print_word(const struct key *k, int value, FILE *out)
{
    const char *chosen = "";
    int column = 1, len = 0;
    fprintf(out, "# %s:\n#", k->help);
    for (const char *w = k->text; *w; w += strcspn(w, "|"), w += *w == '|', value--) {
        int n = (int)strcspn(w, "|");
        if (column + n > LINE_MAX_WORDS)
            column = fprintf(out, "\n#") - 1;
        column += fprintf(out, " %.*s", n, w);
        if (value == 0) {
            chosen = w;
            len = n;
        }
    }
    fprintf(out, "\n%s = %.*s\n", k->name, len, chosen);
}

/* A number, or the word that stands for it. */
static const char *whole_text(const struct key *k, int value, char text[CONFIG_TEXT])
{
    const char *w = k->text;
    for (int i = value; w && i < 0 && *w; i++)
        w += strcspn(w, "|") + 1;
    if (w && value <= 0)
        snprintf(text, CONFIG_TEXT, "%.*s", (int)strcspn(w, "|"), w);
    else
        snprintf(text, CONFIG_TEXT, "%d", value);
    return text;
}

static void print_whole(const struct key *k, int value, FILE *out)
{
    char text[CONFIG_TEXT];
    fprintf(out, "# %s (%s%s%d..%d, default %s)\n", k->help, k->text ? k->text : "",
            k->text ? "|" : "", k->min, k->max, whole_text(k, k->value, text));
    fprintf(out, "%s = %s\n", k->name, whole_text(k, value, text));
}

static void print_key(const struct config *c, const struct key *k, FILE *out)
{
    struct config copy = *c;
    if (k->kind == WHOLE)
        print_whole(k, *key_field(&copy, k), out);
    if (k->kind == WORD)
        print_word(k, *key_field(&copy, k), out);
    const char *text = text_field(&copy, k, 0);
    if (k->kind == TEXT && !k->count)
        fprintf(out, "# %s\n%s =%s%s\n", k->help, k->name, *text ? " " : "", text);
    if (!k->count)
        return;
    fprintf(out, "# %s; %s1 .. %s%d\n", k->help, k->name, k->name, k->count);
    for (int i = 0; i < k->count; i++)
        if (i == 0 || *text_field(&copy, k, i))
            fprintf(out, "%s%d =%s%s\n", k->name, i + 1, *text_field(&copy, k, i) ? " " : "",
                    text_field(&copy, k, i));
}

err_t config_print(const struct config *c, FILE *out)
{
    for (int i = 0; i < N_KEYS; i++)
        print_key(c, &keys[i], out);
    return fflush(out) || ferror(out)
               ? err_fail(ERR_IO, "config: cannot be written: %s", strerror(errno))
               : OK;
}
