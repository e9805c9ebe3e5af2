/* boardpdf.h - the board of core/sfm/board.h as a PDF to print: one page of PDF 1.4 (ISO 32000-1),
 * vector squares, a ruler of 100 mm that shows whether the printer scaled it, and a line of text.
 * The same request gives the same bytes.
 * thread: any. */
#ifndef FORMAT_BOARDPDF_H
#define FORMAT_BOARDPDF_H

#include "core/base/err.h"
#include "core/sfm/board.h"

struct boardpdf {
    const char *paper; // name, as asked for
    double w, h;       // mm of the page, landscape
    double tag;        // mm, edge of a tag
    struct board board;
};

#define BOARDPDF_PAPERS "a4, a3 or letter"
#define BOARDPDF_TAG_MIN 10.0 // mm

/* Choose the grid for a paper. tag: mm; 0: the largest whole number with which six by four fit.
 * err:  ERR_ARG (a paper that is not known, tags that do not fit or are too small). */
MUST_USE err_t boardpdf_choose(const char *paper, double tag, struct boardpdf *out);

/* err:  those of file_create and file_finish, ERR_NOMEM. */
MUST_USE err_t boardpdf_write(const char *path, const struct boardpdf *b);

#endif
