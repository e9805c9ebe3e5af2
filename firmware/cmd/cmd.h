/* cmd.h - the sub-commands of the tool, with their common options and exit codes.
 * Results go to stdout, everything else to stderr. */
#ifndef CMD_CMD_H
#define CMD_CMD_H

#include "firmware/base/config.h"
#include "firmware/base/teamwork.h"
#include "firmware/recon/job.h"
#include "firmware/result/resume.h"

#include "drivers/format/imageset.h"
#include "drivers/format/partial.h"

#include "core/base/err.h"
#include "core/photo/prep.h"

#include <stdbool.h>
#include <stdio.h>

enum { CMD_OK = 0, CMD_FAILURE = 1, CMD_USAGE = 2, CMD_REFUSED = 3, CMD_INTERRUPTED = 130 };

enum { CMD_TEXTS_MAX = 64, CMD_COUNT_CAP = 32 };

/* One option of a command line. Exactly one of key, text and flag receives it. */
struct cmd_option {
    const char *name, *arg; // arg: its word in the help, NULL for a switch; "URI...": may come
                            // CMD_TEXTS_MAX times, and `text` is an array of so many, NULL at first
    const char *help;
    const char *key;   // setting of config.h
    const char **text; // receives the argument
    bool *flag;        // receives true
};

/* Options that set a key and mean the same everywhere. */
#define CMD_KEY(name, arg, key, help)                                                              \
    {                                                                                              \
        name, arg, help, key, NULL, NULL                                                           \
    }
#define CMD_THREADS CMD_KEY("threads", "N", "threads", "worker threads, 0 = one per core")
#define CMD_MEMORY CMD_KEY("max-memory", "MB", "max_memory_mb", "refuse jobs that need more")
#define CMD_FORCE(rules)                                                                           \
    {                                                                                              \
        "force", NULL, "replace a former result whose files were changed since, too", NULL, NULL,  \
            &(rules).force                                                                         \
    }
#define CMD_STRICT(to)                                                                             \
    {                                                                                              \
        "strict", NULL, "exit with 1 if there are warnings", NULL, NULL, &(to)                     \
    }
#define CMD_RESUME(to)                                                                             \
    {                                                                                              \
        "resume", NULL, "go on where a former run for the same result was interrupted", NULL,      \
            NULL, &(to)                                                                            \
    }
#define CMD_SIZE CMD_KEY("size", "N", "size", "longer edge of the pictures, px; or full, or auto")
#define CMD_SEED CMD_KEY("seed", "N", "seed", "start of the random numbers")
#define CMD_BUDGET                                                                                 \
    CMD_KEY("budget", "SECONDS", "job.budget_s",                                                   \
            "time for the scene; size and steps are chosen for it")
#define CMD_REFINE CMD_KEY("refine", "N", "refine.steps", "steps of refinement, 0 = none")
#define CMD_DEGREE CMD_KEY("degree-max", "D", "refine.sh_degree_max", "highest SH degree, 0..4")
#define CMD_GAUSSIANS CMD_KEY("gaussians-max", "N", "refine.gaussians_max", "most Gaussians")

struct cmd_usage {
    const char *name;     // name of the command
    const char *synopsis; // its required options
    const char *what;     // description
    const struct cmd_option *options;
    int n_options;
};

/* Read the options of argv[1..argc-1] after config_load; every command also has --help, --config
 * and --set. Returns true if the command shall run. Else help or a sentence has been printed and
 * *code is the exit code. */
MUST_USE bool cmd_parse(const struct cmd_usage *u, int argc, char **argv, struct config *cfg,
                        int *code);

/* Print "hdrig NAME: reason, see --help" and return CMD_USAGE. */
int cmd_misuse(const struct cmd_usage *u, const char *reason);

/* Exit code of e; its sentence is printed if it is an error. */
int cmd_finish(const char *name, err_t e);

/* The same at the end of a job, after its warnings, each in a line that begins with "hdrig NAME: "
 * and CMD_WARNING. strict: they are failures. */
#define CMD_WARNING "warning: "
int cmd_finish_job(const char *name, err_t e, const struct job_result *j, bool strict);

/* ", N warnings" for a summary line; "" without. */
const char *cmd_count_warnings(const struct job_result *j, char text[CMD_COUNT_CAP]);

/* Number in min..max of option `name`.
 * err:  ERR_ARG. */
MUST_USE err_t cmd_number(const char *name, const char *text, double min, double max, double *out);

/* The same for a whole number. */
MUST_USE err_t cmd_whole(const char *name, const char *text, int min, int max, int *out);

enum { CMD_LIST_MAX = 8 };

struct cmd_list {
    int n, v[CMD_LIST_MAX];
};

