/* hdrig session: the places of the daemon's open session, and when they become a scene. */
#include "firmware/cmd/cmd.h"

#include <string.h>

int cmd_session_run(int argc, char **argv)
{
    struct config cfg;
    const char *what = "";
    int code;
    const struct cmd_usage usage = {"session", "[end|scene] ",
                                    "The captures of a rig of one camera are places of a session, "
                                    "which becomes one\nscene. Without a word: how many there are "
                                    "so far. end: the session ends and its\nscene is "
                                    "reconstructed; scene: reconstructed now, the session goes on.",
                                    NULL, 0};
    if (argc > 1 && argv[1][0] != '-') { // the word comes before the options
        what = *++argv;
        *argv = argv[-1];
        argc--;
    }
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    if (!*what)
        return cmd_ask("session", &cfg, "session");
    if (strcmp(what, "end") == 0)
        return cmd_ask("session", &cfg, "session end");
    if (strcmp(what, "scene") == 0)
        return cmd_ask("session", &cfg, "session scene");
    return cmd_misuse(&usage, "neither end nor scene");
}
