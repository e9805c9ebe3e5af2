#include "firmware/result/resume.h"

#include "firmware/base/engine.h"

#include "core/base/log.h"

#include <math.h>
#include <string.h>
#include <unistd.h>

static const char magic[] = "hdrig checkpoint"; // drivers/format/origin.c knows it

enum {
    MAGIC = sizeof magic - 1,
    HEX = SHA256_HEX_CAP - 1,
    HEAD = MAGIC + HEX,
    COST = 100, // times as long as it took until the next one
    NAME_CUT = 200
};

/* ---- reading ---- */

static err_t checkpoint_path(const char *result, char path[FILE_PATH_CAP])
{
    char parent[FILE_PATH_CAP], name[NAME_CUT + 32];
    snprintf(name, sizeof name, ".%.*s.checkpoint", NAME_CUT, file_name(result));
    err_t e = file_parent(result, parent);
    return e ? e : file_join(parent, name, path);
}

static const char *hash_of(const void *p, size_t n, char out[SHA256_HEX_CAP])
{
    struct sha256 s;
    sha256_init(&s);
    sha256_add(&s, p, n);
    return sha256_hex(&s, out);
}

static bool is_checkpoint(const struct file_map *m)
{
    return m->n >= HEAD + HEX && memcmp(m->p, magic, MAGIC) == 0;
}

static err_t read_checkpoint(struct resume *s)
{
    char sum[SHA256_HEX_CAP];
    err_t e = file_map(s->path, SIZE_MAX, &s->map);
    if (e)
        return e;
    const struct file_map *m = &s->map;
    if (!is_checkpoint(m) || memcmp(hash_of(m->p, m->n - HEX, sum), m->p + m->n - HEX, HEX) != 0)
        return err_fail(ERR_FORMAT, "%s is damaged: start without --resume", s->path);
    if (memcmp(m->p + MAGIC, s->program, HEX) != 0)
        return err_fail(ERR_ARG, "%s is of another version of hdrig: start without --resume",
                        s->path);
    s->saver.state = m->p + HEAD;
    s->saver.bytes = m->n - HEAD - HEX;
    return OK;
}

/* ---- writing ---- */

static void put_bytes(void *ctx, const void *p, size_t n)
{
    struct resume *s = ctx;
    sha256_add(&s->sum, p, n);
    fwrite(p, 1, n, s->f); // file_finish asks whether it worked
}

static void tell_failure(struct resume *s)
{
    if (!s->failed)
        log_warn("%s: no checkpoint, the job goes on without: %s", s->path, err_text());
    s->failed = true;
}

static bool begin_state(void *ctx, int step, bool ends)
{
    struct resume *s = ctx;
    const double now = engine_seconds();
    if (!ends && now < s->next_s)
        return false;
    s->began_s = now;
    s->next_s = now + s->every_s;
    s->step = step;
    s->ends = ends;
    if (file_create(s->at, &s->f) != OK) {
        tell_failure(s);
        return false;
    }
    sha256_init(&s->sum);
    put_bytes(s, magic, MAGIC);
    put_bytes(s, s->program, HEX);
    return true;
}

/* The result must still have room beside it. */
static err_t show_checkpoint(struct resume *s)
{
    char sum[SHA256_HEX_CAP];
    fwrite(sha256_hex(&s->sum, sum), 1, HEX, s->f);
    err_t e = file_finish(s->f, s->at);
    s->f = NULL;
    if (!e)
        e = outdir_reserve(s->out, s->out->need);
    return e ? e : partial_show(&s->out->partial, s->path);
}

static void end_state(void *ctx)
{
    struct resume *s = ctx;
    if (show_checkpoint(s) != OK) {
        tell_failure(s);
        unlink(s->at);
    } else {
        s->failed = false;
        if (s->ends)
            log_info("step %d is kept in %s: --resume goes on from there", s->step, s->path);
    }
    const double now = engine_seconds();
    s->next_s = now + fmax(s->every_s, COST * (now - s->began_s));
}

/* ---- */

err_t resume_open(struct outdir *out, double every_s, bool go_on, struct resume *s)
{
    memset(s, 0, sizeof *s);
    s->out = out;
    s->every_s = every_s;
    s->next_s = engine_seconds() + every_s;
    s->saver =
        (struct refine_saver){.ctx = s, .begin = begin_state, .put = put_bytes, .end = end_state};
    err_t e = checkpoint_path(out->path, s->path);
    if (!e)
        e = partial_path(&out->partial, s->path, s->at);
    if (!e)
        e = engine_program(s->program);
    if (!e && go_on && !file_exists(s->path))
        log_info("%s: no checkpoint, the job starts from the beginning", s->path);
    else if (!e && go_on)
        e = read_checkpoint(s);
    return e;
}

bool resume_has(const char *path)
{
    char at[FILE_PATH_CAP];
    return checkpoint_path(path, at) == OK && file_exists(at);
}

void resume_forget(const char *path)
{
    char at[FILE_PATH_CAP], parent[FILE_PATH_CAP];
    struct file_map m;
    if (checkpoint_path(path, at) != OK || file_map(at, SIZE_MAX, &m) != OK)
        return;
    const bool ours = is_checkpoint(&m);
    file_unmap(&m);
    if (ours && unlink(at) == 0 && file_parent(at, parent) == OK && file_sync(parent) != OK)
        log_warn("%s", err_text());
}

void resume_close(struct resume *s)
{
    file_discard(s->f, s->at);
    file_unmap(&s->map);
    memset(s, 0, sizeof *s);
}
