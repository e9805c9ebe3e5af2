/* checkpoint.h - named tensors of a file of published weights: a zip archive of PyTorch
 * (torch.save, Lightning's .ckpt included), PyTorch's older container (checkpoint_old.h), a
 * .safetensors file, or several of one kind with the index of them (*.index.json, key "weight_map":
 * name to file beside it). Only the headers stay in memory; tensors are read one at a time.
 *
 * Names lose what wrappers put into them (module., _orig_mod. and their like). With an owner they
 * also lose the prefix "model." and get the owner's if they have not: files of InstantHDR, AnySplat
 * and VGGT then agree.
 * Of a PyTorch file the innermost of the dictionaries "state_dict", "model_state_dict", "model" and
 * "module" counts, else the outermost. Attributes of parameters and tensors do not matter, except
 * PyTorch's mark that values are to be negated.
 *
 * The reader refuses
 *  1. files that are none of these;
 *  2. archives without exactly one <folder>/data.pkl, with a pickle above 32 MB, big-endian ones;
 *  3. everything that pickle.h, safetensors.h and checkpoint_old.h list;
 *  4. a name that occurs twice;
 *  5. tensors of a PyTorch file without storage, shape and strides of the right kind, beyond their
 *     storage, or whose storage is compressed, encrypted or shorter than it says;
 *  6. data whose checksum is wrong, where a whole storage is read;
 *  7. an index without "weight_map", with files that are not beside it, or with tensors that these
 *     files lack.
 * Names in the archive are looked up and never used as paths.
 * thread: one at a time. */
#ifndef FORMAT_CHECKPOINT_H
#define FORMAT_CHECKPOINT_H

#include "drivers/format/checkpoint_tensors.h"

/* owner: "encoder." for weights of the network, "" leaves names as they are; at most
 * CHECKPOINT_OWNER_MAX characters. It and `path` must live as long as *out.
 * own:  checkpoint_close.
 * err:  ERR_IO, ERR_FORMAT, ERR_LIMIT (also: above CHECKPOINT_PARTS_MAX files),
 *       ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t checkpoint_open(const char *path, const char *owner, struct checkpoint *out);

/* Accepts a zeroed struct. */
void checkpoint_close(struct checkpoint *c);

/* Tensor of that name; NULL if there is none. */
const struct checkpoint_tensor *checkpoint_find(const struct checkpoint *c, const char *name);

/* Elements of a tensor. */
size_t checkpoint_count(const struct checkpoint_tensor *t);

/* Read all elements in C order as floats; out holds checkpoint_count of them.
 * err:  ERR_FORMAT (type, damage), ERR_IO, ERR_LIMIT (a view that is spread over more than 512 MB),
 *       ERR_NOMEM. */
MUST_USE err_t checkpoint_read(const struct checkpoint *c, const struct checkpoint_tensor *t,
                               float *out);

#endif