/* Whole numbers in min..max, separated by commas, for option `name`.
 * err:  ERR_ARG. */
MUST_USE err_t cmd_list(const char *name, const char *text, int min, int max, struct cmd_list *out);

/* Options of commands that can use a network. */
struct cmd_model {
    const char *path, *precision; // path: NULL or "none": no network
};

/* Whether there is one; *reason is the text for cmd_misuse if the options contradict each other, or
 * NULL. */
bool cmd_has_network(const struct cmd_model *m, const char **reason);

/* Open it: *out is NULL without a network, else *own.
 * own:  network_close of *own, also if it was not opened.
 * err:  those of network_open. */
MUST_USE err_t cmd_network(const struct cmd_model *m, const struct config *cfg, struct network *own,
                           const struct network **out);

/* Without --model, open the model that comes with this program: *out, with *own behind it.
 * Unchanged if there is a network, or no such model.
 * own, err: as cmd_network. */
MUST_USE err_t cmd_shipped(const struct cmd_model *m, struct network *own,
                           const struct network **out);

/* teamwork_open, with the settings of the first rank but its threads and memory, and the files of
 * the request where they are needed.
 * own:  teamwork_close, engine_close.
 * err:  those of teamwork_open and teamwork_path. */
MUST_USE err_t cmd_join(struct teamwork *w, const char *name, struct config *cfg,
                        struct imageset_request *set, struct cmd_model *m, struct engine *en);

/* Set the request's fields that follow from rig and network: rig.file if it is the take of a rig,
 * "none" as rig, and exposures that may be missing. */
void cmd_imageset(const struct config *cfg, const struct network *network,
                  struct imageset_request *request);

/* The photographs of a request; raw frames where they are those of takes.
 * own:  imageset_free.
 * err:  those of imageset_list and raw_take_attach. */
MUST_USE err_t cmd_photographs(const struct imageset_request *rq, struct imageset *out);

/* Their pixels, read when they are resized, so that few are in memory at a time. */
struct prep_source cmd_source(struct imageset *set);

/* If some exposures are missing, set all to 1 and return true. */
bool cmd_fill_exposures(struct capture *c);

/* Files of the folder that are not read become warnings of the job. */
void cmd_report_unread(const struct imageset *set, struct job_result *j);

/* The part of the settings that a job takes. network: or NULL. poses: refine the cameras too. */
struct job_config cmd_job(const struct config *cfg, const struct network *network, bool poses);

/* The checkpoints of a job that refines, beside its result `out`; go_on: from the last one.
 * own:  resume_close.
 * err:  those of resume_open. */
MUST_USE err_t cmd_checkpoints(struct outdir *out, const struct config *cfg, bool go_on,
                               struct resume *resume, struct job_config *job);

/* Target of --json: a file that appears when it is complete, a device, or "-" for stdout. */
struct cmd_json {
    FILE *f; // NULL without --json
    const char *path;
    char at[FILE_PATH_CAP]; // where it is written
    struct partial partial;
};

/* Begin it; path: or NULL.
 * own:  cmd_json_close or cmd_json_discard.
 * err:  those of origin_check_place, partial_open and file_create. */
MUST_USE err_t cmd_json_open(const char *path, struct cmd_json *out);

/* err:  those of file_finish and partial_show. */
MUST_USE err_t cmd_json_close(struct cmd_json *j);

/* Remove the unfinished file. */
void cmd_json_discard(struct cmd_json *j);

/* Send a line to the daemon (ctl.h); prints the take that it names, and how the session stands.
 * Returns an exit code. */
int cmd_ask(const char *name, const struct config *cfg, const char *line);

/* Wait for what session_poll names; a twentieth of a second at most, so that Ctrl-C is noticed. */
struct session;
void cmd_wait(const struct session *s);

/* The commands: argv[0] is the command's name; they return an exit code. */
int cmd_reconstruct_run(int argc, char **argv);
int cmd_render_run(int argc, char **argv);
int cmd_view_run(int argc, char **argv);
int cmd_eval_run(int argc, char **argv);
int cmd_convert_run(int argc, char **argv);
int cmd_convert_scene_run(int argc, char **argv);
int cmd_export_run(int argc, char **argv);
int cmd_simulate_run(int argc, char **argv);
int cmd_capture_run(int argc, char **argv);
int cmd_status_run(int argc, char **argv);
int cmd_session_run(int argc, char **argv);
int cmd_cancel_run(int argc, char **argv);
int cmd_calibrate_run(int argc, char **argv);
int cmd_rig_run(int argc, char **argv);
int cmd_selftest_run(int argc, char **argv);
int cmd_bench_run(int argc, char **argv);
int cmd_doctor_run(int argc, char **argv);
int cmd_config_run(int argc, char **argv);

#endif
