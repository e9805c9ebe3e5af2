/* hdrig selftest: checks that a camera does what captures need. */
#include "firmware/base/progress.h"
#include "firmware/capture/take.h"
#include "firmware/cmd/cmd.h"
#include "firmware/cmd/selftest.h"
#include "firmware/result/report.h"

#include "drivers/format/file.h"

#define LONGEST_S 2.0 // usual end of the range that is tried

struct request {
    struct config cfg;
    const char *camera, *longest;
    double longest_s;
};

static const char *const results[] = {"skipped", "pass", "fail"};

static void print_findings(const struct selftest *t, FILE *f)
{
    for (int i = 0; i < SELFTEST_CHECKS; i++)
        fprintf(f, "%-8s %-11s %s\n", results[t->check[i].result],
                selftest_name((enum selftest_check)i), t->check[i].text);
    fprintf(f, "%s\n",
            selftest_passed(t) ? "this camera does what captures need"
                               : "captures with this camera cannot be trusted");
}

static void write_report(const struct request *q, const struct selftest *t, FILE *f)
{
    struct report r;
    report_begin(&r, f);
    report_text(&r, "camera", q->camera);
    report_text(&r, "unit", t->info.unit);
    report_text(&r, "format", take_format(t->info.format));
    report_int(&r, "w", t->info.w);
    report_int(&r, "h", t->info.h);
    report_bool(&r, "calibrated", t->calibrated);
    report_bool(&r, "pass", selftest_passed(t));
    report_open(&r, "checks", '{');
    for (int i = 0; i < SELFTEST_CHECKS; i++) {
        const struct selftest_finding *c = &t->check[i];
        report_open(&r, selftest_name((enum selftest_check)i), '{');
        report_text(&r, "result", results[c->result]);
        report_text(&r, "text", c->text);
        for (int k = 0; k < c->n; k++)
            report_number(&r, c->figure[k].name, c->figure[k].value);
        report_close(&r);
    }
    report_close(&r);
    report_close(&r);
}

static err_t run_selftest(const struct request *q, const char *json, bool *passed)
{
    static struct selftest t;
    struct progress p;
    struct cmd_json out;
    struct camera_cfg camera = {q->camera, q->cfg.camera_w, q->cfg.camera_h,
                                (enum camera_format)q->cfg.camera_format, 0};
    struct selftest_order o = {camera, q->cfg.calibration_path, q->longest_s, &p};
    err_t e = cmd_json_open(json, &out);
    if (e)
        return e;
    progress_init(&p, stderr);
    e = selftest_run(&o, &t);
    progress_end(&p);
    if (e) {
        cmd_json_discard(&out);
        return e;
    }
    print_findings(&t, out.f == stdout ? stderr : stdout);
    if (out.f)
        write_report(q, &t, out.f);
    *passed = selftest_passed(&t);
    return cmd_json_close(&out);
}

int cmd_selftest_run(int argc, char **argv)
{
    struct request q = {.longest_s = LONGEST_S};
    const char *json = NULL;
    bool passed = false;
    int code;
    const struct cmd_option options[] = {
        {"camera", "URI", "which one", NULL, &q.camera, NULL},
        {"json", "FILE", "report, - for stdout", NULL, &json, NULL},
        {"longest", "S", "end of the range that is tried, s (2)", NULL, &q.longest, NULL},
    };
    const struct cmd_usage usage = {
        "selftest", "--camera URI",
        "Checks that a camera, in front of a scene that does not change, does what captures\n"
        "need: exit code 0, else 1.",
        options, sizeof options / sizeof options[0]};
    if (!cmd_parse(&usage, argc, argv, &q.cfg, &code))
        return code;
    if (!q.camera)
        return cmd_misuse(&usage, "--camera is needed");
    if (q.longest && cmd_number("--longest", q.longest, 1e-4, 1000, &q.longest_s) != OK)
        return cmd_misuse(&usage, err_text());
    code = cmd_finish("selftest", run_selftest(&q, json, &passed));
    return code == CMD_OK && !passed ? CMD_FAILURE : code;
}
