/* First byte: 0 a whole file; 1 the pickle in an archive that is sound, with a storage of 64 bytes:
 * checksums keep the first kind from getting far. */
#include "drivers/format/checkpoint.h"

#include "tests/fuzz/fuzz_zip.h"

#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* own: free. */
static void *make_archive(const uint8_t *pickle, size_t n, size_t *bytes)
{
    static const float storage[16];
    const struct fuzz_member members[] = {{"a/data.pkl", pickle, n},
                                          {"a/data/0", storage, sizeof storage}};
    return fuzz_zip(members, 2, bytes);
}

static void read_all(const char *path)
{
    struct checkpoint c;
    if (checkpoint_open(path, "encoder.", &c) == OK)
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
