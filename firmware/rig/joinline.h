/* joinline.h - all that a board needs to know of its rig, as one line:
 *   hdrig1:HOST:PORT:RIG:BOARD:PASSWORD:CA:SUM
 * HOST and PORT are the broker's (an IPv6 address in brackets), PASSWORD is that of the user BOARD
 * there, CA the DER form of the certificate that signs the broker's, in base64 for URLs, SUM the
 * first 32 bits of the SHA-256 of everything before its colon, in hex digits: a line that was cut
 * off or mistyped is not believed. It is a secret. Lines that are read are hostile. Pure.
 * thread: any. */
#ifndef RIG_JOINLINE_H
#define RIG_JOINLINE_H

#include "firmware/capture/take.h"

#include <stddef.h>

enum {
    JOINLINE_CAP = 4096, // bytes of a line with its 0
    JOINLINE_HOST_CAP = 128,
    JOINLINE_PASSWORD_CAP = 64,
    JOINLINE_PASSWORD_MIN = 16, // digits of base64 for URLs
    JOINLINE_CA_MAX = 2048
};

struct joinline {
    char host[JOINLINE_HOST_CAP]; // in brackets if it is an IPv6 address
    int port;
    char rig[TAKE_MEMBER_CAP], board[TAKE_MEMBER_CAP];
    char password[JOINLINE_PASSWORD_CAP];
    size_t n_ca;
    unsigned char ca[JOINLINE_CA_MAX];
};

/* The line without its end. Blanks and quotes around it, as pasting leaves them, are let go.
 * err:  ERR_FORMAT names what is wrong, and never the secret. On error *out is zeroed. */
MUST_USE err_t joinline_read(const char *text, struct joinline *out);

/* err:  ERR_ARG (host, port, names, password, certificate) */
MUST_USE err_t joinline_write(const struct joinline *j, char out[JOINLINE_CAP]);

#endif
