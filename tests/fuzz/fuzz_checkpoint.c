/* First byte: 0 a whole file; 1 the pickle in an archive that is sound, with a storage of 64 bytes:
 * checksums keep the first kind from getting far. */
#include "drivers/format/checkpoint.h"

#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>
#include <zip.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void add(zip_t *z, const char *name, const void *p, size_t n)
{
    zip_int64_t i = zip_file_add(z, name, zip_source_buffer(z, p, n, 0), 0);
    if (i < 0 || zip_set_file_compression(z, (zip_uint64_t)i, ZIP_CM_STORE, 0) != 0)
        abort();
}

/* The archive in memory; own: free. */
static void *make_archive(const uint8_t *pickle, size_t n, size_t *bytes)
{
    static const float storage[16];
    zip_error_t why;
    zip_source_t *to = zip_source_buffer_create(NULL, 0, 0, &why);
    zip_t *z = zip_open_from_source(to, ZIP_TRUNCATE, &why);
    if (!z)
        abort();
    zip_source_keep(to);
    add(z, "a/data.pkl", pickle, n);
    add(z, "a/data/0", storage, sizeof storage);
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

static void read_all(const char *path)
{
    struct checkpoint c;
    if (checkpoint_open(path, &c) == OK)
        for (int i = 0; i < c.n; i++) {
            size_t n = checkpoint_count(&c.tensors[i]);
            float *out = n <= 1 << 16 ? malloc((n + 1) * sizeof *out) : NULL;
            if (checkpoint_find(&c, c.tensors[i].name) != &c.tensors[i])
                abort();
            err_t e = out ? checkpoint_read(&c, &c.tensors[i], out) : OK;
            (void)e;
            free(out);
        }
    checkpoint_close(&c);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    char path[64];
    if (size < 1 || data[0] > 1)
        return 0;
    size_t n = size - 1;
    void *archive = data[0] == 1 ? make_archive(data + 1, n, &n) : NULL;
    int fd = memfd_create("input", 0);
    if (fd < 0 || write(fd, archive ? archive : data + 1, n) != (ssize_t)n)
        abort();
    snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
    read_all(path);
    close(fd);
    free(archive);
    return 0;
}
