/* report_page.h - report.html: inputs, choices and results of a job in words and pictures; one page
 * that opens from the disk. firmware/web/sheet.{html,css,js}, between them
 * thumbnails and report.json, from which the page draws itself.
 * thread: one per sheet. */
#ifndef RESULT_REPORT_PAGE_H
#define RESULT_REPORT_PAGE_H

#include "firmware/recon/job_result.h"

#include "drivers/format/file.h"

#define REPORT_PAGE_NAME "report.html"

struct report_page {
    FILE *f;
    char path[FILE_PATH_CAP];
    int n; // pictures so far
};

/* Upper bound of the file. */
uint64_t report_page_bytes(int n_pictures);

/* Begin the file.
 * own:  report_page_close or report_page_discard.
 * err:  ERR_ARG (path too long), ERR_IO, ERR_LIMIT (no space). On error *s is zeroed. */
MUST_USE err_t report_page_open(const char *path, struct report_page *s);

/* The drawing of the scene from a photograph's camera, with the same shape. */
struct report_page_drawing {
    const struct image *display; // (3, h, w) 0..1
    const float *confidence;     // (h, w) 0..1
    const uint8_t *left_out;     // (h, w) 1: the photograph does not count there; NULL: all counts
};

/* Photograph `i` of report.json's "inputs", each once, in any order; beside it, if
 * drawing is not NULL, what the scene shows in its place, how far that is from it, striped where
 * it does not count, and its confidence.
 * err:  ERR_NOMEM, ERR_ARG (shape). */
MUST_USE err_t report_page_picture(struct report_page *s, int i, const struct image8 *photograph,
                                   const struct report_page_drawing *drawing);

/* Finish the file. json: path of report.json.
 * err:  ERR_IO, ERR_LIMIT (no space), ERR_FORMAT (of report.json); then there is no file. */
MUST_USE err_t report_page_close(struct report_page *s, const char *json);

/* Remove what was not closed. Accepts a zeroed sheet. */
void report_page_discard(struct report_page *s);

/* The whole file with the photographs of *j, if they are at hand.
 * err:  as above. */
MUST_USE err_t report_page_write(const char *path, const struct job_result *j, const char *json);

#endif
