/* plyrows.h - rows of numbers of a PLY file, as text or binary of either byte order: one after the
 * other, and from the start again for one that is behind.
 * thread: one per struct. */
#ifndef FORMAT_PLYROWS_H
#define FORMAT_PLYROWS_H

#include "core/base/err.h"

#include <stddef.h>
#include <stdint.h>

enum {
    PLYROWS_CELLS_MAX = 512,
    PLYROWS_BYTES_MAX = 8 * PLYROWS_CELLS_MAX,
    PLYROWS_TYPE_FLOAT = 0, // names of a type come in pairs, this is the first one's number
    PLYROWS_TYPE_USHORT = 2
};

enum plyrows_kind { PLYROWS_ASCII, PLYROWS_LITTLE, PLYROWS_BIG };

/* Number of the type of this name, -1 if there is none; its name, and its bytes. */
int plyrows_type(const char *name);
const char *plyrows_type_name(int type);
size_t plyrows_type_bytes(int type);

struct plyrows {
    const char *what; // begins the sentence
    enum plyrows_kind kind;
    const uint8_t *p; // the rows, not owned
    size_t bytes;     // from there to the end of the file
    int n, n_cells;   // rows, numbers in each
    size_t row;       // bytes of a binary one
    int type[PLYROWS_CELLS_MAX];

    int at;      // row in `now`, -1: none yet
    size_t next; // text: where the row behind it begins
    uint8_t now[PLYROWS_BYTES_MAX];
};

/* Refuse rows that are not all there: of binary ones by their size, of text by reading it.
 * err:  ERR_FORMAT: what is no number, or not between 0 and 65535 where that is its type. */
MUST_USE err_t plyrows_check(struct plyrows *r);

/* Row i of a file that has been checked, little-endian; text has only numbers of the two types that
 * have a name here, the others are 0. Valid until the next call. */
const uint8_t *plyrows_get(struct plyrows *r, int i);

#endif
