/* broker.h - a mosquitto that serves rigs of several boards (firmware/rig/README.md 4): its
 * certificates, its rules and the users of it. Files, below the folder of mosquitto's settings:
 *   hdrig/ca.key, ca.pem          sign the broker's certificate; boards trust ca.pem
 *   hdrig/server.key, server.pem  the broker's, for one name or address
 *   hdrig/acl, hdrig/users        what members may do; passwords, hashed by mosquitto
 *   conf.d/hdrig.conf             names these; host, port, rig and conductor in a comment
 * All begin with TEXTFILE_MARK, and no other file is replaced. The programs openssl and
 * mosquitto_passwd do the work; no secret is in their arguments.
 * thread: any. Blocks. */
#ifndef RIG_BROKER_H
#define RIG_BROKER_H

#include "firmware/rig/joinline.h"

#define BROKER_DIR "/etc/mosquitto"

struct broker_site {
    char host[JOINLINE_HOST_CAP]; // as boards reach it: a name, an address, [IPv6]
    int port;
    char rig[TAKE_MEMBER_CAP], conductor[TAKE_MEMBER_CAP];
};

/* Make the files. Keys that sign, and users, of an earlier call stay, so that boards that have
 * joined do not join again; the rest is made new. Afterwards the broker must be started again.
 * err:  ERR_ARG (names, host; a file of others; no such folder), ERR_IO, ERR_LOST (no openssl),
 *       ERR_LIMIT, ERR_NOMEM */
MUST_USE err_t broker_make(const char *dir, const struct broker_site *site);

/* What broker_make was told.
 * err:  ERR_LOST (was never called for this folder), ERR_IO, ERR_FORMAT, ERR_NOMEM */
MUST_USE err_t broker_site(const char *dir, struct broker_site *out);

/* Whether the broker knows a user of that name.
 * err:  as broker_site. */
MUST_USE err_t broker_knows(const char *dir, const char *board, bool *out);

/* A new password for a board, known or not. The broker learns of it when it gets SIGHUP.
 * out:  what the board needs.
 * err:  ERR_ARG (name), as broker_site, ERR_LOST (no mosquitto_passwd) */
MUST_USE err_t broker_add(const char *dir, const char *board, struct joinline *out);

/* Let a board in no more. The broker learns of it when it gets SIGHUP, and ends its connection.
 * err:  ERR_ARG (no such board; the conductor), as broker_site. On error nothing has changed. */
MUST_USE err_t broker_remove(const char *dir, const char *board);

#endif
