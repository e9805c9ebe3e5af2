/* The queue has two slots: the take being written, or its uncollected outcome, and the take after
 * it. */
#include "firmware/capture/writer.h"

#include "core/base/log.h"
#include "drivers/device/clocks.h"

#include <errno.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <time.h>
#include <unistd.h>

enum { SLOTS = 2 };

struct writer {
    struct store *store;
    pthread_t thread;
    pthread_mutex_t lock;
    pthread_cond_t work;
    bool stop, done; // done: slot[0] is an outcome
    int n, fd;
    int64_t since_ns;
    struct writer_outcome slot[SLOTS];
};

static void *write_takes(void *ctx)
{
    struct writer *w = ctx;
    pthread_mutex_lock(&w->lock);
    for (;;) {
        while (!w->stop && (w->n == 0 || w->done))
            pthread_cond_wait(&w->work, &w->lock);
        if (w->n == 0 || w->done)
            break;
        struct writer_outcome o = w->slot[0];
        w->since_ns = clocks_now();
        pthread_mutex_unlock(&w->lock);
        o.err = store_commit(w->store, o.take, o.id);
        snprintf(o.text, sizeof o.text, "%s", o.err ? err_text() : "");
        pthread_mutex_lock(&w->lock);
        w->slot[0] = o;
        w->done = true;
        w->since_ns = 0;
        eventfd_write(w->fd, 1);
    }
    pthread_mutex_unlock(&w->lock);
    return NULL;
}

err_t writer_open(struct store *s, struct writer **out)
{
    struct writer *w = calloc(1, sizeof *w);
    *out = NULL;
    if (!w)
        return err_fail(ERR_NOMEM, "writer: no memory for its state");
    w->store = s;
    w->fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    if (w->fd < 0) {
        free(w);
        return err_fail(ERR_IO, "writer: eventfd: %s", strerror(errno));
    }
    pthread_mutex_init(&w->lock, NULL);
    pthread_cond_init(&w->work, NULL);
    int why = pthread_create(&w->thread, NULL, write_takes, w);
    if (why) {
        close(w->fd);
        free(w);
        return err_fail(ERR_NOMEM, "writer: cannot start its thread: %s", strerror(why));
    }
    pthread_setname_np(w->thread, "writer");
    *out = w;
    return OK;
}

void writer_close(struct writer *w)
{
    struct writer_outcome o;
    if (!w)
        return;
    pthread_mutex_lock(&w->lock);
    w->stop = true;
    pthread_cond_signal(&w->work);
    pthread_mutex_unlock(&w->lock);
    pthread_join(w->thread, NULL);
    while (w->n > 0) { // outcomes that were not collected, and a take still queued behind one
        if (!w->done && store_commit(w->store, w->slot[0].take, o.id) != OK)
            log_error("%s", err_text());
        take_free(w->slot[0].take);
        w->slot[0] = w->slot[1];
        w->done = false;
        w->n--;
    }
    pthread_cond_destroy(&w->work);
    pthread_mutex_destroy(&w->lock);
    close(w->fd);
    free(w);
}

bool writer_free(struct writer *w)
{
    pthread_mutex_lock(&w->lock);
    bool room = w->n < SLOTS;
    pthread_mutex_unlock(&w->lock);
    return room;
}

err_t writer_put(struct writer *w, struct take *t)
{
    pthread_mutex_lock(&w->lock);
    bool room = w->n < SLOTS;
    if (room) {
        w->slot[w->n++] = (struct writer_outcome){.take = t};
        pthread_cond_signal(&w->work);
    }
    pthread_mutex_unlock(&w->lock);
    return room ? OK : err_fail(ERR_BUSY, "two captures are still being written");
}

int writer_fd(struct writer *w)
{
    return w->fd;
}

err_t writer_outcome(struct writer *w, struct writer_outcome *out)
{
    eventfd_t count;
    pthread_mutex_lock(&w->lock);
    bool ready = w->done;
    if (ready) {
        *out = w->slot[0];
        w->slot[0] = w->slot[1];
        w->n--;
        w->done = false;
        eventfd_read(w->fd, &count);
        pthread_cond_signal(&w->work);
    }
    pthread_mutex_unlock(&w->lock);
    return ready ? OK : ERR_AGAIN;
}

int64_t writer_since_ns(struct writer *w)
{
    pthread_mutex_lock(&w->lock);
    int64_t since = w->since_ns;
    pthread_mutex_unlock(&w->lock);
    return since;
}
