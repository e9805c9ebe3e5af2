#include "drivers/format/origin.h"

#include "drivers/format/file.h"

#include <errno.h>
#include <string.h>
#include <sys/stat.h>

enum { HEAD_BYTES = 1 << 16 }; // the mark is in this many first bytes

/* A kind of file: how it begins, and the mark behind that. */
static const struct mark {
    size_t at;
    const char *magic, *mark;
} marks[] = {
    {0, "{", "\"generator\": \"" ORIGIN_GENERATOR "\""}, // reports
    {0, "{", "\"format\": \"hdrig-sidecar\""},           // sidecar.h
    {8, "{\"__metadata__\":{\"format\":\"hdrig-", ""},   // scenefile.h, modelfile.h
    {0, "ply\n", "\ncomment ihdr "},                     // ply.h
    {0, "glTF", "\"generator\":\"hdrig\""},              // glb.h
    {0, "\x1f\x8b", ORIGIN_COMMENT},                     // .spz, version 3
    {0, "NGSP", "\x01\x00\x44\x48"},                     // .spz, version 4: SPZ_RADIANCE
    {0, "<!doctype html>",
     "<meta name=\"generator\" content=\"" ORIGIN_GENERATOR "\">"}, // viewer.h
    {4, "ftyp", ORIGIN_COMMENT},                                    // video.h
    {0, "# measured by hdrig calibrate\n", ""},                     // calib.h
    {0, "hdrig checkpoint", ""},                                    // firmware/result/resume.h
    {0, "%PDF-1.4\n% " ORIGIN_COMMENT "\n", ""},                    // boardpdf.h
};

static bool is_marked(const char *head, size_t n)
{
    for (size_t i = 0; i < sizeof marks / sizeof marks[0]; i++) {
        const struct mark *m = &marks[i];
        size_t from = m->at + strlen(m->magic);
        if (n >= from && memcmp(head + m->at, m->magic, strlen(m->magic)) == 0 &&
            memmem(head + from, n - from, m->mark, strlen(m->mark)))
            return true;
    }
    return false;
}

err_t origin_check_place(const char *path)
{
    char head[HEAD_BYTES];
    struct stat st;
    if (lstat(path, &st) != 0)
        return errno == ENOENT ? OK
                               : err_fail(errno == ENAMETOOLONG ? ERR_ARG : ERR_IO, "%.255s: %s",
                                          path, strerror(errno));
    if (!S_ISREG(st.st_mode))
        return err_fail(ERR_ARG, "%s: already exists and is not a regular file", path);
    if (st.st_size == 0)
        return OK;
    FILE *f = fopen(path, "rbe");
    size_t n = f ? fread(head, 1, sizeof head, f) : 0;
    if (f)
        fclose(f);
    if (is_marked(head, n))
        return OK;
    return err_fail(ERR_ARG,
                    "%s: already exists and was not written by hdrig: choose another name, or "
                    "move it away",
                    path);
}
