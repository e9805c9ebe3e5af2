/* texture.h - procedural surface colours in many scales: noise, brick, wood, tiles, fabric, print.
 * Evaluated at a point with the width of the pixel's footprint: detail finer than that is faded
 * out, so that one sample per pixel does not flicker.
 * Pure functions; any thread. */
#ifndef WORLD_TEXTURE_H
#define WORLD_TEXTURE_H

#include <stdint.h>

enum texture_kind {
    TEXTURE_FLAT,
    TEXTURE_NOISE,   // sums of noise in octaves, two or three colours: plaster, stone, marble
    TEXTURE_CHECKER, // with dirt noise
    TEXTURE_BRICK,   // bricks, mortar, every brick its own shade
    TEXTURE_TILES,   // tiles of random colours or small motifs
    TEXTURE_WOOD,    // planks, rings and fibres
    TEXTURE_FABRIC,  // weave and stripes
    TEXTURE_PRINT,   // lines of letter-like strokes and blocks, as on paper and posters
    TEXTURE_SPOTS,   // cells of random size and colour: terrazzo, gravel, leaves
    TEXTURE_KINDS
};

/* A picture of black and white cells instead: x right, y down in the frame of the solid, its middle
 * at 0; white beyond. */
struct texture_cells {
    int cols, rows;
    const unsigned char *black; // (rows, cols) 1 or 0
    float size;                 // m, edge of a cell
};

struct texture {
    const struct texture_cells *cells; // NULL: none, the pattern counts
    enum texture_kind kind;
    uint32_t seed;
    float scale;        // m, size of the largest feature, > 0
    float contrast;     // 0..1 of the fine structure
    float colour[3][3]; // linear reflectance, 0..1; of cells: white, black
};

/* Reflectance at p, m, in the solid's frame, of a surface with normal n (unit, same frame; chooses
 * the plane that two-dimensional patterns lie in). footprint: m, > 0.
 * out:  0.005..0.95 */
void texture_eval(const struct texture *t, const float p[3], const float n[3], float footprint,
                  float out[3]);

#endif
