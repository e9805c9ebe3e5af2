#include "core/base/bytes.h"

#include <string.h>

struct bytes bytes_of(const void *p, size_t n)
{
    return (struct bytes){p, n, false};
}

const uint8_t *bytes_take(struct bytes *b, size_t n)
{
    if (b->bad || n > b->left) {
        b->bad = true;
        return NULL;
    }
    const uint8_t *p = b->p;
    if (n > 0)
        b->p += n;
    b->left -= n;
    return p;
}

void bytes_skip(struct bytes *b, size_t n, size_t elem)
{
    size_t size;
    if (bytes_mul(n, elem, &size))
        (void)bytes_take(b, size);
    else
        b->bad = true;
}

static uint64_t read_little(struct bytes *b, size_t n)
{
    const uint8_t *p = bytes_take(b, n);
    uint64_t v = 0;
    for (size_t i = 0; p && i < n; i++)
        v |= (uint64_t)p[i] << (8 * i);
    return v;
}

uint8_t bytes_u8(struct bytes *b)
{
    return (uint8_t)read_little(b, 1);
}

uint16_t bytes_u16(struct bytes *b)
{
    return (uint16_t)read_little(b, 2);
}

uint32_t bytes_u32(struct bytes *b)
{
    return (uint32_t)read_little(b, 4);
}

uint64_t bytes_u64(struct bytes *b)
{
    return read_little(b, 8);
}

float bytes_f32(struct bytes *b)
{
    uint32_t u = bytes_u32(b);
    float v;
    memcpy(&v, &u, sizeof v);
    return v;
}

double bytes_f64(struct bytes *b)
{
    uint64_t u = bytes_u64(b);
    double v;
    memcpy(&v, &u, sizeof v);
    return v;
}

static uint8_t *put_little(uint8_t *p, uint64_t v, int n)
{
    for (int i = 0; i < n; i++)
        p[i] = (uint8_t)(v >> (8 * i));
    return p + n;
}

uint8_t *bytes_put_u16(uint8_t *p, uint16_t v)
{
    return put_little(p, v, 2);
}

uint8_t *bytes_put_u32(uint8_t *p, uint32_t v)
{
    return put_little(p, v, 4);
}

uint8_t *bytes_put_u64(uint8_t *p, uint64_t v)
{
    return put_little(p, v, 8);
}

uint8_t *bytes_put_f32(uint8_t *p, float v)
{
    uint32_t u;
    memcpy(&u, &v, sizeof u);
    return bytes_put_u32(p, u);
}

bool bytes_mul(size_t a, size_t b, size_t *out)
{
    bool fits = !__builtin_mul_overflow(a, b, out);
    if (!fits)
        *out = SIZE_MAX;
    return fits;
}

bool bytes_add(size_t a, size_t b, size_t *out)
{
    bool fits = !__builtin_add_overflow(a, b, out);
    if (!fits)
        *out = SIZE_MAX;
    return fits;
}
