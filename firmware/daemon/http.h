/* http.h - the status page: live state, trigger button, files of captures and scenes, through
 * libmicrohttpd. It runs inside the daemon's loop, without a thread.
 *   GET  /  /page.{css,js}  /rig.js   the page
 *   GET  /status.json                 output of http_config.status
 *   GET  /live/N.jpg                  what camera N sees: http_config.live
 *   POST /capture  /cancel            header X-Hdrig: 1, which other sites cannot send
 *   POST /login                       token=...: sets the cookie
 *   GET  /captures/...  /results/...  files, never beyond these folders, never through links
 *   GET  /parts/ID/...                files of the take ID, for the conductor of a rig of boards
 * Files come whole or from byte N on, "Range: bytes=N-" or "bytes=N-M"; other ranges are ignored.
 * Without `status` there is no daemon, and only results are served. Their pages have
 * their scripts inline, which may not open connections.
 * With a token every request needs it: as a cookie, or "Authorization: Bearer TOKEN". Without one,
 * Host must be an address, localhost or this machine's name, so that no other site can reach the
 * page by a name of its own (DNS rebinding). Parts have a token of their own as "Authorization:
 * Bearer", which they need and which opens nothing else. */
#ifndef DAEMON_HTTP_H
#define DAEMON_HTTP_H

#include "core/base/err.h"

#include <poll.h>
#include <stdint.h>
#include <stdio.h>

struct http_config {
    const char *address; // IPv4 or IPv6
    int port;            // 0: any free one
    const char *token;   // "" for none
    const char *captures, *results;
    void *ctx;
    void (*status)(void *ctx, FILE *out);          // NULL: captures and command may be NULL too
    err_t (*command)(void *ctx, const char *line); // as on the control socket
    /* JPEG of camera 0.. as it waits; own: free(*jpeg). err: its sentence is the answer */
    err_t (*live)(void *ctx, int camera, void **jpeg, size_t *n);
    const char *parts_token;                       // of the rig; NULL or "": no parts are served
};

struct http;

/* own:  http_close.
 * err:  ERR_ARG (address), ERR_BUSY (port in use), ERR_IO (no permission), ERR_NOMEM */
MUST_USE err_t http_open(const struct http_config *cfg, struct http **out);
void http_close(struct http *h); // accepts NULL

int http_port(const struct http *h);

/* The descriptor to wait for, and the latest time of http_step, CLOCK_MONOTONIC ns. */
struct pollfd http_poll(const struct http *h, int64_t now, int64_t *deadline_ns);
void http_step(struct http *h);

#endif
