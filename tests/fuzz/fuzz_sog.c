/* First byte: 0 a whole file; 1 the parts of an archive that is sound: meta.json, which ends at the
 * first 0, the length of "p" in two bytes, "p", and "q", which are pictures. What meta.json
 * promises is unpacked and no more. */
#include "drivers/format/sog.h"

#include "core/base/bytes.h"

#include "tests/fuzz/fuzz_zip.h"

#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* own: free. */
static void *make_archive(const uint8_t *data, size_t size, size_t *bytes)
{
    const uint8_t *end = size > 0 ? memchr(data, 0, size) : NULL;
    const size_t text = end ? (size_t)(end - data) : size;
    struct bytes b = bytes_of(data + text, size - text);
    bytes_skip(&b, 1, 1);
    const size_t n = bytes_u16(&b), n_p = n < b.left ? n : b.left;
    const struct fuzz_member members[] = {
        {SOG_META, data, text}, {"p", b.p, n_p}, {"q", b.p + n_p, b.left - n_p}};
    return fuzz_zip(members, 3, bytes);
}

static void read_sog(const struct splats_bytes *file)
{
    struct splats_info info;
    struct gaussians g;
    struct gaussians_report report;
    struct arena a;
    if (sog_format.peek(file, &info) || info.n > 4096)
        return;
    if (arena_init(&a, "fuzz", gaussians_need(info.n, info.degree)))
        return;
    if (sog_format.parse(file, 0, &a, &g, &report) == OK && g.n + report.dropped != info.n)
        abort();
    arena_free(&a);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size < 1 || data[0] > 1)
        return 0;
    size_t n = size - 1;
    void *archive = data[0] == 1 ? make_archive(data + 1, n, &n) : NULL;
    read_sog(&(struct splats_bytes){"/nowhere/input", archive ? archive : data + 1, n});
    free(archive);
    return 0;
}
