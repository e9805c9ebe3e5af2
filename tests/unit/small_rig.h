/* small_rig.h - takes of boards as parts of a rig's take, in stores of their own, and how they come
 * into the conductor's staging folder. */
#ifndef UNIT_SMALL_RIG_H
#define UNIT_SMALL_RIG_H

#include "firmware/store/joint.h"
#include "firmware/store/store_fs.h"
#include "tests/unit/small_take.h"

#include <sys/stat.h>

static const int64_t small_rig_ns = INT64_C(1234567890123456789);

/* As small_take, of board `member`; its cameras begin step_ns after one another. own: take_free. */
static inline struct take *small_part(int cameras, int exposures, enum camera_format format,
                                      const char *id, const char *member)
{
    struct take *t = small_take(cameras, exposures, format);
    if (!t)
        abort();
    snprintf(t->rig.take, sizeof t->rig.take, "%s", id);
    snprintf(t->rig.member, sizeof t->rig.member, "%s", member);
    snprintf(t->rig.clock, sizeof t->rig.clock, "exchange");
    for (int i = 0; i < t->n; i++) {
        struct take_frame *f = &t->frame[i];
        f->common_ns = small_rig_ns + f->index * INT64_C(1000000000) + f->camera * 1000;
        f->within_ns = 70000 + i;
    }
    return t;
}

static inline err_t small_rig_copy(const struct store_fs *fs, const char *from, const char *to,
                                   const char *name)
{
    char a[FILE_PATH_CAP], b[FILE_PATH_CAP];
    struct file_map m;
    if (file_join(from, name, a) != OK || file_join(to, name, b) != OK)
        abort();
    err_t e = file_map(a, 1 << 24, &m);
    if (e)
        return e;
    e = store_fs_write(fs, b, m.p, m.n);
    file_unmap(&m);
    return e;
}

/* What a conductor does over the network: manifest first, then what it lists. `s` works on fs. */
static inline err_t small_rig_fetch(const struct store_fs *fs, struct store *s, const char *store,
                                    const char *id, const char *member, const char *part)
{
    char to[FILE_PATH_CAP];
    struct manifest *m = malloc(sizeof *m);
    if (!m)
        return err_fail(ERR_NOMEM, "no manifest");
    err_t e = joint_part_make(s, id, member);
    if (!e)
        e = joint_part_path(store, id, member, to);
    if (!e)
        e = small_rig_copy(fs, part, to, MANIFEST_FILE);
    if (!e)
        e = joint_part_files(store, id, member, m);
    for (int i = 0; !e && i < m->n; i++)
        e = small_rig_copy(fs, part, to, m->file[i].name);
    free(m);
    return e;
}

#endif
