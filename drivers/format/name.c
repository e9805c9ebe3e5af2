#include "drivers/format/name.h"

#include <string.h>

size_t name_utf8(const char *text, size_t left)
{
    static const uint32_t least[] = {0, 0, 0x80, 0x800, 0x10000};
    const unsigned char *s = (const unsigned char *)text;
    if (s[0] < 0x80)
        return 1;
    size_t n = s[0] >= 0xf0 ? 4 : s[0] >= 0xe0 ? 3 : 2;
    if (s[0] < 0xc2 || s[0] > 0xf4 || n > left)
        return 0;
    uint32_t c = s[0] & (0xffu >> (n + 1));
    for (size_t i = 1; i < n; i++) {
        if ((s[i] & 0xc0) != 0x80)
            return 0;
        c = c << 6 | (s[i] & 0x3fu);
    }
    return c < least[n] || c > 0x10ffff || (c >= 0xd800 && c <= 0xdfff) ? 0 : n;
}

err_t name_copy(const char *what, const char *text, size_t n, char out[NAME_CAP])
{
    out[0] = 0;
    if (n == 0 || n >= NAME_CAP)
        return err_fail(ERR_FORMAT, "%s: a name of %zu bytes (%.40s), allowed are 1 to %d", what, n,
                        n ? text : "", NAME_CAP - 1);
    for (size_t i = 0, step; i < n; i += step) {
        step = name_utf8(text + i, n - i);
        unsigned char c = (unsigned char)text[i];
        if (step == 0 || c == '/' || c < 0x20 || c == 0x7f)
            return err_fail(ERR_FORMAT,
                            "%s: byte %zu of a name is 0x%02x: slashes, control characters and "
                            "broken UTF-8 are refused",
                            what, i, c);
    }
    if ((n == 1 && text[0] == '.') || (n == 2 && text[0] == '.' && text[1] == '.'))
        return err_fail(ERR_FORMAT, "%s: \"%.*s\" is a folder, not a name", what, (int)n, text);
    memcpy(out, text, n);
    out[n] = 0;
    return OK;
}

err_t name_of_path(const char *what, const char *path, size_t n, bool folder, char out[NAME_CAP])
{
    const char *slash = memrchr(path, '/', n);
    const char *above = slash ? memrchr(path, '/', (size_t)(slash - path)) : NULL;
    const char *from = !slash ? path : !folder ? slash + 1 : above ? above + 1 : path;
    const size_t left = n - (size_t)(from - path);
    char joined[NAME_CAP];
    if (!folder || !slash || left >= NAME_CAP)
        return name_copy(what, from, left, out);
    memcpy(joined, from, left);
    joined[slash - from] = '_';
    return name_copy(what, joined, left, out);
}

static bool is_digit(char c)
{
    return c >= '0' && c <= '9';
}

size_t name_view(const char *name)
{
    const char *dot = strrchr(name, '.');
    size_t n = dot && dot != name ? (size_t)(dot - name) : strlen(name), cut = n;
    while (cut > 0 && is_digit(name[cut - 1]))
        cut--;
    bool numbered = cut < n && cut >= 2 && name[cut - 1] == '_' && is_digit(name[cut - 2]);
    return numbered ? cut - 1 : n;
}

bool name_same_view(const char *a, const char *b)
{
    size_t n = name_view(a);
    return n == name_view(b) && memcmp(a, b, n) == 0;
}
