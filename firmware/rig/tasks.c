#include "firmware/rig/tasks.h"

#include "core/base/log.h"
#include "drivers/device/clocks.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "drivers/net/fetch.h"
#include "firmware/store/joint.h"
#include "firmware/store/part.h"

#include <errno.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

enum { PARALLEL = 4 }; // transfers from one board: the next file begins before the last has ended

struct entry {
    struct entry *next;
    struct task task;
};

struct queue {
    struct entry *first, **last;
};

struct tasks {
    struct store *store;
    const char *path;
    struct fetcher *fetcher; // of the thread, once it has fetched
    pthread_t thread;
    pthread_mutex_t lock;
    pthread_cond_t work;
    struct queue in, out;
    atomic_bool stop;
    uint64_t all; // bytes of the part that is fetched: of the thread
    int fd;
};

static void put(struct queue *q, struct entry *e)
{
    e->next = NULL;
    *q->last = e;
    q->last = &e->next;
}

static struct entry *take_first(struct queue *q)
{
    struct entry *e = q->first;
    if (!e)
        return NULL;
    q->first = e->next;
    if (!q->first)
        q->last = &q->first;
    return e;
}

/* ---- what they do ---- */

static err_t write_order(struct tasks *t, const struct task *k, bool is_new)
{
    char *text = NULL;
    size_t n;
    FILE *f = open_memstream(&text, &n);
    if (!f)
        return err_fail(ERR_NOMEM, "order: no memory");
    message_write_order(&k->order, f);
    err_t e = fclose(f) == 0 ? OK : err_fail(ERR_NOMEM, "order: no memory");
    if (!e)
        e = is_new ? joint_begin(t->store, k->take, text) : joint_change(t->store, k->take, text);
    free(text);
    return e;
}

static err_t record(struct tasks *t, struct task *k)
{
    err_t e = store_reserve(t->store, k->take);
    memcpy(k->order.take, k->take, sizeof k->take);
    return e ? e : write_order(t, k, true);
}

static err_t drop(struct tasks *t, struct task *k)
{
    k->order.kind = MESSAGE_RELEASE;
    return write_order(t, k, false);
}

static void on_progress(void *ctx, uint64_t done, uint64_t all)
{
    struct tasks *t = ctx;
    (void)done;
    t->all = all;
}

static err_t read_starts(struct tasks *t, struct task *k)
{
    char dir[FILE_PATH_CAP];
    struct part *p = calloc(1, sizeof *p);
    if (!p)
        return err_fail(ERR_NOMEM, "%s: no memory for its part", k->member);
    err_t e = joint_part_path(t->path, k->take, k->member, dir);
    if (!e)
        e = part_read(&store_fs_system, dir, k->take, k->member, p);
    for (int i = 0; !e && i < p->n && i < TAKE_FRAMES_MAX; i++)
        k->report.start[k->report.n_starts++] = (struct message_start){
            p->frame[i].camera, p->frame[i].index, p->frame[i].common_ns, p->within_ns};
    if (!e && p->is_mosaic) {
        k->report.red = p->how.red;
        k->report.blue = p->how.blue;
    }
    if (!e)
        part_free(p);
    free(p);
    return e;
}

/* Files of a part that are fetched, each with room for two texts: those of the take first, then
 * thumbnails. */
struct wanted {
    struct fetch_item *items;
    char (*text)[2][FILE_PATH_CAP];
    int n, n_needed;
};

static err_t list_wanted(const struct task *k, const char *dir, const struct manifest *m,
                         struct wanted *w)
{
    w->items = calloc((size_t)m->n + 1, sizeof *w->items);
    w->text = calloc((size_t)m->n + 1, sizeof *w->text);
    if (!w->items || !w->text)
        return err_fail(ERR_NOMEM, "%s: no memory for its part", k->member);
    err_t e = OK;
    for (int i = 0; !e && i < 2 * m->n; i++) {
        const struct manifest_file *f = &m->file[i % m->n];
        char(*text)[FILE_PATH_CAP] = w->text[w->n];
        if (manifest_is_thumb(f->name) != (i >= m->n))
            continue;
        snprintf(text[0], FILE_PATH_CAP, "%s/parts/%s/%s", k->url, k->part.part, f->name);
        e = file_join(dir, f->name, text[1]);
        w->items[w->n++] = (struct fetch_item){text[0], text[1], f->bytes, f->sha256};
        w->n_needed += i < m->n;
    }
    return e;
}

