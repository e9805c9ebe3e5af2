/* board.h - the printed board that gives a rig metres: a grid of tags of the family tag36h11
 * (Olson, "AprilTag: A robust and flexible visual fiducial system", ICRA 2011), as in Kalibr's
 * AprilGrid but without squares between the tags, which join the tags' borders where a photograph
 * is blurred.
 *
 * The place of a tag follows from its id alone, whatever the paper: row id / 24, column id % 24,
 * from the upper left. The unit is the edge of a tag, that is of its black square; tags are 1.25
 * apart. x is right, y down, z away from who looks at the board; the origin is the upper left
 * corner of tag 0. Printed is a rectangle of the grid that begins with tag 0.
 * Pure functions; any thread. */
#ifndef SFM_BOARD_H
#define SFM_BOARD_H

#include <stdbool.h>

enum {
    BOARD_STRIDE = 24,                       // ids from row to row
    BOARD_IDS = BOARD_STRIDE * BOARD_STRIDE, // of the 587 of the family
    BOARD_CELLS = 8,                         // across a tag, its black border included
    BOARD_GAP_CELLS = 2,                     // white between two tags
    BOARD_PITCH_CELLS = BOARD_CELLS + BOARD_GAP_CELLS,
    BOARD_CORNERS = 4 // of a tag
};

#define BOARD_PITCH 1.25

/* A printed board. */
struct board {
    int cols, rows; // 1..BOARD_STRIDE
};

/* Whether the id has a place. */
static inline bool board_has(int id)
{
    return id >= 0 && id < BOARD_IDS;
}

/* Id of the tag in a place. */
static inline int board_id(int col, int row)
{
    return BOARD_STRIDE * row + col;
}

/* Corner 0..3 of a tag: upper left, upper right, lower right, lower left. */
void board_corner(int id, int corner, double out[2]);

/* Width and height of the grid, its outer margins not included. */
void board_size(const struct board *b, double out[2]);

/* Largest grid of tags of `tag` within w x h, all of one unit; false if not even two by two fit. */
bool board_fit(double w, double h, double tag, struct board *out);

#endif
