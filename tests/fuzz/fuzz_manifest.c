/* Any bytes as manifest.json of a take: refused and nothing is read, or every name of a file stays
 * within the take. As that of a board's part: every number can be used. */
#include "firmware/store/manifest.h"
#include "firmware/store/part.h"
#include "firmware/store/raw_take.h"

#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* "raw/.._00.bin" is a file of that name. */
static bool leaves_folder(const char *name)
{
    const char *file = strchr(name, '/');
    return !file || strchr(file + 1, '/') || strcmp(file, "/..") == 0;
}

static void check_part(const char *text, size_t n, const struct manifest *m)
{
    static struct part p;
    char name[MANIFEST_NAME_CAP];
    if (part_parse("input", text, n, m->rig_take, m->rig_member, &p) != OK) {
        if (p.doc || p.n || !*err_text())
            abort();
        return;
    }
    for (int i = 0; i < p.n; i++)
        if (p.frame[i].camera < 0 || p.frame[i].camera >= p.n_cameras || p.frame[i].index < 0 ||
            p.frame[i].index >= BRACKET_EXPOSURES_MAX)
            abort();
    for (int i = 0; i < p.manifest.n; i++) {
        part_rename(p.manifest.file[i].name, 48, name);
        if (strlen(name) != strlen(p.manifest.file[i].name) &&
            strcmp(p.manifest.file[i].name, "exposure.json") != 0)
            abort();
    }
    FILE *f = fopen("/dev/null", "w");
    if (!f)
        abort();
    part_put_cameras(f, &p, 48);
    part_put_frames(f, &p, 48);
    fclose(f);
    part_free(&p);
}

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
    if (!manifest_is_member(m.rig_member) != !m.rig_take[0])
        abort();
    if (!e)
        check_part((const char *)data, size, &m);
    static struct raw_take t;
    e = raw_take_parse("input", (const char *)data, size, &t);
    if (e && (t.n || t.n_cameras || !*err_text()))
        abort();
    for (int i = 0; i < t.n; i++)
        if (t.frame[i].camera >= t.n_cameras || leaves_folder(t.frame[i].raw))
            abort();
    return 0;
}
