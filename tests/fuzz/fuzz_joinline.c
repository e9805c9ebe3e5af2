/* A line to join a rig by, as it is and with the sum that it should have; what is accepted is
 * written as it was read. */
#include "firmware/rig/joinline.h"

#include "core/base/sha256.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void try_line(const char *line)
{
    char back[JOINLINE_CAP];
    struct joinline j, again;
    const err_t e = joinline_read(line, &j);
    if (e && (e != ERR_FORMAT || !*err_text()))
        abort();
    if (e)
        return;
    if (joinline_write(&j, back) != OK || !strstr(line, back) ||
        joinline_read(back, &again) != OK || memcmp(&j, &again, sizeof j) != 0)
        abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    char hex[SHA256_HEX_CAP];
    struct sha256 s;
    char *line = malloc(size + 10);
    if (!line)
        return 0;
    memcpy(line, data, size);
    line[size] = 0;
    try_line(line);
    const size_t n = strlen(line);
    sha256_init(&s);
    sha256_add(&s, line, n);
    snprintf(line + n, 10, ":%.8s", sha256_hex(&s, hex));
    try_line(line);
    free(line);
    return 0;
}
