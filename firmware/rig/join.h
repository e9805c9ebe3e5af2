/* join.h - a board becomes one of a rig: its files in the folder of the settings.
 *   rig-ca.pem    the certificate that the broker's must come from
 *   rig-password  the board's at the broker
 *   http-token    the password of its status page, if the settings have none
 *   hdrig.conf    the settings of the rig; all other lines stay as they are
 * The secrets can be read by group hdrig and root, and without that group by root alone.
 * thread: any. Blocks. */
#ifndef RIG_JOIN_H
#define RIG_JOIN_H

#include "firmware/base/config.h"
#include "firmware/rig/joinline.h"

struct join {
    const char *dir; // of the settings
    bool conductor;  // else a member
    const struct joinline *line;
};

struct join_outcome {
    char token[JOINLINE_PASSWORD_CAP]; // of the page; "": the settings have one
    struct config set;                 // with what was changed
};

/* told: each line of hdrig.conf that was changed, as it is now.
 * err:  ERR_ARG (no such folder, path too long), ERR_FORMAT (hdrig.conf cannot be changed without
 *       a person), ERR_IO, ERR_LIMIT, ERR_NOMEM */
MUST_USE err_t join_write(const struct join *j, FILE *told, struct join_outcome *out);

/* Whether the broker lets that board in now.
 * err:  why not: ERR_LOST, or as mqtt_open */
MUST_USE err_t join_try(const struct config *set, const struct joinline *line);

#endif