static err_t fetch_listed(struct tasks *t, const struct task *k, const struct fetch_config *cfg)
{
    struct manifest *m = calloc(1, sizeof *m);
    struct fetch_config quiet = *cfg;
    struct wanted w = {0};
    char dir[FILE_PATH_CAP];
    quiet.progress = NULL;
    err_t e = m ? joint_part_files(t->path, k->take, k->member, m)
                : err_fail(ERR_NOMEM, "%s: no memory for its part", k->member);
    if (!e)
        e = joint_part_path(t->path, k->take, k->member, dir);
    if (!e)
        e = list_wanted(k, dir, m, &w);
    if (!e)
        e = fetch_files(t->fetcher, cfg, w.items, w.n_needed);
    if (!e && fetch_files(t->fetcher, &quiet, w.items + w.n_needed, w.n - w.n_needed) != OK)
        log_warn("%s: take %s goes without thumbnails of it: %s", k->member, k->take, err_text());
    free(w.items);
    free(w.text);
    free(m);
    return e;
}

/* The manifest, as it was announced, then what it lists. */
static err_t fetch(struct tasks *t, struct task *k)
{
    char dir[FILE_PATH_CAP], url[FILE_PATH_CAP], path[FILE_PATH_CAP];
    const struct fetch_config cfg = {.token = k->token,
                                     .parallel = PARALLEL,
                                     .cancel = &t->stop,
                                     .progress = on_progress,
                                     .ctx = t};
    const struct fetch_item item = {url, path, (uint64_t)k->part.bytes, k->part.sha256};
    t->all = 0;
    snprintf(url, sizeof url, "%s/parts/%s/%s", k->url, k->part.part, MANIFEST_FILE);
    err_t e = joint_part_make(t->store, k->take, k->member);
    if (!e)
        e = joint_part_path(t->path, k->take, k->member, dir);
    if (!e)
        e = file_join(dir, MANIFEST_FILE, path);
    if (!e && k->part.bytes > JSON_BYTES_MAX)
        e = err_fail(ERR_FORMAT, "%s: a manifest of %lld bytes", k->member,
                     (long long)k->part.bytes);
    if (!e && !t->fetcher)
        e = fetch_open(&t->fetcher);
    if (!e)
        e = fetch_files(t->fetcher, &cfg, &item, 1);
    if (!e)
        e = fetch_listed(t, k, &cfg);
    return e ? e : read_starts(t, k);
}

static err_t own(struct tasks *t, struct task *k)
{
    err_t e = joint_part_own(t->store, k->take, k->member, k->part.part);
    return e ? e : read_starts(t, k);
}

static err_t join(struct tasks *t, struct task *k)
{
    const char *member[MESSAGE_MEMBERS], *missing[MESSAGE_MEMBERS];
    struct joint j = {.id = k->take,
                      .n = k->order.n,
                      .n_missing = k->n_missing,
                      .member = member,
                      .missing = missing,
                      .trigger = k->trigger,
                      .clock_synced = k->clock_synced};
    for (int i = 0; i < k->order.n; i++)
        member[i] = k->order.member[i];
    for (int i = 0; i < k->n_missing; i++)
        missing[i] = k->missing[i];
    return joint_commit(t->store, &j);
}

static void list_holds(struct tasks *t, struct task *k)
{
    static const char name[] = MANIFEST_FILE;
    struct store_part part[MESSAGE_HOLDS];
    const int n = store_parts(t->path, part, MESSAGE_HOLDS);
    for (int i = 0; i < n; i++) {
        struct message_hold *h = &k->hold[k->n_holds];
        char dir[FILE_PATH_CAP], path[FILE_PATH_CAP];
        uint64_t bytes = 0;
        *h = (struct message_hold){0};
        memcpy(h->take, part[i].rig_take, sizeof h->take);
        memcpy(h->part, part[i].id, sizeof h->part);
        if (file_join(t->path, part[i].id, dir) == OK && file_join(dir, name, path) == OK &&
            store_fs_hash(&store_fs_system, path, &bytes, h->sha256) == OK) {
            h->bytes = (int64_t)bytes;
            k->n_holds++;
        }
    }
}

