#include "drivers/device/memory.h"

#include "drivers/format/file.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* The first line of a file, without its end. */
static bool first_line(const char *path, char *out, size_t cap)
{
    FILE *f = fopen(path, "re");
    bool good = f && fgets(out, (int)cap, f);
    if (f)
        fclose(f);
    if (good)
        out[strcspn(out, "\n")] = 0;
    return good;
}

/* The group of this process in the one tree of version 2: the line "0::/PATH". */
static bool own_group(const char *root, char out[FILE_PATH_CAP])
{
    char path[FILE_PATH_CAP], line[FILE_PATH_CAP];
    bool found = false;
    snprintf(path, sizeof path, "%s/proc/self/cgroup", root);
    FILE *f = fopen(path, "re");
    while (f && !found && fgets(line, sizeof line, f)) {
        found = strncmp(line, "0::/", 4) == 0;
        line[strcspn(line, "\n")] = 0;
        if (found)
            strcpy(out, line + 3);
    }
    if (f)
        fclose(f);
    return found;
}

uint64_t memory_total(const char *root)
{
    const long pages = sysconf(_SC_PHYS_PAGES), size = sysconf(_SC_PAGESIZE);
    uint64_t most = pages > 0 && size > 0 ? (uint64_t)pages * (uint64_t)size : UINT64_MAX;
    char group[FILE_PATH_CAP], path[2 * FILE_PATH_CAP], text[64];
    if (!own_group(root, group))
        return most;
    for (char *end = group + strlen(group); end; end = strrchr(group, '/')) {
        *end = 0;
        snprintf(path, sizeof path, "%s/sys/fs/cgroup%s/memory.max", root, group);
        if (!first_line(path, text, sizeof text) || text[0] < '0' || text[0] > '9')
            continue; // "max", or a root group, which has none
        const uint64_t limit = strtoull(text, NULL, 10);
        most = limit < most ? limit : most;
    }
    return most;
}
