/* hdrig rig status, hosts, capture, accept, forget: what the daemon knows of the rig, and does with
 * it. */
#include "firmware/cmd/cmd_rig.h"
#include "firmware/daemon/ctl.h"

#include "drivers/format/json.h"

#include <string.h>

enum { WAIT_S = 10 };

static const char *text_of(const struct cJSON *object, const char *key)
{
    const char *s = json_string(json_member(object, key));
    return s ? s : "";
}

static bool truth_of(const struct cJSON *object, const char *key)
{
    bool v = false;
    return json_truth(json_member(object, key), &v) && v;
}

static double number_of(const struct cJSON *object, const char *key)
{
    double v = 0;
    return json_number(json_member(object, key), &v) ? v : 0;
}

static const struct cJSON *first_of(const struct cJSON *object, const char *key)
{
    const struct cJSON *list = json_member(object, key);
    return list ? json_first(list) : NULL;
}

static int count_of(const struct cJSON *object, const char *key)
{
    const struct cJSON *list = json_member(object, key);
    return list ? json_count(list) : 0;
}

/* ---- status ---- */

static int widest_name(const struct cJSON *rig)
{
    int wide = 5;
    for (const struct cJSON *m = first_of(rig, "members"); m; m = json_next(m)) {
        const int n = (int)strlen(text_of(m, "name"));
        wide = n > wide ? n : wide;
    }
    return wide;
}

static void print_member(const struct cJSON *m, int wide)
{
    char clock[24] = "-", room[24] = "-";
    const bool online = truth_of(m, "online");
    const double since = number_of(m, "since_s");
    if (online && *text_of(m, "clock"))
        snprintf(clock, sizeof clock, "%.3f ms", number_of(m, "within_ms"));
    if (online)
        snprintf(room, sizeof room, "%.1f GB", number_of(m, "free_mb") / 1000);
    printf("%-*s  %7.0f  %10s  %10s  %5.0f  %s", wide, text_of(m, "name"), number_of(m, "cameras"),
           clock, room, number_of(m, "holds"), text_of(m, "sentence"));
    if (!online && since > 0)
        printf(" since %.0f s", since);
    puts("");
}

/* A take that waits, for whom, and what its owner can do. */
static void print_take(const struct cJSON *t)
{
    const char *id = text_of(t, "id"), *reason = text_of(t, "reason");
    printf("take %s: %s", *id ? id : "(new)", text_of(t, "phase"));
    if (*reason)
        printf(": %s", reason);
    for (const struct cJSON *p = first_of(t, "parts"); p; p = json_next(p)) {
        const char *state = text_of(p, "state"), *why = text_of(p, "why");
        if (strcmp(state, "fetched") != 0)
            printf("; %s: %s%s%s", text_of(p, "name"), state, *why ? ", " : "", why);
    }
    puts("");
    if (*text_of(t, "choice"))
        printf("  %s\n", text_of(t, "choice"));
}

static void print_rig(const struct cJSON *rig)
{
    const int wide = widest_name(rig);
    printf("%s, %s of rig %s, %s: %s\n", text_of(rig, "board"), text_of(rig, "role"),
           text_of(rig, "name"), text_of(rig, "state"), text_of(rig, "sentence"));
    if (first_of(rig, "members"))
        printf("%-*s  %7s  %10s  %10s  %5s  %s\n", wide, "board", "cameras", "clock", "free",
               "parts", "state");
    for (const struct cJSON *m = first_of(rig, "members"); m; m = json_next(m))
        print_member(m, wide);
    for (const struct cJSON *t = first_of(rig, "takes"); t; t = json_next(t))
        print_take(t);
}

static err_t ask_rig(const struct config *cfg, struct cJSON **doc, const struct cJSON **rig)
{
    static char answer[CTL_ANSWER_MAX];
    err_t e = ctl_ask(cfg->control_socket, "status", WAIT_S, answer);
    if (!e)
        e = json_parse("answer of the daemon", answer, strlen(answer), doc);
    if (e)
        return e;
    *rig = json_member(*doc, "rig");
    return json_is_object(*rig) ? OK
                                : err_fail(ERR_UNSUPPORTED, "this board is alone: rig.role is "
                                                            "neither member nor conductor");
}

int cmd_rig_status(int argc, char **argv)
{
    struct config cfg;
    struct cJSON *doc = NULL;
    const struct cJSON *rig;
    bool json = false;
    int code;
    const struct cmd_option options[] = {
        {"json", NULL, "as the daemon says it", NULL, NULL, &json},
    };
    const struct cmd_usage usage = {
        "rig status", "",
        "The boards of the rig, by the daemon of this one; the conductor knows all. Exit code 0:\n"
        "a press would be answered; 3: it would not, the first line says why.",
        options, 1};
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    err_t e = ask_rig(&cfg, &doc, &rig);
    if (!e && json) {
        json_put(stdout, rig);
        puts("");
    } else if (!e)
        print_rig(rig);
    const bool ready = !e && truth_of(rig, "ready");
    json_free(doc);
    code = cmd_finish(usage.name, e);
    return code || ready ? code : CMD_REFUSED;
}

