/* Names of the files that a take and a staging folder have. */
#include "firmware/store/store_inner.h"

#include <string.h>

/* Zeros stand for digits: two or three of the camera, then two of the exposure. */
static bool fits_pattern(const char *pattern, const char *name)
{
    const size_t head = strcspn(pattern, "0");
    if (strncmp(pattern, name, head) != 0 || !pattern[head])
        return strcmp(pattern, name) == 0;
    const size_t digits = strspn(name + head, "0123456789");
    const char *a = pattern + head + 2, *b = name + head + digits;
    for (; *a && (*a == *b || (*a == '0' && *b >= '0' && *b <= '9')); a++, b++)
        ;
    return (digits == 2 || digits == 3) && !*a && !*b;
}

bool store_files_of_take(const char *name)
{
    static const char *const names[] = {MANIFEST_FILE,
                                        "exposure.json",
                                        "raw",
                                        "images",
                                        "merged",
                                        "raw/00_00.bin",
                                        "raw/00_00.jpg",
                                        "merged/00.exr",
                                        "masks",
                                        "masks/train_00_00.png",
                                        "thumbs",
                                        "thumbs/train_00_00.jpg",
                                        "images/train_00_00.png",
                                        "images/train_00_00.jpg"};
    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++)
        if (fits_pattern(names[i], name))
            return true;
    return false;
}

bool store_files_of_staging(const char *name)
{
    char member[TAKE_MEMBER_CAP], file[MANIFEST_NAME_CAP];
    size_t n = strcspn(name, "/"), end = sizeof STORE_RIG_PART - 1;
    if (strcmp(name, STORE_RIG_ORDER) == 0 || strcmp(name, STORE_RIG_BOOT) == 0)
        return true;
    if (n >= sizeof member)
        return false;
    memcpy(member, name, n);
    member[n] = 0;
    if (!manifest_is_member(member) || !name[n])
        return manifest_is_member(member);
    size_t k = strlen(name += n + 1);
    if (k >= sizeof file)
        return false;
    memcpy(file, name, k + 1);
    if (k > end && strcmp(file + k - end, STORE_RIG_PART) == 0)
        file[k - end] = 0;
    return store_files_of_take(file);
}
