#include "firmware/cmd/cmd.h"
#include "firmware/capture/session.h"
#include "firmware/daemon/ctl.h"
#include "firmware/store/raw_take.h"

#include "core/base/log.h"
#include "drivers/device/clocks.h"
#include "drivers/format/file.h"
#include "drivers/format/img.h"
#include "drivers/format/json.h"
#include "drivers/format/origin.h"
#include "drivers/format/pixels.h"

#include <assert.h>
#include <errno.h>
#include <getopt.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { OPTIONS_MAX = 64, OPT_HELP = 'h', OPT_CONFIG = 256, OPT_SET, OPT_FIRST };

static void print_option(const char *name, const char *arg, const char *help)
{
    char left[40];
    snprintf(left, sizeof left, "--%s%s%s", name, arg ? " " : "", arg ? arg : "");
    printf("  %-22s %s\n", left, help);
}

static void print_help(const struct cmd_usage *u)
{
    printf("usage: hdrig %s %s[options]\n\n%s\n\n", u->name, u->synopsis, u->what);
    bool own_config = false; // getopt takes the first of two options of a name
    for (int i = 0; i < u->n_options; i++) {
        print_option(u->options[i].name, u->options[i].arg, u->options[i].help);
        own_config = own_config || strcmp(u->options[i].name, "config") == 0;
    }
    if (!own_config)
        print_option("config", "FILE", "settings to read after those of " CONFIG_DIR);
    print_option("set", "KEY=VALUE", "one setting, see hdrig config --print");
    print_option("help", NULL, "this text");
}

int cmd_misuse(const struct cmd_usage *u, const char *reason)
{
    fprintf(stderr, "hdrig %s: %s; see hdrig %s --help\n", u->name, reason, u->name);
    return CMD_USAGE;
}

int cmd_finish(const char *name, err_t e)
{
    if (e == OK)
        return CMD_OK;
    fprintf(stderr, "hdrig %s: %s\n", name, e == ERR_CANCELLED ? "interrupted" : err_text());
    if (e == ERR_CANCELLED)
        return CMD_INTERRUPTED;
    return e == ERR_LIMIT || e == ERR_NOMEM ? CMD_REFUSED : CMD_FAILURE;
}

const char *cmd_count_warnings(const struct job_result *j, char text[CMD_COUNT_CAP])
{
    *text = 0;
    if (j->n_warnings > 0)
        snprintf(text, CMD_COUNT_CAP, ", %d warning%s", j->n_warnings,
                 j->n_warnings == 1 ? "" : "s");
    return text;
}

int cmd_finish_job(const char *name, err_t e, const struct job_result *j, bool strict)
{
    for (int i = 0; i < j->n_lenses; i++)
        fprintf(stderr, "hdrig %s: %s\n", name, j->lenses[i]);
    for (int i = 0; i < j->n_warnings; i++)
        fprintf(stderr, "hdrig %s: " CMD_WARNING "%s\n", name, j->warnings[i]);
    if (!e && strict && j->n_warnings > 0)
        e = err_fail(ERR_ARG, "%d warning%s, which --strict makes an error; the result is written",
                     j->n_warnings, j->n_warnings == 1 ? "" : "s");
    return cmd_finish(name, e);
}

static void fill_table(const struct cmd_usage *u, struct option *table)
{
    assert(u->n_options + 4 <= OPTIONS_MAX);
    for (int i = 0; i < u->n_options; i++) {
        const struct cmd_option *o = &u->options[i];
        table[i] =
            (struct option){o->name, o->arg ? required_argument : no_argument, NULL, OPT_FIRST + i};
    }
    table[u->n_options] = (struct option){"help", no_argument, NULL, OPT_HELP};
    table[u->n_options + 1] = (struct option){"config", required_argument, NULL, OPT_CONFIG};
    table[u->n_options + 2] = (struct option){"set", required_argument, NULL, OPT_SET};
    table[u->n_options + 3] = (struct option){0};
}

static err_t refuse_option(int c, const char *arg)
{
    if (c == ':')
        return err_fail(ERR_ARG, "%s needs an argument", arg);
    if (optopt > 0 &&
        optopt < OPT_CONFIG) // a single letter; getopt may still stand before its word
        return err_fail(ERR_ARG, "unknown option -%c", optopt);
    return err_fail(ERR_ARG, "unknown option %s", arg);
}

