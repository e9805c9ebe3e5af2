/* hdrig.c - the command-line tool: hands over to a sub-command. */
#include "firmware/base/engine.h"
#include "firmware/cmd/cmd.h"

#include "drivers/net/ranks.h"

#include <signal.h>
#include <string.h>
#include <unistd.h>

static const struct {
    const char *name, *help;
    int (*run)(int argc, char **argv);
} commands[] = {
    {"capture", "one capture, by the daemon or with cameras of this machine", cmd_capture_run},
    {"status", "what the daemon does", cmd_status_run},
    {"session", "places so far; ends the session, and they become a scene", cmd_session_run},
    {"cancel", "ends what the daemon does", cmd_cancel_run},
    {"calibrate", "what a camera really does, measured and kept", cmd_calibrate_run},
    {"rig", "a rig of several boards; lenses and places of a rig's cameras", cmd_rig_run},
    {"selftest", "whether a camera does what captures need", cmd_selftest_run},
    {"reconstruct", "photographs to an HDR scene", cmd_reconstruct_run},
    {"render", "pictures of a scene from other places", cmd_render_run},
    {"view", "a scene in the browser", cmd_view_run},
    {"eval", "reconstruct a data set and measure it on its held-out views", cmd_eval_run},
    {"convert", "weights of a network for this program", cmd_convert_run},
    {"convert-scene", "a scene in another kind of file, and what that loses",
     cmd_convert_scene_run},
    {"export", "cameras, photographs and points of a scene for other programs", cmd_export_run},
    {"simulate", "a simulated scene as a data set, with the truth", cmd_simulate_run},
    {"bench", "figures of this machine against its limits", cmd_bench_run},
    {"doctor", "what this machine has", cmd_doctor_run},
    {"config", "the settings and their values", cmd_config_run},
};

enum { N_COMMANDS = sizeof commands / sizeof commands[0] };

static bool works_with_others(int (*run)(int argc, char **argv))
{
    return run == cmd_reconstruct_run || run == cmd_eval_run || run == cmd_bench_run;
}

static void print_help(FILE *f)
{
    fputs("usage: hdrig COMMAND [options]\n\n", f);
    for (int i = 0; i < N_COMMANDS; i++)
        fprintf(f, "  %-13s %s\n", commands[i].name, commands[i].help);
    fputs("\nhdrig COMMAND --help tells the options of a command, hdrig --version the version.\n",
          f);
}

/* The first signal asks the job to stop, the second ends at once. */
static void on_signal(int number)
{
    (void)number;
    if (atomic_exchange(&engine_cancel, true))
        _exit(CMD_INTERRUPTED);
}

static void catch_signals(void)
{
    struct sigaction stop = {.sa_handler = on_signal}, ignore = {.sa_handler = SIG_IGN}, old;
    if (sigaction(SIGHUP, NULL, &old) == 0 && old.sa_handler != SIG_IGN) // nohup
        sigaction(SIGHUP, &stop, NULL);
    sigaction(SIGINT, &stop, NULL);
    sigaction(SIGTERM, &stop, NULL);
    sigaction(SIGPIPE, &ignore, NULL); // writes report errors instead, and results are cleaned up
    sigaction(SIGXFSZ, &ignore, NULL);
}

int main(int argc, char **argv)
{
    const char *name = argc > 1 ? argv[1] : "";
    if (strcmp(name, "--help") == 0 || strcmp(name, "-h") == 0) {
        print_help(stdout);
        return CMD_OK;
    }
    if (strcmp(name, "--version") == 0) {
        puts("hdrig " HDRIG_VERSION);
        return CMD_OK;
    }
    catch_signals();
    for (int i = 0; i < N_COMMANDS; i++) {
        if (strcmp(commands[i].name, name) != 0)
            continue;
        if (ranks_launched() > 1 && !works_with_others(commands[i].run)) {
            fprintf(stderr, "hdrig %s: does not run on several ranks\n", name);
            return CMD_USAGE;
        }
        return commands[i].run(argc - 1, argv + 1);
    }
    if (*name)
        fprintf(stderr, "hdrig: unknown command \"%s\"\n", name);
    print_help(stderr);
    return CMD_USAGE;
}
