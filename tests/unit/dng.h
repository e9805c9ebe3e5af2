/* dng.h - a raw photograph for tests: DNG of 12 bits, RGGB, uncompressed. */
#ifndef UNIT_DNG_H
#define UNIT_DNG_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum { DNG_BLACK = 256, DNG_WHITE = 4095, DNG_HEAD = 1024, DNG_EXIF = 420 };

struct dng {
    uint8_t *p;         // (dng_bytes) zeroed
    size_t entry, more; // where the next entry goes, and the next value that does not fit into it
};

static inline size_t dng_bytes(int w, int h)
{
    return DNG_HEAD + 2 * (size_t)w * (size_t)h;
}

static inline void dng_put(uint8_t *p, uint32_t v, int bytes)
{
    for (int i = 0; i < bytes; i++)
        p[i] = (uint8_t)(v >> 8 * i);
}

/* type: 1 bytes, 2 text, 3 of 16 bits, 4 of 32 bits, 5 and 10 fractions. */
static inline void dng_tag(struct dng *t, unsigned name, unsigned type, unsigned n,
                           const uint32_t *v)
{
    static const int sizes[] = {0, 1, 1, 2, 4, 8, 0, 0, 0, 0, 8};
    uint8_t *e = t->p + t->entry, *to = e + 8;
    const unsigned words = sizes[type] == 8 ? 2 * n : n;
    const unsigned word = sizes[type] == 8 ? 4 : (unsigned)sizes[type];
    dng_put(e, name, 2);
    dng_put(e + 2, type, 2);
    dng_put(e + 4, n, 4);
    if (words * word > 4) {
        dng_put(to, (uint32_t)t->more, 4);
        to = t->p + t->more;
        t->more += (words * word + 1) / 2 * 2;
    }
    for (unsigned i = 0; i < words; i++)
        dng_put(to + i * word, v[i], (int)word);
    t->entry += 12;
    t->p[8]++;
}

static inline void dng_tag1(struct dng *t, unsigned name, unsigned type, uint32_t v)
{
    dng_tag(t, name, type, 1, &v);
}

/* Everything but the numbers of the sensor. ms: exposure time. */
static inline void dng_head(struct dng *t, int w, int h, int orientation, unsigned ms)
{
    static const uint32_t text[] = {'A', 'c', 'm', 'e', 0}, two[] = {2, 2}, cfa[] = {0, 1, 1, 2};
    static const uint32_t version[] = {1, 4, 0, 0}, neutral[] = {1, 2, 1, 1, 4, 5};
    static const uint32_t matrix[] = {1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1};
    static const uint32_t f_number[] = {28, 10};
    const uint32_t time[] = {ms, 1000};
    memcpy(t->p, "II*\0\x08\0\0", 8);
    t->entry = 10;
    t->more = 512;
    dng_tag1(t, 254, 4, 0);
    dng_tag1(t, 256, 4, (uint32_t)w);
    dng_tag1(t, 257, 4, (uint32_t)h);
    dng_tag1(t, 258, 3, 16);
    dng_tag1(t, 259, 3, 1);
    dng_tag1(t, 262, 3, 32803);
    dng_tag(t, 271, 2, 5, text);
    dng_tag(t, 272, 2, 5, text);
    dng_tag1(t, 273, 4, DNG_HEAD);
    dng_tag1(t, 274, 3, (uint32_t)orientation);
    dng_tag1(t, 277, 3, 1);
    dng_tag1(t, 278, 4, (uint32_t)h);
    dng_tag1(t, 279, 4, 2 * (uint32_t)w * (uint32_t)h);
    dng_tag(t, 33421, 3, 2, two);
    dng_tag(t, 33422, 1, 4, cfa);
    dng_tag1(t, 34665, 4, DNG_EXIF);
    dng_tag(t, 50706, 1, 4, version);
    dng_tag1(t, 50714, 3, DNG_BLACK);
    dng_tag1(t, 50717, 3, DNG_WHITE);
    dng_tag(t, 50721, 10, 9, matrix);
    dng_tag(t, 50728, 5, 3, neutral);
    t->entry = DNG_EXIF + 2;
    dng_tag(t, 33434, 5, 1, time);
    dng_tag(t, 33437, 5, 1, f_number);
    dng_tag1(t, 34855, 3, 200);
    t->p[8] = (uint8_t)(t->p[8] - 3); // they count for their own list
    t->p[DNG_EXIF] = 3;
}

/* The number at x, y for R, G, B, 1 is where green is full; the sensor sees half of red and 4/5 of
 * blue. */
static inline void dng_site(struct dng *t, int w, int x, int y, const double rgb[3])
{
    static const double share[] = {0.5, 1, 0.8};
    const int c = (y & 1) + (x & 1);
    const double v = fmin(rgb[c] * share[c], 1);
    dng_put(t->p + DNG_HEAD + 2 * ((size_t)y * (size_t)w + (size_t)x),
            (uint32_t)lrint(DNG_BLACK + v * (DNG_WHITE - DNG_BLACK)), 2);
}

#endif