static err_t run(struct tasks *t, struct task *k)
{
    err_t e = OK;
    switch (k->kind) {
    case TASK_RECORD:
        return record(t, k);
    case TASK_FETCH:
        return fetch(t, k);
    case TASK_OWN:
        return own(t, k);
    case TASK_JOIN:
        return join(t, k);
    case TASK_DROP:
        return drop(t, k);
    case TASK_CLEAR:
        return joint_drop(t->store, k->take);
    case TASK_RELEASE:
        e = store_release(t->store, k->take);
        list_holds(t, k);
        return e;
    case TASK_HOLDS:
        list_holds(t, k);
        break;
    }
    return e;
}

/* ---- the thread ---- */

static void *run_tasks(void *ctx)
{
    struct tasks *t = ctx;
    pthread_mutex_lock(&t->lock);
    while (!t->stop) {
        struct entry *e = take_first(&t->in);
        if (!e) {
            pthread_cond_wait(&t->work, &t->lock);
            continue;
        }
        pthread_mutex_unlock(&t->lock);
        const int64_t begin = clocks_now();
        e->task.err = run(t, &e->task);
        e->task.took_s = (double)(clocks_now() - begin) * 1e-9;
        e->task.bytes = t->all;
        snprintf(e->task.text, sizeof e->task.text, "%.*s", TAKE_TEXT - 1,
                 e->task.err ? err_text() : "");
        pthread_mutex_lock(&t->lock);
        put(&t->out, e);
        eventfd_write(t->fd, 1);
    }
    pthread_mutex_unlock(&t->lock);
    return NULL;
}

err_t tasks_open(const char *name, struct store *s, const char *store_path, struct tasks **out)
{
    struct tasks *t = calloc(1, sizeof *t);
    *out = NULL;
    if (!t)
        return err_fail(ERR_NOMEM, "%s: no memory for its state", name);
    t->store = s;
    t->path = store_path;
    t->in.last = &t->in.first;
    t->out.last = &t->out.first;
    t->fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    if (t->fd < 0) {
        free(t);
        return err_fail(ERR_IO, "%s: eventfd: %s", name, strerror(errno));
    }
    pthread_mutex_init(&t->lock, NULL);
    pthread_cond_init(&t->work, NULL);
    int why = pthread_create(&t->thread, NULL, run_tasks, t);
    if (why) {
        close(t->fd);
        free(t);
        return err_fail(ERR_NOMEM, "%s: cannot start its thread: %s", name, strerror(why));
    }
    pthread_setname_np(t->thread, name);
    *out = t;
    return OK;
}

void tasks_close(struct tasks *t)
{
    if (!t)
        return;
    pthread_mutex_lock(&t->lock);
    t->stop = true;
    pthread_cond_signal(&t->work);
    pthread_mutex_unlock(&t->lock);
    pthread_join(t->thread, NULL);
    for (struct entry *e; (e = take_first(&t->in)) || (e = take_first(&t->out));)
        free(e);
    pthread_cond_destroy(&t->work);
    pthread_mutex_destroy(&t->lock);
    close(t->fd);
    fetch_close(t->fetcher);
    free(t);
}

err_t tasks_add(struct tasks *t, const struct task *task)
{
    struct entry *e = malloc(sizeof *e);
    if (!e)
        return err_fail(ERR_NOMEM, "tasks: no memory for one more");
    e->task = *task;
    pthread_mutex_lock(&t->lock);
    put(&t->in, e);
    pthread_cond_signal(&t->work);
    pthread_mutex_unlock(&t->lock);
    return OK;
}

int tasks_fd(const struct tasks *t)
{
    return t->fd;
}

bool tasks_outcome(struct tasks *t, struct task *out)
{
    eventfd_t n;
    pthread_mutex_lock(&t->lock);
    struct entry *e = take_first(&t->out);
    if (!t->out.first)
        eventfd_read(t->fd, &n);
    pthread_mutex_unlock(&t->lock);
    if (!e)
        return false;
    *out = e->task;
    free(e);
    return true;
}
