#include "firmware/rig/joinline.h"

#include "firmware/rig/message.h"

#include "core/base/base64.h"
#include "core/base/sha256.h"
#include "drivers/net/mqtt.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { SUM_DIGITS = 8, PORT_CAP = 6, CERTIFICATE_MIN = 128 };

#define URL_DIGITS "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"

static void put_sum(const char *text, size_t n, char out[SUM_DIGITS + 1])
{
    char hex[SHA256_HEX_CAP];
    struct sha256 s;
    sha256_init(&s);
    sha256_add(&s, text, n);
    memcpy(out, sha256_hex(&s, hex), SUM_DIGITS);
    out[SUM_DIGITS] = 0;
}

/* A sequence of ASN.1 that ends where the bytes end: its length has two bytes. */
static bool may_be_certificate(const unsigned char *p, size_t n)
{
    return n >= CERTIFICATE_MIN + 4 && p[0] == 0x30 && p[1] == 0x82 &&
           ((size_t)p[2] << 8 | p[3]) == n - 4;
}

static err_t check_fields(const struct joinline *j)
{
    char url[JOINLINE_HOST_CAP + 32];
    struct mqtt_url parts;
    const size_t n = strlen(j->password);
    snprintf(url, sizeof url, "mqtts://%s:%d", j->host, j->port);
    if (mqtt_parse_url(url, &parts) != OK || parts.port != j->port)
        return err_fail(ERR_ARG, "\"%s\" port %d is no host or address", j->host, j->port);
    if (!manifest_is_member(j->rig))
        return err_fail(ERR_ARG, "\"%s\" is no name of a rig: small letters, digits and -", j->rig);
    if (!manifest_is_member(j->board))
        return err_fail(ERR_ARG, "\"%s\" is no name of a board: small letters, digits and -",
                        j->board);
    if (n < JOINLINE_PASSWORD_MIN || strspn(j->password, URL_DIGITS) != n)
        return err_fail(ERR_ARG, "the password is too short, or has other letters");
    if (!may_be_certificate(j->ca, j->n_ca))
        return err_fail(ERR_ARG, "its certificate is none");
    return OK;
}

/* The field at *p up to a colon, behind which *p is then. */
static bool take_field(const char **p, char *out, size_t cap)
{
    size_t n = strcspn(*p, ":");
    if (**p == '[') // a host
        n = strcspn(*p, "]") + 1;
    if (n >= cap || strnlen(*p, n) < n || (*p)[n] != ':')
        return false;
    memcpy(out, *p, n);
    out[n] = 0;
    *p += n + 1;
    return true;
}

static bool take_port(const char **p, int *out)
{
    char text[PORT_CAP];
    if (!take_field(p, text, sizeof text) || !*text || strspn(text, "0123456789") != strlen(text))
        return false;
    *out = atoi(text);
    return *text != '0';
}

static bool take_ca(const char **p, struct joinline *j)
{
    const size_t n = strcspn(*p, ":");
    if ((*p)[n] != ':' || n / 4 * 3 + 2 > sizeof j->ca ||
        !base64_decode_url(*p, n, j->ca, &j->n_ca))
        return false;
    *p += n + 1;
    return true;
}

static err_t read_fields(const char *text, struct joinline *j)
{
    static const char version[] = "hdrig1:";
    char sum[SUM_DIGITS + 1];
    const char *end = strrchr(text, ':'), *p = text + sizeof version - 1;
    if (strncmp(text, version, sizeof version - 1) != 0)
        return err_fail(ERR_FORMAT, "this is no line of hdrig rig add: it would begin with %s",
                        version);
    put_sum(text, (size_t)(end - text), sum);
    if (strcmp(end + 1, sum) != 0)
        return err_fail(ERR_FORMAT, "the line is not as hdrig rig add has printed it: its end is "
                                    "missing, or something in it was changed");
    if (!take_field(&p, j->host, sizeof j->host) || !take_port(&p, &j->port) ||
        !take_field(&p, j->rig, sizeof j->rig) || !take_field(&p, j->board, sizeof j->board) ||
        !take_field(&p, j->password, sizeof j->password) || !take_ca(&p, j) || p != end + 1)
        return err_fail(ERR_FORMAT, "the line lacks a part, or one of them is too long");
    return check_fields(j) == OK ? OK : err_fail(ERR_FORMAT, "the line is wrong: %s", err_text());
}

err_t joinline_read(const char *text, struct joinline *out)
{
    static const char around[] = " \t\r\n'\"";
    char line[JOINLINE_CAP];
    *out = (struct joinline){0};
    text += strspn(text, around);
    size_t n = strlen(text);
    while (n > 0 && strchr(around, text[n - 1]))
        n--;
    if (n >= sizeof line)
        return err_fail(ERR_FORMAT, "the line has %zu bytes, at most %zu", n, sizeof line - 1);
    memcpy(line, text, n);
    line[n] = 0;
    const err_t e = read_fields(line, out);
    explicit_bzero(line, sizeof line);
    if (e)
        explicit_bzero(out, sizeof *out);
    return e;
}

err_t joinline_write(const struct joinline *j, char out[JOINLINE_CAP])
{
    char ca[JOINLINE_CA_MAX / 3 * 4 + 8], sum[SUM_DIGITS + 1];
    const err_t e = check_fields(j);
    if (e)
        return e;
    *base64_encode_url(ca, j->ca, j->n_ca) = 0;
    const int n = snprintf(out, JOINLINE_CAP, "hdrig1:%s:%d:%s:%s:%s:%s", j->host, j->port, j->rig,
                           j->board, j->password, ca);
    put_sum(out, (size_t)n, sum);
    snprintf(out + n, JOINLINE_CAP - (size_t)n, ":%s", sum);
    return OK;
}
