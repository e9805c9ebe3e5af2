/* tmpdir.h - a folder of its own for a test, removed with everything in it.
 * thread: one test program has one folder at a time. */
#ifndef UNIT_TMPDIR_H
#define UNIT_TMPDIR_H

#include <ftw.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

static char tmpdir_root[64];

static inline void tmpdir_make(void)
{
    snprintf(tmpdir_root, sizeof tmpdir_root, "%s/hdrig-test-XXXXXX", P_tmpdir);
    if (!mkdtemp(tmpdir_root))
        abort();
}

static inline int tmpdir_forget(const char *path, const struct stat *st, int flag, struct FTW *at)
{
    (void)st;
    (void)flag;
    (void)at;
    return remove(path);
}

static inline void tmpdir_remove(void)
{
    nftw(tmpdir_root, tmpdir_forget, 8, FTW_DEPTH | FTW_PHYS);
}

/* For cmocka's groups. */
static inline int tmpdir_setup(void **state)
{
    (void)state;
    tmpdir_make();
    return 0;
}

static inline int tmpdir_teardown(void **state)
{
    (void)state;
    tmpdir_remove();
    return 0;
}

/* Path of a name in the folder; one of eight buffers in turn. */
static inline const char *tmpdir_path(const char *name)
{
    static char path[8][512];
    static int turn;
    char *p = path[turn++ % 8];
    snprintf(p, sizeof path[0], "%s/%s", tmpdir_root, name);
    return p;
}

static inline const char *tmpdir_mkdir(const char *name)
{
    const char *path = tmpdir_path(name);
    if (mkdir(path, 0777) != 0)
        abort();
    return path;
}

static inline const char *tmpdir_write(const char *name, const void *bytes, size_t n)
{
    const char *path = tmpdir_path(name);
    FILE *f = fopen(path, "wb");
    if (!f || fwrite(bytes, 1, n, f) != n || fclose(f) != 0)
        abort();
    return path;
}

static inline const char *tmpdir_text(const char *name, const char *text)
{
    return tmpdir_write(name, text, strlen(text));
}

#endif
