#include "drivers/format/suffix.h"

#include <stddef.h>
#include <string.h>
#include <strings.h>

static bool has_one_of(const char *name, const char *const *suffix)
{
    const size_t n = strlen(name);
    for (; name[0] != '.' && *suffix; suffix++) {
        const size_t k = strlen(*suffix);
        if (n > k && strcasecmp(name + n - k, *suffix) == 0)
            return true;
    }
    return false;
}

bool suffix_is_picture(const char *name)
{
    static const char *const suffix[] = {".png", ".jpg", ".jpeg", ".tif", ".tiff", NULL};
    return has_one_of(name, suffix);
}

bool suffix_is_heic(const char *name)
{
    static const char *const suffix[] = {".heic", ".heif", NULL};
    return has_one_of(name, suffix);
}

bool suffix_is_raw(const char *name)
{
    static const char *const suffix[] = {".dng", ".cr2", ".nef", ".arw", NULL};
    return has_one_of(name, suffix);
}

bool suffix_is_exr(const char *name)
{
    static const char *const suffix[] = {".exr", NULL};
    return has_one_of(name, suffix);
}

bool suffix_is_other(const char *name)
{
    static const char *const suffix[] = {
        ".heic", ".heif", ".avif", ".webp", ".bmp", ".gif", ".jxl", ".jp2", ".ppm", ".pnm",
        ".exr",  ".hdr",  ".dng",  ".raw",  ".arw", ".cr2", ".cr3", ".crw", ".nef", ".orf",
        ".pef",  ".raf",  ".rw2",  ".srw",  ".x3f", ".mp4", ".mov", ".avi", ".mkv", NULL};
    return has_one_of(name, suffix);
}
