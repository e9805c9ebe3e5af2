#include "core/base/err.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

static _Thread_local char err_sentence[512];

err_t err_fail(err_t code, const char *fmt, ...)
{
    char text[sizeof err_sentence];
    va_list ap;
    va_start(ap, fmt);
    vsnprintf(text, sizeof text, fmt, ap);
    va_end(ap);
    memcpy(err_sentence, text, sizeof text);
    return code;
}

const char *err_text(void)
{
    return err_sentence;
}
