/* Any bytes as manifest.json of a take: refused and nothing is read, or every name of a file stays
 * within the take. */
#include "firmware/store/manifest.h"
#include "firmware/store/raw_take.h"

#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct manifest m;
    err_t e = manifest_parse("input", (const char *)data, size, &m);
    if (e && (m.n || m.id[0] || !*err_text()))
        abort();
    for (int i = 0; i < m.n; i++)
        if (m.file[i].name[0] == '/' || strstr(m.file[i].name, "..") == m.file[i].name ||
            strstr(m.file[i].name, "/.") || strlen(m.file[i].sha256) != SHA256_HEX_CAP - 1)
            abort();
    static struct raw_take t;
    e = raw_take_parse("input", (const char *)data, size, &t);
    if (e && (t.n || t.n_cameras || !*err_text()))
        abort();
    for (int i = 0; i < t.n; i++)
        if (t.frame[i].camera >= t.n_cameras || strstr(t.frame[i].raw, "/.."))
            abort();
    return 0;
}
