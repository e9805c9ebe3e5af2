#include "core/stereo/speck.h"

#include <math.h>
#include <stdbool.h>

enum { SIDES = 4 };

static const float ALIKE = 0.03f; // relative difference of depths within a piece

/* Pixels that were visited have a negative confidence. */

/* Add the pixels around number k of the piece that belong to it. */
static int add_around(const struct speck_map *m, int k, int n)
{
    const int at = m->list[k], x = at % m->w, y = at / m->w;
    const int next[SIDES] = {x > 0 ? at - 1 : at, x < m->w - 1 ? at + 1 : at,
                             y > 0 ? at - m->w : at, y < m->h - 1 ? at + m->w : at};
    for (int i = 0; i < SIDES; i++) {
        const int to = next[i];
        if (m->conf[to] < m->usable || fabsf(m->depth[to] - m->depth[at]) > ALIKE * m->depth[at])
            continue;
        m->conf[to] = -m->conf[to];
        m->list[n++] = to;
    }
    return n;
}

/* The piece of this pixel; its number of pixels, and whether it is a speck. */
static int find_piece(const struct speck_map *m, int first, bool *speck)
{
    int n = 1;
    float most = 0;
    m->list[0] = first;
    m->conf[first] = -m->conf[first];
    for (int k = 0; k < n; k++) {
        n = add_around(m, k, n);
        most = fmaxf(most, -m->conf[m->list[k]]);
    }
    *speck = n < m->least && most < m->confirmed;
    return n;
}

int speck_drop(const struct speck_map *m)
{
    int dropped = 0;
    for (int i = 0; i < m->w * m->h; i++) {
        bool speck;
        if (m->conf[i] < m->usable)
            continue;
        const int n = find_piece(m, i, &speck);
        for (int k = 0; k < n && speck; k++)
            m->conf[m->list[k]] = 0;
        dropped += speck ? n : 0;
    }
    for (int i = 0; i < m->w * m->h; i++)
        m->conf[i] = fabsf(m->conf[i]);
    return dropped;
}
