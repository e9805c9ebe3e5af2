/* checkpoint_tensors.h - the files of a checkpoint and the list of its tensors. The functions are
 * for the readers of containers. */
#ifndef FORMAT_CHECKPOINT_TENSORS_H
#define FORMAT_CHECKPOINT_TENSORS_H

#include "core/base/bytes.h"
#include "core/base/err.h"
#include "drivers/format/file.h"
#include "drivers/format/zipfile.h"

enum {
    CHECKPOINT_NAME_CAP = 160,
    CHECKPOINT_OWNER_MAX = 8, // characters
    CHECKPOINT_KIND_CAP = 32,
    CHECKPOINT_RANK_MAX = 8,
    CHECKPOINT_PARTS_MAX = 256
};

enum checkpoint_type { CHECKPOINT_F32, CHECKPOINT_BF16, CHECKPOINT_F16, CHECKPOINT_OTHER };

struct checkpoint_tensor {
    char name[CHECKPOINT_NAME_CAP];
    enum checkpoint_type type;
    char kind[CHECKPOINT_KIND_CAP]; // for OTHER: the type's name in the file
    bool negative;                  // the values are those stored times -1
    int part, rank;
    size_t shape[CHECKPOINT_RANK_MAX], stride[CHECKPOINT_RANK_MAX]; // elements
    uint64_t storage; // zip: index of the member; else offset in the file, bytes
    uint64_t offset;  // elements
    uint64_t room;    // elements of the storage
};

struct checkpoint_part {
    char path[FILE_PATH_CAP];
    struct zipfile zip; // or:
    void *file;
};

struct checkpoint {
    const char *what;  // begins the sentences; not owned
    const char *owner; // prefix of all names, at most CHECKPOINT_OWNER_MAX; not owned
    int n_parts;
    struct checkpoint_part *parts; // (n_parts) by path
    int n;
    struct checkpoint_tensor *tensors; // (n) by name
};

/* Make room for n more tensors.
 * err:  ERR_NOMEM. */
MUST_USE err_t checkpoint_tensors_room(struct checkpoint *c, int n);

/* The next free tensor, for the file that is being opened; the caller counts it when it is whole.
 */
struct checkpoint_tensor *checkpoint_tensors_next(struct checkpoint *c);

/* The name under which a tensor is found (checkpoint.h). `what` begins the sentence.
 * err:  ERR_FORMAT (too long, control characters). */
MUST_USE err_t checkpoint_tensors_name(const struct checkpoint *c, const char *what,
                                       struct bytes text, char out[CHECKPOINT_NAME_CAP]);

/* Elements from the tensor's first to behind its last; false if that overflows. */
bool checkpoint_tensors_spread(const struct checkpoint_tensor *t, size_t *out);

/* Bytes of an element of a type that can be read. */
size_t checkpoint_tensors_bytes(enum checkpoint_type type);

#endif
