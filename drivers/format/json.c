#include "drivers/format/json.h"

#include "drivers/format/file.h"
#include "drivers/format/name.h"

#include <cjson/cJSON.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* Describe the error at `at` of a text. */
static err_t refuse_text(const char *what, const char *text, const char *at)
{
    static const char *const no_number[] = {"nan", "-nan", "inf", "-inf"};
    const char *hint = *at == '/' ? ": a fraction is written as a decimal number" : "";
    int line = 1;
    if (at[strspn(at, " \t\r\n")] == 0) {
        const char *last = at;
        while (last > text && strchr(" \t\r\n", last[-1]))
            last--;
        if (last == text || !strchr("}]", last[-1]))
            return err_fail(ERR_FORMAT, "%s: not JSON, or cut short: ends after %td bytes", what,
                            last - text);
        at = last - 1;
    }
    for (const char *p = text; p < at; p++)
        line += *p == '\n';
    for (size_t i = 0; i < sizeof no_number / sizeof no_number[0]; i++)
        if (strncasecmp(at, no_number[i], strlen(no_number[i])) == 0)
            hint = ": JSON has finite numbers only";
    int n = 0;
    while (n < 24 && at[n] >= ' ' && at[n] < 0x7f) // printable in a terminal and in JSON
        n++;
    return err_fail(ERR_FORMAT, "%s: line %d: not JSON from \"%.*s\" on%s", what, line, n, at,
                    hint);
}

err_t json_parse(const char *what, const void *text, size_t n, struct cJSON **out)
{
    *out = NULL;
    if (n > JSON_BYTES_MAX)
        return err_fail(ERR_FORMAT, "%s: %zu bytes of JSON, at most %d are read", what, n,
                        JSON_BYTES_MAX);
    char *copy =
        malloc(n + 1); // cJSON before 1.7.18 looks one byte past a text without terminating 0
    if (!copy)
        return err_fail(ERR_NOMEM, "%s: no memory for %zu bytes of JSON", what, n);
    if (n > 0)
        memcpy(copy, text, n);
    copy[n] = 0;
    const char *end = copy;
    const char *zero = memchr(copy, 0, n);
    struct cJSON *doc = zero ? NULL : cJSON_ParseWithLengthOpts(copy, n + 1, &end, 1);
    err_t e = doc    ? OK
              : zero ? err_fail(ERR_FORMAT, "%s: not JSON: byte %td is 0", what, zero - copy)
                     : refuse_text(what, copy, end >= copy && end <= copy + n ? end : copy + n);
    free(copy);
    *out = doc;
    return e;
}

err_t json_read(const char *path, struct cJSON **out)
{
    struct file_map m;
    *out = NULL;
    err_t e = file_map(path, JSON_BYTES_MAX, &m);
    if (e)
        return e;
    e = json_parse(path, m.p, m.n, out);
    file_unmap(&m);
    return e;
}

static err_t take_and_free(const char *what, struct cJSON *doc, json_take_fn *take, void *out)
{
    err_t e = take(what, doc, out);
    json_free(doc);
    return e;
}

err_t json_parse_with(const char *what, const void *text, size_t n, json_take_fn *take, void *out)
{
    struct cJSON *doc;
    err_t e = json_parse(what, text, n, &doc);
    return e ? e : take_and_free(what, doc, take, out);
}

err_t json_read_with(const char *path, json_take_fn *take, void *out)
{
    struct cJSON *doc;
    err_t e = json_read(path, &doc);
    return e ? e : take_and_free(path, doc, take, out);
}

void json_free(struct cJSON *doc)
{
    cJSON_Delete(doc);
}

bool json_is_object(const struct cJSON *node)
{
    return cJSON_IsObject(node);
}

bool json_is_array(const struct cJSON *node)
{
    return cJSON_IsArray(node);
}

const struct cJSON *json_first(const struct cJSON *node)
{
    return node->child;
}

const struct cJSON *json_next(const struct cJSON *node)
{
    return node->next;
}

int json_count(const struct cJSON *node)
{
    return cJSON_GetArraySize(node);
}

const char *json_key(const struct cJSON *node)
{
    return node->string ? node->string : "";
}

const struct cJSON *json_member(const struct cJSON *object, const char *key)
{
    return cJSON_IsObject(object) ? cJSON_GetObjectItemCaseSensitive(object, key) : NULL;
}

bool json_number(const struct cJSON *node, double *out)
{
    if (!cJSON_IsNumber(node) || !isfinite(node->valuedouble))
        return false;
    *out = node->valuedouble;
    return true;
}

bool json_truth(const struct cJSON *node, bool *out)
{
    if (!cJSON_IsBool(node))
        return false;
    *out = cJSON_IsTrue(node);
    return true;
}

const char *json_string(const struct cJSON *node)
{
    return cJSON_IsString(node) ? node->valuestring : NULL;
}

err_t json_float(const char *what, const struct cJSON *object, const char *key, float *out)
{
    double v;
    if (!json_number(json_member(object, key), &v) || !isfinite((float)v))
        return err_fail(ERR_FORMAT, "%s: \"%s\" is absent or not a finite number", what, key);
    *out = (float)v;
    return OK;
}

err_t json_floats(const char *what, const struct cJSON *object, const char *key, int n, float *out)
{
    const struct cJSON *array = json_member(object, key);
    if (!json_is_array(array) || json_count(array) != n)
        return err_fail(ERR_FORMAT, "%s: \"%s\" is not an array of %d numbers", what, key, n);
    int i = 0;
    for (const struct cJSON *v = json_first(array); v; v = json_next(v)) {
        double number;
        if (!json_number(v, &number) || !isfinite((float)number))
            return err_fail(ERR_FORMAT, "%s: \"%s\" element %d is not a finite number", what, key,
                            i);
        out[i++] = (float)number;
    }
    return OK;
}

/* Bytes that are not UTF-8 become U+FFFD, since a reader would refuse the whole document. */
void json_put_string(FILE *f, const char *s)
{
    putc('"', f);
    for (size_t left = strlen(s), n; left > 0; s += n, left -= n) {
        unsigned char c = (unsigned char)*s;
        n = name_utf8(s, left);
        if (n == 0) {
            fputs("\\ufffd", f);
            n = 1;
        } else if (c == '"' || c == '\\') {
            fprintf(f, "\\%c", c);
        } else if (c < 0x20) {
            fprintf(f, "\\u%04x", c);
        } else {
            fwrite(s, 1, n, f);
        }
    }
    putc('"', f);
}

static void put_plain(FILE *f, const struct cJSON *node)
{
    double v;
    char text[32];
    if (json_number(node, &v)) {
        snprintf(text, sizeof text, "%.15g", v);
        fprintf(f, strtod(text, NULL) == v ? "%.15g" : "%.17g", v);
    } else if (json_string(node)) {
        json_put_string(f, json_string(node));
    } else {
        fputs(cJSON_IsTrue(node) ? "true" : cJSON_IsFalse(node) ? "false" : "null", f);
    }
}

/* cJSON limits the depth of what it reads. */
void json_put(FILE *f, const struct cJSON *node)
{
    const bool object = json_is_object(node);
    if (!object && !json_is_array(node)) {
        put_plain(f, node);
        return;
    }
    putc(object ? '{' : '[', f);
    for (const struct cJSON *m = json_first(node); m; m = json_next(m)) {
        if (object) {
            json_put_string(f, json_key(m));
            fputs(": ", f);
        }
        json_put(f, m);
        fputs(json_next(m) ? ", " : "", f);
    }
    putc(object ? '}' : ']', f);
}
