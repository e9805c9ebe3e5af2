/* hdrig config: the settings and their values. */
#include "firmware/cmd/cmd.h"

int cmd_config_run(int argc, char **argv)
{
    struct config cfg;
    bool print = false;
    const struct cmd_option options[] = {
        {"print", NULL, "every setting with its range and value", NULL, NULL, &print},
    };
    const struct cmd_usage usage = {"config", "--print ",
                                    "The settings after all files and options.", options, 1};
    int code;
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    if (!print)
        return cmd_misuse(&usage, "--print is needed");
    return cmd_finish(usage.name, config_print(&cfg, stdout));
}