/* Apply an option of the command line, after the files of settings. */
static err_t apply_option(const struct cmd_usage *u, int c, const char *arg, struct config *cfg)
{
    char where[48];
    if (c == OPT_SET)
        return config_assign(cfg, arg);
    if (c < OPT_FIRST)
        return OK;
    const struct cmd_option *o = &u->options[c - OPT_FIRST];
    if (o->text) {
        bool many = strstr(o->arg, "...") != NULL;
        int i = 0;
        while (many && i < CMD_TEXTS_MAX && o->text[i])
            i++;
        if (i == CMD_TEXTS_MAX)
            return err_fail(ERR_ARG, "--%s: given more than %d times", o->name, CMD_TEXTS_MAX);
        o->text[i] = arg;
    }
    if (o->flag)
        *o->flag = true;
    if (!o->key)
        return OK;
    snprintf(where, sizeof where, "--%s", o->name);
    return config_set(cfg, where, o->key, arg);
}

/* First pass (cfg NULL): find --help and --config, refuse what is unknown. Second pass: take the
 * values. */
static err_t scan_options(const struct cmd_usage *u, int argc, char **argv, struct config *cfg,
                          const char **file, bool *help)
{
    struct option table[OPTIONS_MAX];
    err_t e = OK;
    fill_table(u, table);
    opterr = 0;
    optind = 0; // start again, GNU's way
    for (int c; !e && (c = getopt_long(argc, argv, "+:h", table, NULL)) != -1;) {
        if (c == '?' || c == ':')
            e = refuse_option(c, argv[optind - 1]);
        else if (cfg)
            e = apply_option(u, c, optarg, cfg);
        else if (c == OPT_CONFIG)
            *file = optarg;
        else if (c == OPT_HELP)
            *help = true;
    }
    if (!e && optind < argc)
        e = err_fail(ERR_ARG, "unexpected argument \"%s\"", argv[optind]);
    return e;
}

bool cmd_parse(const struct cmd_usage *u, int argc, char **argv, struct config *cfg, int *code)
{
    const char *file = NULL;
    bool help = false;
    config_defaults(cfg);
    err_t e = scan_options(u, argc, argv, NULL, &file, &help);
    if (!e && help) {
        print_help(u);
        *code = CMD_OK;
        return false;
    }
    if (e) {
        *code = cmd_misuse(u, err_text());
        return false;
    }
    e = config_load(cfg, CONFIG_DIR);
    if (!e && file)
        e = config_read(cfg, file);
    if (e) {
        *code = cmd_finish(u->name, e);
        return false;
    }
    if (scan_options(u, argc, argv, cfg, &file, &help) != OK) {
        *code = cmd_misuse(u, err_text());
        return false;
    }
    return true;
}

err_t cmd_number(const char *name, const char *text, double min, double max, double *out)
{
    char *end;
    double v = strtod(text, &end);
    if (end == text || *end || !isfinite(v))
        return err_fail(ERR_ARG, "%s: \"%.64s\" is not a number", name, text);
    if (v < min || v > max)
        return err_fail(ERR_ARG, "%s: %g is not in %g..%g", name, v, min, max);
    *out = v;
    return OK;
}

err_t cmd_whole(const char *name, const char *text, int min, int max, int *out)
{
    double v;
    err_t e = cmd_number(name, text, min, max, &v);
    if (!e && v != floor(v))
        e = err_fail(ERR_ARG, "%s: %g is not a whole number", name, v);
    if (!e)
        *out = (int)v;
    return e;
}

err_t cmd_list(const char *name, const char *text, int min, int max, struct cmd_list *out)
{
    char *end;
    out->n = 0;
    for (const char *at = text;; at = end + 1) {
        long v = strtol(at, &end, 10);
        if (end == at || (*end && *end != ','))
            return err_fail(ERR_ARG, "%s: \"%.64s\" is not a list like 1,2,3", name, text);
        if (v < min || v > max)
            return err_fail(ERR_ARG, "%s: %ld is not in %d..%d", name, v, min, max);
        if (out->n == CMD_LIST_MAX)
            return err_fail(ERR_ARG, "%s: more than %d numbers", name, CMD_LIST_MAX);
        out->v[out->n++] = (int)v;
        if (!*end)
            return OK;
    }
}

bool cmd_has_network(const struct cmd_model *m, const char **reason)
{
    bool has = m->path && strcmp(m->path, "none") != 0;
    enum precision p;
    *reason = NULL;
    if (m->precision && !modelfile_parse_precision(m->precision, &p))
        *reason = "--precision is fp32, bf16 or int8";
    else if (m->precision && !has && p != PRECISION_F32)
        *reason = "--precision needs a network, give --model FILE";
    return has;
}

