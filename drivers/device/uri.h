/* uri.h - "backend:name=value,name=value": strict options of devices from a table.
 * thread: any. */
#ifndef DEVICE_URI_H
#define DEVICE_URI_H

#include "core/base/err.h"

#include <stddef.h>

enum { URI_TEXT = 1024 }; // bytes of a text value with its terminating 0

enum uri_kind {
    URI_WHOLE, // int64_t
    URI_REAL,  // double
    URI_WORD,  // int, the position in `words`
    URI_STRING // char[URI_TEXT]
};

struct uri_key {
    const char *name;
    size_t offset; // in the struct that is filled in
    enum uri_kind kind;
    double lo, hi;     // bounds of numbers
    const char *words; // "one|two|three"
};

/* Keys and the struct that has their fields, with the values of keys that are not given. */
struct uri_table {
    const struct uri_key *key;
    int n;
    void *out;
};

/* Options of the URI from `text` on; `what` begins the sentence. No key may come twice.
 * err:  ERR_ARG names the key and what it may be. */
MUST_USE err_t uri_parse(const char *what, const char *text, const struct uri_table *tables,
                         int n_tables);

#endif