/* ---- hosts ---- */

int cmd_rig_status_hosts(int argc, char **argv)
{
    struct config cfg;
    struct cJSON *doc = NULL;
    const struct cJSON *rig;
    int code;
    const struct cmd_usage usage = {
        "rig hosts", "",
        "At the conductor: this machine and the boards that are there, one in each line, as\n"
        "mpirun takes them with --hostfile.",
        NULL, 0};
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    err_t e = ask_rig(&cfg, &doc, &rig);
    if (!e)
        puts("localhost");
    for (const struct cJSON *m = e ? NULL : first_of(rig, "members"); m; m = json_next(m))
        if (truth_of(m, "online") && *text_of(m, "address"))
            puts(text_of(m, "address"));
    json_free(doc);
    return cmd_finish(usage.name, e);
}

/* ---- capture ---- */

static void print_joint(const struct cJSON *manifest)
{
    const struct cJSON *rig = json_member(manifest, "rig");
    const int boards = count_of(rig, "members");
    printf("%d cameras of %d board%s began within %.2f ms of each other\n",
           count_of(manifest, "cameras"), boards, boards == 1 ? "" : "s",
           number_of(manifest, "skew_s") * 1e3);
    const char *reason = text_of(manifest, "reason");
    if (*reason)
        printf("but %s\n", reason);
}

static err_t capture_all(const struct config *cfg)
{
    static char answer[CTL_ANSWER_MAX];
    char path[2 * CONFIG_TEXT];
    struct cJSON *doc = NULL, *manifest = NULL;
    const struct cJSON *rig;
    err_t e = ask_rig(cfg, &doc, &rig);
    json_free(doc);
    doc = NULL;
    if (!e)
        e = ctl_ask(cfg->control_socket, "capture wait", 0, answer);
    if (!e)
        e = json_parse("answer of the daemon", answer, strlen(answer), &doc);
    if (!e && !truth_of(doc, "ok"))
        e = err_fail(ERR_IO, "%s", text_of(doc, "error"));
    if (!e) {
        printf("%s/%s\n", cfg->store_path, text_of(doc, "id"));
        fflush(stdout);
        snprintf(path, sizeof path, "%s/%.100s/manifest.json", cfg->store_path, text_of(doc, "id"));
        e = json_read(path, &manifest);
    }
    if (!e)
        print_joint(manifest);
    json_free(manifest);
    json_free(doc);
    return e;
}

int cmd_rig_status_capture(int argc, char **argv)
{
    struct config cfg;
    int code;
    const struct cmd_usage usage = {
        "rig capture", "",
        "One capture by all boards, at the conductor: waits until it is in one place, and prints\n"
        "its folder, its cameras and how far apart they began. As hdrig capture, which prints the\n"
        "folder alone.",
        NULL, 0};
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    return cmd_finish(usage.name, capture_all(&cfg));
}

/* ---- accept, forget ---- */

/* A command of the daemon about the capture or the board that is the first argument. */
static int ask_about(const struct cmd_usage *usage, const char *command, int argc, char **argv)
{
    static const char letters[] =
        "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_";
    struct config cfg;
    char line[CTL_LINE_MAX];
    int code;
    const char *what = cmd_rig_word(&argc, &argv);
    if (!cmd_parse(usage, argc, argv, &cfg, &code))
        return code;
    if (!*what)
        return cmd_misuse(usage, "a capture or a board is needed");
    if (strspn(what, letters) != strlen(what) || strlen(what) >= 100)
        return cmd_misuse(usage, "that is neither the name of a capture nor that of a board");
    snprintf(line, sizeof line, "%s %s", command, what);
    return cmd_ask(usage->name, &cfg, line);
}

int cmd_rig_status_accept(int argc, char **argv)
{
    const struct cmd_usage usage = {
        "rig accept", "ID ",
        "At the conductor: joins the parts that there are of the capture ID, which waits for a\n"
        "part that was lost or for a board that is gone. The take says what it lacks.",
        NULL, 0};
    return ask_about(&usage, "accept", argc, argv);
}

int cmd_rig_status_forget(int argc, char **argv)
{
    const struct cmd_usage usage = {
        "rig forget", "ID|BOARD ",
        "At the conductor: gives up the capture ID, which waits for parts, and has them removed;\n"
        "or forgets a board that was taken away.",
        NULL, 0};
    return ask_about(&usage, "forget", argc, argv);
}
