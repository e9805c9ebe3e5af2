#include "core/sfm/board.h"

#include "core/base/num.h"

#include <math.h>

static const double SLACK = 1e-9; // tags; of rounding

void board_corner(int id, int corner, double out[2])
{
    const int right = corner == 1 || corner == 2, low = corner >= 2;
    out[0] = BOARD_PITCH * (id % BOARD_STRIDE) + right;
    out[1] = BOARD_PITCH * (id / BOARD_STRIDE) + low;
}

void board_size(const struct board *b, double out[2])
{
    out[0] = BOARD_PITCH * (b->cols - 1) + 1;
    out[1] = BOARD_PITCH * (b->rows - 1) + 1;
}

/* Tags side by side within a length. */
static int fit_length(double length)
{
    const double n = floor((length - 1) / BOARD_PITCH + SLACK) + 1;
    return n < 1 ? 0 : (int)fmin(n, BOARD_STRIDE);
}

bool board_fit(double w, double h, double tag, struct board *out)
{
    out->cols = fit_length(w / tag);
    out->rows = fit_length(h / tag);
    return num_min(out->cols, out->rows) >= 2;
}
