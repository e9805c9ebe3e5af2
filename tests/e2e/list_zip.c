/* list_zip FILE OUT - unpacks every member of a zip archive, whose checksum must be right, says how
 * many there are and writes the last one to OUT. */
#include "drivers/format/zipfile.h"

#include <stdio.h>
#include <stdlib.h>

int main(int argc, char **argv)
{
    struct zipfile z = {0};
    err_t e = argc == 3 ? zipfile_open(argv[1], &z) : err_fail(ERR_ARG, "list_zip FILE OUT");
    const uint64_t n = e ? 0 : zipfile_count(&z);
    for (uint64_t i = 0; i < n && !e; i++) {
        void *p;
        size_t bytes;
        e = zipfile_load(&z, i, SIZE_MAX - 1, &p, &bytes);
        FILE *f = e || i + 1 < n ? NULL : fopen(argv[2], "wb");
        if (f && (fwrite(p, 1, bytes, f) != bytes || fclose(f) != 0))
            e = err_fail(ERR_IO, "%s: not written", argv[2]);
        free(p);
    }
    zipfile_close(&z);
    if (e) {
        fprintf(stderr, "%s\n", err_text());
        return 1;
    }
    printf("%ju\n", (uintmax_t)n);
    return 0;
}
