/* checkpoint_old.h - the container of PyTorch before 1.6 (torch.save with
 * _use_new_zipfile_serialization=False): pickles one after the other of a magic number, the
 * protocol's number, the machine, the object and the list of the storages' keys; then of each key
 * the number of its elements (int64) and these (PyTorch's _legacy_load).
 *
 * The reader refuses
 *  1. another magic number or protocol, a machine that is not little-endian;
 *  2. everything that pickle.h lists; a pickle above 32 MB;
 *  3. keys that are no texts or not of a storage, storages of a type that PyTorch does not have;
 *  4. storages beyond the end of the file.
 * What follows the last storage does not matter.
 * thread: one at a time. */
#ifndef FORMAT_CHECKPOINT_OLD_H
#define FORMAT_CHECKPOINT_OLD_H

#include "drivers/format/checkpoint_tensors.h"

/* Add the tensors of the file of the last part, whose `storage` is an offset in the file.
 * err:  ERR_IO, ERR_FORMAT, ERR_LIMIT, ERR_NOMEM. */
MUST_USE err_t checkpoint_old_add(struct checkpoint *c);

#endif
