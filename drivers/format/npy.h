/* npy.h - a folder of tensors: NAME.npy for each (NumPy format 1.0, C order, little-endian float32
 * or int32), and an index.json that lists name, file, dtype and shape, as the golden sets do.
 * Implements struct tap: pieces of a tensor may come in any order and from any thread; errors are
 * remembered and asked for once, in npy_close. */
#ifndef FORMAT_NPY_H
#define FORMAT_NPY_H

#include "drivers/format/file.h"

#include "core/base/types.h"

#include <pthread.h>

enum { NPY_TENSORS_MAX = 1024, NPY_HEAD = 192 }; // NPY_HEAD: bytes before the data

struct npy_tensor {
    char name[NAME_CAP];
    int rank, shape[TAP_RANK_MAX];
    bool ints;
    int parts, done; // pieces in all, written
};

struct npy_dir {
    char path[FILE_PATH_CAP];
    struct tap tap; // points to this struct, which must not move
    pthread_mutex_t lock;
    bool open;
    int n;
    struct npy_tensor *tensors; // (NPY_TENSORS_MAX) malloc'd
    err_t failed;               // the first error
    char reason[512];           // its sentence
};

/* Begin: `path` is a folder that exists; files of tensors that are there already are replaced.
 * own:  npy_close, also after an error.
 * err:  ERR_ARG (path too long), ERR_NOMEM. */
MUST_USE err_t npy_open(struct npy_dir *d, const char *path);

/* The function of d->tap. */
void npy_put(void *ctx, const struct tap_tensor *t);

/* Write index.json unless something failed, and end. Accepts a zeroed struct.
 * err:  the first of: ERR_FORMAT (a name that name_copy refuses, a shape that contradicts another
 *       piece, a piece that never came or came twice), ERR_LIMIT (space; NPY_TENSORS_MAX), ERR_IO,
 *       ERR_NOMEM. */
MUST_USE err_t npy_close(struct npy_dir *d);

#endif
