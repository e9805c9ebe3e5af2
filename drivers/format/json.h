/* json.h - JSON text in and out; the only place that uses the library.
 * Nodes belong to their document. Objects may hold a key twice; a reader that must not accept this
 * counts members.
 * thread: any; a document is read-only after json_parse. */
#ifndef FORMAT_JSON_H
#define FORMAT_JSON_H

#include "core/base/err.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

struct cJSON;

/* A node of JSON takes up to 40 times the bytes of its text: this bounds the memory for a hostile
 * file. */
enum { JSON_BYTES_MAX = 4 << 20 };

/* Parse n bytes of text; `what` (a file) begins the sentence. Nothing but blanks may follow the
 * value.
 * own:  json_free.
 * err:  ERR_FORMAT (also: above JSON_BYTES_MAX), ERR_NOMEM. On error *out is NULL. */
MUST_USE err_t json_parse(const char *what, const void *text, size_t n, struct cJSON **out);

/* json_parse of a file. err: also those of file_map. */
MUST_USE err_t json_read(const char *path, struct cJSON **out);

/* Fill *out, which is zeroed, from a document. */
typedef err_t json_take_fn(const char *what, const struct cJSON *doc, void *out);

/* Parse or read, take, free the document. */
MUST_USE err_t json_parse_with(const char *what, const void *text, size_t n, json_take_fn *take,
                               void *out);
MUST_USE err_t json_read_with(const char *path, json_take_fn *take, void *out);

/* Accepts NULL. */
void json_free(struct cJSON *doc);

bool json_is_object(const struct cJSON *node);
bool json_is_array(const struct cJSON *node);

/* Members of an object or elements of an array: first, next and number. */
const struct cJSON *json_first(const struct cJSON *node);
const struct cJSON *json_next(const struct cJSON *node);
int json_count(const struct cJSON *node);

/* Key of a member; "" for an element of an array. */
const char *json_key(const struct cJSON *node);

/* First member with this key; NULL if there is none or the node is no object. */
const struct cJSON *json_member(const struct cJSON *object, const char *key);

/* Value of a finite number; false if the node is something else or NULL. */
bool json_number(const struct cJSON *node, double *out);

/* Value of true or false; false if the node is something else or NULL. */
bool json_truth(const struct cJSON *node, bool *out);

/* Value of a string; NULL if the node is something else or NULL. */
const char *json_string(const struct cJSON *node);

/* Member `key` of an object as one finite float, or as an array of exactly n of them.
 * err:  ERR_FORMAT naming the key; `what` begins the sentence. */
MUST_USE err_t json_float(const char *what, const struct cJSON *object, const char *key,
                          float *out);
MUST_USE err_t json_floats(const char *what, const struct cJSON *object, const char *key, int n,
                           float *out);

/* Write s in quotes, escaped; what is not UTF-8 in it becomes U+FFFD. */
void json_put_string(FILE *f, const char *s);

/* Write a node and what is in it on one line. Numbers are read back as the same, infinite ones
 * become null. */
void json_put(FILE *f, const struct cJSON *node);

#endif