err_t cmd_network(const struct cmd_model *m, const struct config *cfg, struct network *own,
                  const struct network **out)
{
    const char *reason;
    *out = NULL;
    if (!cmd_has_network(m, &reason))
        return OK;
    *out = own;
    return network_open(m->path, m->precision, (unsigned)cfg->net_float_parts, own);
}

err_t cmd_shipped(const struct cmd_model *m, struct network *own, const struct network **out)
{
    char path[FILE_PATH_CAP];
    if (m->path || !network_shipped(path))
        return OK;
    *out = own;
    return network_open(path, NULL, 0, own);
}

/* A rig's file by the settings: it is named there. */
static err_t join_rig_file(struct teamwork *w, struct config *cfg)
{
    const char *path = cfg->rig_file;
    err_t e = teamwork_path(w, &path);
    if (e || path == cfg->rig_file)
        return e;
    if (strlen(path) >= sizeof cfg->rig_file)
        return err_fail(ERR_LIMIT, "%s: longer than %zu bytes", path, sizeof cfg->rig_file - 1);
    memcpy(cfg->rig_file, path, strlen(path) + 1);
    return OK;
}

err_t cmd_join(struct teamwork *w, const char *name, struct config *cfg,
               struct imageset_request *set, struct cmd_model *m, struct engine *en)
{
    const int threads = cfg->threads, memory = cfg->max_memory_mb;
    err_t e = teamwork_open(w, name, threads, en);
    if (!e)
        e = team_copy(en->run.team, cfg, sizeof *cfg);
    cfg->threads = threads;
    cfg->max_memory_mb = memory;
    if (!e)
        e = teamwork_path(w, &set->exposures);
    if (!e)
        e = teamwork_path(w, &set->rig);
    if (!e)
        e = teamwork_path(w, &m->path);
    return e ? e : join_rig_file(w, cfg);
}

void cmd_imageset(const struct config *cfg, const struct network *network,
                  struct imageset_request *rq)
{
    rq->lenses = (enum physcam_rule)cfg->cameras_same;
    rq->may_lack_times = network && !network_needs_exposures(network);
    if (!rq->rig && cfg->rig_file[0] && !(rq->more && rq->more[0]) && raw_take_is(rq->images))
        rq->rig = cfg->rig_file;
    if (!rq->rig || strcmp(rq->rig, "none") != 0)
        return;
    rq->no_cameras = true;
    rq->rig = NULL;
}

err_t cmd_photographs(const struct imageset_request *rq, struct imageset *out)
{
    err_t e = imageset_list(rq, out);
    return e ? e : raw_take_attach(out);
}

static err_t decode_photograph(void *ctx, int i, struct image8 *out)
{
    return imageset_decode(ctx, i, out);
}

static err_t decode_deep(void *ctx, int i, struct image16 *out)
{
    return imageset_decode16(ctx, i, out);
}

static err_t decode_mask(void *ctx, int i, struct image8 *out)
{
    return imageset_decode_mask(ctx, i, false, out);
}

struct prep_source cmd_source(struct imageset *set)
{
    return (struct prep_source){decode_photograph, img_free,      set,
                                decode_deep,       pixels_free16, decode_mask};
}

bool cmd_fill_exposures(struct capture *c)
{
    bool lacking = false;
    for (int i = 0; i < c->n; i++)
        lacking = lacking || !(c->shots[i].exposure > 0);
    for (int i = 0; i < c->n && lacking; i++)
        c->shots[i].exposure = 1;
    return lacking;
}

void cmd_report_unread(const struct imageset *set, struct job_result *j)
{
    for (int i = 0; i < set->n_notes; i++)
        job_result_warn(j, "%s", set->notes[i]);
}

struct job_config cmd_job(const struct config *cfg, const struct network *network, bool poses)
{
    struct job_config job = {.size = cfg->size,
                             .size_fixed = cfg->size != CONFIG_SIZE_AUTO,
                             .budget_s = cfg->job_budget_s,
                             .network = network,
                             .polish = cfg->cameras_polish != 0,
                             .stereo = cfg->start_stereo != 0,
                             .fov_deg = (float)cfg->cameras_fov_deg,
                             .lens = (enum recipe_lens)cfg->cameras_lens,
                             .moved = (enum recipe_moved)cfg->rig_moved,
                             .principal = cfg->cameras_principal != 0,
                             .refine = {.steps = cfg->refine_steps,
                                        .degree_max = cfg->refine_sh_degree_max,
                                        .gaussians_max = cfg->refine_gaussians_max,
                                        .seed = (uint64_t)cfg->seed,
                                        .poses = poses}};
    return job;
}

