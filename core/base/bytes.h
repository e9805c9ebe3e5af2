/* bytes.h - little-endian numbers out of and into bytes that came from outside.
 * A cursor never reads past its end: a read that does not fit returns 0, sets `bad` and leaves the
 * cursor bad, so a parser may read a whole record and check once. Pure computation.
 * thread: any; a cursor belongs to one thread. */
#ifndef BASE_BYTES_H
#define BASE_BYTES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct bytes {
    const uint8_t *p; // next byte; not owned
    size_t left;      // bytes from p to the end
    bool bad;         // some read did not fit
};

/* Cursor over n bytes at p; p may be NULL if n is 0. */
struct bytes bytes_of(const void *p, size_t n);

uint8_t bytes_u8(struct bytes *b);
uint16_t bytes_u16(struct bytes *b);
uint32_t bytes_u32(struct bytes *b);
uint64_t bytes_u64(struct bytes *b);
float bytes_f32(struct bytes *b);
double bytes_f64(struct bytes *b);

/* returns: the next n bytes in place, which the cursor skips; NULL and `bad` if fewer are left. */
const uint8_t *bytes_take(struct bytes *b, size_t n);

/* Step over n elements of `elem` bytes; `bad` if the product overflows or fewer are left. */
void bytes_skip(struct bytes *b, size_t n, size_t elem);

/* Store at p. returns: the position after it. */
uint8_t *bytes_put_u16(uint8_t *p, uint16_t v);
uint8_t *bytes_put_u32(uint8_t *p, uint32_t v);
uint8_t *bytes_put_u64(uint8_t *p, uint64_t v);
uint8_t *bytes_put_f32(uint8_t *p, float v);

/* *out = a * b or a + b; false, and *out = SIZE_MAX, if that overflows. */
bool bytes_mul(size_t a, size_t b, size_t *out);
bool bytes_add(size_t a, size_t b, size_t *out);

#endif
