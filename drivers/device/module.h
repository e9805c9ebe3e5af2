/* module.h - parts of this program in shared objects of their own, because the libraries that they
 * need are not on every machine: loaded when they are needed, never unloaded, since threads of the
 * library may run in them. */
#ifndef DEVICE_MODULE_H
#define DEVICE_MODULE_H

#include "core/base/err.h"

#include <stdbool.h>

struct module {
    const char *what;    // begins sentences
    const char *file;    // looked for beside the program, then where `make install` puts it
    const char *package; // of Debian, that it is built with
    const char *needs;   // of Debian, that it runs with, as text
    const char *table;   // its symbol
    bool global;         // the library's own modules look for its symbols
};

/* out: the address of the table.
 * path: NULL or "": found.
 * err:  ERR_UNSUPPORTED (not there, does not load, has no table). */
MUST_USE err_t module_load(const struct module *m, const char *path, const void **out);

#endif
