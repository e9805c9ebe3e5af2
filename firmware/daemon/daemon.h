/* daemon.h - the main loop of hdrigd, over triggers, cameras, control socket, status page, signals
 * and the ends of background work.
 * thread: one; a second one writes takes, reconstructions are processes. */
#ifndef DAEMON_DAEMON_H
#define DAEMON_DAEMON_H

#include "firmware/base/config.h"

struct daemon_config {
    const struct config *settings;
    const char *config_path; // file for reconstructions; NULL: none
    const char *program;     // hdrig, for reconstructions
    const char *version;
};

/* Runs until SIGTERM or SIGINT, which it answers within the longest exposure and 2 s.
 * err:  ERR_ARG (settings that a retry does not help), ERR_IO, ERR_BUSY (another daemon),
 * ERR_NOMEM.
 *       A camera or trigger that is missing is no error: the loop waits for it. */
MUST_USE err_t daemon_run(const struct daemon_config *cfg);

#endif
