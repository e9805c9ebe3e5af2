#include "firmware/result/pagetext.h"

#include "core/base/base64.h"

#include <string.h>

void pagetext_begin(struct pagetext *t, FILE *f)
{
    t->f = f;
    t->n = 0;
}

static void flush_piece(struct pagetext *t)
{
    char text[sizeof t->piece / 3 * 4];
    const char *end = base64_encode(text, t->piece, t->n);
    fwrite(text, 1, (size_t)(end - text), t->f);
    t->n = 0;
}

void pagetext_put(struct pagetext *t, const void *p, size_t n)
{
    const uint8_t *from = p;
    while (n > 0) {
        size_t room = sizeof t->piece - t->n, take = n < room ? n : room;
        memcpy(t->piece + t->n, from, take);
        t->n += take;
        from += take;
        n -= take;
        if (t->n == sizeof t->piece)
            flush_piece(t);
    }
}

void pagetext_end(struct pagetext *t)
{
    flush_piece(t);
}
