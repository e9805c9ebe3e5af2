/* hdrig status: state of the daemon. */
#include "firmware/cmd/cmd.h"
#include "firmware/daemon/ctl.h"

#include "drivers/format/json.h"

#include <string.h>

/* Printed for a rig that collects places, and while a session is open. */
static void print_session(const struct cJSON *session)
{
    double places = 0;
    bool collects = false;
    const char *line = json_string(json_member(session, "line"));
    if (json_truth(json_member(session, "collect"), &collects) && line &&
        json_number(json_member(session, "places"), &places) && (collects || places > 0))
        printf("session  %s\n", line);
}

static void print_status(const struct cJSON *doc)
{
    const char *state = json_string(json_member(doc, "state"));
    const char *sentence = json_string(json_member(doc, "sentence"));
    const struct cJSON *cameras = json_member(doc, "cameras"), *job = json_member(doc, "job");
    const struct cJSON *takes = json_member(doc, "captures");
    bool running = false;
    printf("%s: %s\n", state ? state : "?", sentence ? sentence : "");
    for (const struct cJSON *c = json_first(cameras); c; c = json_next(c)) {
        bool there = false;
        const char *uri = json_string(json_member(c, "uri"));
        printf("camera   %s%s\n", uri ? uri : "?",
               json_truth(json_member(c, "present"), &there) && there ? "" : ", not there");
    }
    if (json_truth(json_member(job, "running"), &running) && running) {
        const char *id = json_string(json_member(job, "id"));
        const char *line = json_string(json_member(job, "line"));
        printf("job      %s: %s\n", id ? id : "?", line ? line : "");
    }
    print_session(json_member(doc, "session"));
    for (const struct cJSON *t = json_first(takes); t; t = json_next(t)) {
        double frames = 0, warnings = 0;
        const char *id = json_string(json_member(t, "id"));
        const char *reason = json_string(json_member(t, "reason"));
        if (!json_number(json_member(t, "frames"), &frames))
            continue;
        printf("capture  %s: %.0f frames%s%s", id ? id : "?", frames, reason && *reason ? ", " : "",
               reason ? reason : "");
        const char *session = json_string(json_member(t, "session"));
        if (session)
            printf(", a place of session %s", session);
        if (json_number(json_member(t, "warnings"), &warnings))
            printf(warnings > 0 ? ", scene with %.0f warning%s" : ", scene", warnings,
                   warnings == 1 ? "" : "s");
        putchar('\n');
    }
}

int cmd_status_run(int argc, char **argv)
{
    static char answer[CTL_ANSWER_MAX];
    struct config cfg;
    struct cJSON *doc = NULL;
    bool json = false;
    int code;
    const struct cmd_option options[] = {
        {"json", NULL, "everything, as the daemon says it", NULL, NULL, &json},
    };
    const struct cmd_usage usage = {"status", "", "What the daemon does.", options, 1};
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    err_t e = ctl_ask(cfg.control_socket, "status", 10, answer);
    if (!e)
        e = json_parse("answer of the daemon", answer, strlen(answer), &doc);
    if (!e && json)
        puts(answer);
    else if (!e)
        print_status(doc);
    json_free(doc);
    return cmd_finish("status", e);
}
