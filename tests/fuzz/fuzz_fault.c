/* Any bytes as a fault script of a simulated camera: refused with a sentence, or at most FAULT_MAX
 * faults. */
#include "sim/device/fault.h"

#include <stdint.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct fault_script script;
    err_t e = fault_parse("fuzz", (const char *)data, size, &script);
    if (e && (!*err_text() || script.n != 0))
        abort();
    if (script.n < 0 || script.n > FAULT_MAX)
        abort();
    return 0;
}
