/* pickle.h - the values of a Python pickle as PyTorch writes it, protocols 2 to 5. Nothing is ever
 * executed: a call becomes a tensor or an ordered dictionary (empty, or of a list of pairs as
 * Python 2 wrote it) if it is one of the few that PyTorch uses or used for weights, and an opaque
 * value otherwise. Values may contain themselves; nothing here follows them.
 *
 * The reader refuses
 *  1. opcodes that these protocols do not use for data (text numbers, INST, OBJ, EXT, PERSID);
 *  2. reads beyond the end, of an empty stack, below a mark, of a memo that was never written;
 *  3. more than PICKLE_VALUES_MAX values, items, memos or stack entries;
 *  4. items added to what is neither a list, a dictionary nor opaque; keys without values;
 *  5. an end without exactly one value.
 * Memory is at most about 100 times the pickle and 100 MB.
 * thread: any. */
#ifndef FORMAT_PICKLE_H
#define FORMAT_PICKLE_H

#include "core/base/err.h"

#include <stddef.h>
#include <stdint.h>

enum { PICKLE_VALUES_MAX = 1 << 20 };

enum pickle_kind {
    PICKLE_OPAQUE, // numbers that are no int64, None, bytes, objects
    PICKLE_INT,    // also True and False
    PICKLE_TEXT,
    PICKLE_TUPLE,
    PICKLE_LIST,
    PICKLE_DICT, // items are key, value, key, value, ...
    PICKLE_GLOBAL,
    PICKLE_STORAGE, // items of its persistent id: 'storage', class, key, device, elements
    PICKLE_TENSOR,  // arguments of _rebuild_tensor_v2: storage, offset, shape, strides, ...
    PICKLE_FOREIGN  // a tensor that PyTorch makes in another way; text: the function or class
};

enum pickle_global {
    PICKLE_UNKNOWN,
    PICKLE_ORDERED_DICT,
    PICKLE_REBUILD_TENSOR,
    PICKLE_REBUILD_PARAMETER, // also the class of parameters
    PICKLE_REBUILD_FROM_TYPE,
    PICKLE_REBUILD_OTHER, // other functions of PyTorch that make tensors
    PICKLE_TENSOR_CLASS,  // of any type of elements
    PICKLE_FLOAT_STORAGE,
    PICKLE_BFLOAT16_STORAGE,
    PICKLE_HALF_STORAGE
};

struct pickle_value {
    enum pickle_kind kind;
    enum pickle_global global; // GLOBAL, FOREIGN
    int64_t number;            // INT
    const char *text;          // TEXT, GLOBAL (its name), FOREIGN: of the pickle, not terminated
    size_t n_text;
    int first, last, count; // items; -1, -1, 0: none
};

struct pickle_item {
    int value, next; // next: -1 at the end
};

struct pickle {
    struct pickle_value *values;
    struct pickle_item *items;
    int n_values, n_items, values_cap, items_cap;
    int root;
    size_t bytes; // of the pickle; what follows is not looked at
};

/* Parse n bytes, which must live as long as *out; `what` begins the sentence.
 * own:  pickle_free.
 * err:  ERR_FORMAT, ERR_LIMIT (3), ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t pickle_parse(const char *what, const void *p, size_t n, struct pickle *out);

/* Accepts a zeroed struct. */
void pickle_free(struct pickle *p);

/* Item i of a value; NULL if it has none. */
const struct pickle_value *pickle_item(const struct pickle *p, const struct pickle_value *v, int i);

/* Value of a text key of a dictionary, the last one as in Python; NULL if there is none. */
const struct pickle_value *pickle_get(const struct pickle *p, const struct pickle_value *dict,
                                      const char *key);

#endif
