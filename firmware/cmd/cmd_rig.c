/* hdrig rig: hands over to its commands. */
#include "firmware/cmd/cmd_rig.h"

#include <string.h>

static const struct {
    const char *name, *help;
    int (*run)(int argc, char **argv);
} commands[] = {
    {"status", "boards of the rig, and what keeps it from a capture", cmd_rig_status},
    {"hosts", "the boards that are there, for mpirun", cmd_rig_status_hosts},
    {"capture", "one capture by all boards, and how far apart they began", cmd_rig_status_capture},
    {"accept", "joins what there is of a capture that waits for parts", cmd_rig_status_accept},
    {"forget", "gives up a capture that waits, or a board that was taken away",
     cmd_rig_status_forget},
    {"broker", "makes the broker of a rig on this machine", cmd_rig_setup_broker},
    {"add", "lets a board into the rig: prints the line that it needs", cmd_rig_setup_add},
    {"remove", "lets a board into the rig no more", cmd_rig_setup_remove},
    {"join", "makes this machine a board of the rig, by that line", cmd_rig_setup_join},
    {"board", "a board of tags to print, for calibrate", cmd_rig_board},
    {"calibrate", "lens and place of every camera, from takes of the rig", cmd_rig_calibrate},
};

enum { N_COMMANDS = sizeof commands / sizeof commands[0] };

static void print_help(FILE *f)
{
    fputs("usage: hdrig rig COMMAND [options]\n\n", f);
    for (int i = 0; i < N_COMMANDS; i++)
        fprintf(f, "  %-13s %s\n", commands[i].name, commands[i].help);
    fputs("\nhdrig rig COMMAND --help tells the options of a command.\n", f);
}

char *cmd_rig_word(int *argc, char ***argv)
{
    static char none[] = "";
    char **v = *argv;
    if (*argc < 2 || v[1][0] == '-')
        return none;
    char *word = v[1];
    v[1] = v[0];
    (*argv)++;
    (*argc)--;
    return word;
}

int cmd_rig_run(int argc, char **argv)
{
    const char *name = argc > 1 ? argv[1] : "";
    if (strcmp(name, "--help") == 0 || strcmp(name, "-h") == 0) {
        print_help(stdout);
        return CMD_OK;
    }
    for (int i = 0; i < N_COMMANDS; i++)
        if (strcmp(commands[i].name, name) == 0)
            return commands[i].run(argc - 1, argv + 1);
    if (*name)
        fprintf(stderr, "hdrig rig: \"%.40s\" is none of its commands\n", name);
    print_help(stderr);
    return CMD_USAGE;
}
