/* sheet.h - report.html: what was photographed, what was modelled and why, in words and pictures;
 * one page that opens from the disk. firmware/web/sheet.{html,css,js} with report.json, thumbnails
 * and curves behind them.
 * thread: any. */
#ifndef FIRMWARE_SHEET_H
#define FIRMWARE_SHEET_H

#include "firmware/job.h"

/* Upper bound of the file. */
uint64_t sheet_bytes(const struct job_result *j);

/* json: the text of report.json.
 * err:  ERR_IO, ERR_LIMIT (no space), ERR_NOMEM. The partial file is removed. */
MUST_USE err_t sheet_write(const char *path, const struct job_result *j, const char *json);

#endif
