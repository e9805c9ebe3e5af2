/* ISO/IEC 18004 by libqrencode, lowest level of correction: a screen has no scratches. */
#include "drivers/format/qr.h"

#include <errno.h>
#include <qrencode.h>
#include <stdbool.h>
#include <string.h>

enum { MARGIN = 4 };

static bool is_dark(const QRcode *q, int x, int y)
{
    return x >= 0 && y >= 0 && x < q->width && y < q->width && (q->data[y * q->width + x] & 1);
}

/* Two rows of modules in one line; light ones have the colour of letters. */
static void print_rows(const QRcode *q, int y, FILE *f)
{
    static const char *const block[] = {"\xe2\x96\x88", "\xe2\x96\x84", "\xe2\x96\x80", " "};
    fputs("\033[40;37;1m", f);
    for (int x = -MARGIN; x < q->width + MARGIN; x++)
        fputs(block[is_dark(q, x, y) + 2 * is_dark(q, x, y + 1)], f);
    fputs("\033[0m\n", f);
}

err_t qr_print(const char *text, int columns, FILE *f)
{
    const size_t n = strlen(text);
    if (n == 0)
        return err_fail(ERR_ARG, "QR code: no text");
    if (n > QR_BYTES_MAX)
        return err_fail(ERR_LIMIT, "QR code: %zu bytes, at most %d", n, QR_BYTES_MAX);
    QRcode *q = QRcode_encodeData((int)n, (const unsigned char *)text, 0, QR_ECLEVEL_L);
    if (!q)
        return err_fail(ERR_NOMEM, "QR code: %s", strerror(errno));
    const int wide = q->width + 2 * MARGIN;
    if (columns > 0 && wide > columns) {
        QRcode_free(q);
        return err_fail(ERR_LIMIT, "the QR code needs %d columns, this terminal has %d", wide,
                        columns);
    }
    for (int y = -MARGIN; y < q->width + MARGIN; y += 2)
        print_rows(q, y, f);
    QRcode_free(q);
    return OK;
}
