/* checkpoint_pickle.h - the tensors that the pickle of a PyTorch file describes, in both of its
 * containers. */
#ifndef FORMAT_CHECKPOINT_PICKLE_H
#define FORMAT_CHECKPOINT_PICKLE_H

#include "drivers/format/checkpoint_tensors.h"
#include "drivers/format/pickle.h"

enum {
    CHECKPOINT_PICKLE_BYTES_MAX = 32 << 20, // of a pickle
    CHECKPOINT_PICKLE_KEY_MAX = 24
};

/* A storage as the pickle names it. */
struct checkpoint_pickle_storage {
    const struct pickle_value *kind; // a global: the storage's class
    const char *key;                 // not terminated
    size_t n_key;                    // <= CHECKPOINT_PICKLE_KEY_MAX
    uint64_t count;                  // elements
};

/* False if the value is no storage, or part of another one (the older container knows these as a
 * sixth item that is not None). v may be NULL. */
bool checkpoint_pickle_storage(const struct pickle *p, const struct pickle_value *v,
                               struct checkpoint_pickle_storage *out);

/* Find a storage in the file: t->storage, and the bytes that it has there.
 * err:  ERR_FORMAT names tensor and storage. */
typedef err_t checkpoint_pickle_find(const void *ctx, const struct checkpoint_pickle_storage *s,
                                     struct checkpoint_tensor *t, uint64_t *bytes);

struct checkpoint_pickle {
    struct checkpoint *c;
    checkpoint_pickle_find *find;
    const void *ctx;
};

/* Add the tensors of the dictionary that counts (checkpoint.h).
 * err:  ERR_FORMAT (4, 5 of checkpoint.h, no dictionary), those of find, ERR_NOMEM. */
MUST_USE err_t checkpoint_pickle_add(const struct checkpoint_pickle *j, const struct pickle *p);

#endif
