/* Any bytes as a configuration file: refused with a sentence or accepted within the ranges. */
#include "firmware/base/config.h"

#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct config c;
    config_defaults(&c);
    err_t e = config_parse(&c, "fuzz", (const char *)data, size);
    if (e && !*err_text())
        abort();
    bool known = c.size == CONFIG_SIZE_AUTO || c.size == CONFIG_SIZE_FULL ||
                 (c.size >= 56 && c.size <= 4080);
    if (!known || c.threads < 0 || c.threads > 64 || c.seed < 0 || c.refine_sh_degree_max < 0 ||
        c.refine_sh_degree_max > 4)
        abort();
    return 0;
}