/* How many steps fit into a time is no property of the job: it has no checkpoints. */
err_t cmd_checkpoints(struct outdir *out, const struct config *cfg, bool go_on,
                      struct resume *resume, struct job_config *job)
{
    if (job->refine.steps == 0 || cfg->job_checkpoint_s == 0 || job->budget_s > 0) {
        if (go_on)
            log_info("%s: a job %s has no checkpoint: it starts from the beginning", out->path,
                     job->budget_s > 0        ? "with a time budget"
                     : job->refine.steps == 0 ? "without refinement"
                                              : "with job.checkpoint_s = 0");
        return OK;
    }
    err_t e = resume_open(out, cfg->job_checkpoint_s, go_on, resume);
    job->refine.saver = &resume->saver;
    return e;
}

err_t cmd_json_open(const char *path, struct cmd_json *out)
{
    *out = (struct cmd_json){.path = path};
    if (!path)
        return OK;
    if (strcmp(path, "-") == 0) {
        out->f = stdout;
        return OK;
    }
    bool special = file_is_special(path);
    err_t e = special ? OK : origin_check_place(path);
    if (!e && !special)
        e = partial_open(path, &out->partial);
    if (!e && special)
        snprintf(out->at, sizeof out->at, "%s", path);
    else if (!e)
        e = partial_path(&out->partial, path, out->at);
    if (!e)
        e = file_create(out->at, &out->f);
    if (e)
        partial_close(&out->partial);
    return e;
}

err_t cmd_json_close(struct cmd_json *j)
{
    if (!j->f)
        return OK;
    if (j->f == stdout)
        return fflush(stdout) || ferror(stdout)
                   ? err_fail(file_code(errno), "stdout: %s", strerror(errno))
                   : OK;
    err_t e = file_finish(j->f, j->at);
    if (!e && j->partial.dir[0])
        e = partial_show(&j->partial, j->path);
    j->f = NULL;
    partial_close(&j->partial);
    return e;
}

void cmd_json_discard(struct cmd_json *j)
{
    if (j->f && j->f != stdout)
        fclose(j->f);
    j->f = NULL;
    partial_close(&j->partial);
}

/* Print the daemon's lines before its answer. */
static bool print_line(void *ctx, const char *json)
{
    struct cJSON *doc = NULL;
    const char *line = NULL;
    (void)ctx;
    if (json_parse("answer of the daemon", json, strlen(json), &doc) == OK)
        line = json_string(json_member(doc, "line"));
    if (line) {
        puts(line);
        fflush(stdout);
    }
    json_free(doc);
    return line != NULL;
}

int cmd_ask(const char *name, const struct config *cfg, const char *line)
{
    static char answer[CTL_ANSWER_MAX];
    struct cJSON *doc = NULL;
    bool ok = false;
    err_t e = ctl_follow(cfg->control_socket, line, print_line, NULL, answer);
    if (!e)
        e = json_parse("answer of the daemon", answer, strlen(answer), &doc);
    if (!e && (!json_truth(json_member(doc, "ok"), &ok) || !ok)) {
        const char *why = json_string(json_member(doc, "error"));
        e = err_fail(ERR_IO, "%s", why ? why : "the daemon refuses");
    }
    const char *id = json_string(json_member(doc, "id"));
    if (!e && id)
        printf("%s/%s\n", cfg->store_path, id);
    const char *session = json_string(json_member(json_member(doc, "session"), "line"));
    if (!e && session) // stdout is the take's
        fprintf(id ? stderr : stdout, "%s\n", session);
    json_free(doc);
    return cmd_finish(name, e);
}

/* ---- cameras ---- */

void cmd_wait(const struct session *s)
{
    const int64_t most = 50000000;
    struct pollfd fds[BRACKET_CAMERAS_MAX];
    int64_t deadline;
    int n = session_poll(s, fds, BRACKET_CAMERAS_MAX, &deadline);
    int64_t left = deadline - clocks_now();
    struct timespec t = {.tv_nsec = left < 0 ? 0 : left > most ? most : left};
    ppoll(fds, (nfds_t)n, &t, NULL);
}
