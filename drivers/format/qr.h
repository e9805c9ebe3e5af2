/* qr.h - a text as a QR code on a terminal; the only place that uses the library.
 * thread: any. */
#ifndef FORMAT_QR_H
#define FORMAT_QR_H

#include "core/base/err.h"

#include <stdio.h>

enum { QR_BYTES_MAX = 2953 };

/* White on black in half blocks of UTF-8, with the margin of four modules that the standard asks
 * for, whatever the colours of the terminal are. columns: of the terminal; 0: any.
 * err:  ERR_ARG (no text), ERR_LIMIT (longer than QR_BYTES_MAX; wider than `columns`), ERR_NOMEM.
 *       Errors of the stream are its own. */
MUST_USE err_t qr_print(const char *text, int columns, FILE *f);

#endif
