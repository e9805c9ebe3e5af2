/* fuzz_zip.h - a sound zip archive around bytes from anyone, whose checksums would stop them. */
#ifndef FUZZ_FUZZ_ZIP_H
#define FUZZ_FUZZ_ZIP_H

#include <stdlib.h>
#include <zip.h>

struct fuzz_member {
    const char *name;
    const void *p;
    size_t n;
};

/* own: free. */
static inline void *fuzz_zip(const struct fuzz_member *m, int n, size_t *bytes)
{
    zip_error_t why;
    zip_source_t *to = zip_source_buffer_create(NULL, 0, 0, &why);
    zip_t *z = zip_open_from_source(to, ZIP_TRUNCATE, &why);
    if (!z)
        abort();
    zip_source_keep(to);
    for (int k = 0; k < n; k++) {
        zip_int64_t i = zip_file_add(z, m[k].name, zip_source_buffer(z, m[k].p, m[k].n, 0), 0);
        if (i < 0 || zip_set_file_compression(z, (zip_uint64_t)i, ZIP_CM_STORE, 0) != 0)
            abort();
    }
    if (zip_close(z) != 0 || zip_source_open(to) != 0)
        abort();
    zip_source_seek(to, 0, SEEK_END);
    *bytes = (size_t)zip_source_tell(to);
    zip_source_seek(to, 0, SEEK_SET);
    void *p = malloc(*bytes + 1);
    if (!p || zip_source_read(to, p, *bytes) != (zip_int64_t)*bytes)
        abort();
    zip_source_close(to);
    zip_source_free(to);
    return p;
}

#endif
