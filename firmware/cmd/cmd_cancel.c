/* hdrig cancel: stops the daemon's running work. */
#include "firmware/cmd/cmd.h"

int cmd_cancel_run(int argc, char **argv)
{
    struct config cfg;
    int code;
    const struct cmd_usage usage = {"cancel", "",
                                    "Ends the daemon's running calibration or capture, else its "
                                    "running reconstruction.",
                                    NULL, 0};
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    return cmd_ask("cancel", &cfg, "cancel");
}
