/* The header of a weights file; the first four bytes say how many zeros follow as its data. */
#include "drivers/format/modelfile.h"

#include "core/base/bytes.h"

#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

enum { DATA_MAX = 4 << 20 };

/* Every byte that a network would read is there. */
static void read_all(const struct modelfile *m)
{
    volatile uint8_t sink = 0;
    for (int i = 0; i < m->model.n; i++) {
        const struct model_tensor *t = &m->model.tensors[i];
        const struct safetensors_tensor s = modelfile_stored(&t->spec, m->model.precision);
        size_t n = t->type == PRECISION_F32 ? 4 : t->type == PRECISION_BF16 ? 2 : 1;
        for (int k = 0; k < s.rank; k++)
            n *= s.shape[k];
        sink = ((const uint8_t *)t->data)[n - 1];
        if (t->type == PRECISION_S8)
            sink = ((const uint8_t *)(t->scale + table_product(&t->spec).n))[-1];
        if (model_find(&m->model, t->spec.name) != t)
            abort();
    }
    (void)sink;
    if (modelfile_verify(m) == OK && strlen(m->checksum) != 16)
        abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct bytes b = bytes_of(data, size);
    size_t zeros = bytes_u32(&b);
    if (b.bad || zeros > DATA_MAX)
        return 0;
    size_t header = (8 + b.left + 63) / 64 * 64, n = header + zeros;
    uint8_t *p = aligned_alloc(64, (n + 63) / 64 * 64);
    memset(p, ' ', header);
    memset(p + header, 0, (n + 63) / 64 * 64 - header);
    bytes_put_u64(p, header - 8);
    memcpy(p + 8, b.p, b.left);
    struct modelfile m;
    if (modelfile_open_bytes("input", p, n, &m) == OK)
        read_all(&m);
    modelfile_close(&m);
    free(p);
    return 0;
}
