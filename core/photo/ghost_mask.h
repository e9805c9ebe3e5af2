/* ghost_mask.h - where a frame of a bracket shows something else than the others: found by ghost.h,
 * left out by merge.h. Pure; any thread. */
#ifndef PHOTO_GHOST_MASK_H
#define PHOTO_GHOST_MASK_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

/* Where a frame differs from the reference, in square cells of the reference's picture; those at
 * the right and at the bottom may be cut. */
struct ghost_mask {
    int cell, cols, rows; // px; of cells
    uint8_t *moved;       // (rows, cols) 1: differs
    double share;         // of the cells
    float shift[2];       // px, right and down, of the frame to the reference
};

/* Whether the frame's pixel x, y shows something else than the reference. */
static inline bool ghost_mask_at(const struct ghost_mask *m, int x, int y)
{
    const int u = (x - (int)lrintf(m->shift[0])) / m->cell;
    const int v = (y - (int)lrintf(m->shift[1])) / m->cell;
    return u >= 0 && v >= 0 && u < m->cols && v < m->rows && m->moved[v * m->cols + u];
}

#endif
