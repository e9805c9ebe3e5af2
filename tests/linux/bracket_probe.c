/* Takes brackets with cameras that are usbcam, and compares what is recorded for every kept frame
 * with the truth in its pixels:
 *   bracket_probe TAKES MIDDLE_S EV,EV,... URI...
 * MIDDLE_S is the exposure of EV 0; 0: metered. Without stops ("-"): metered altogether. Fails if
 * one frame of a take, complete or aborted, is recorded with another exposure than its own, beyond
 * the take's tolerance; the unverified ones, which say so themselves, are counted apart. */
#include "tests/linux/truth.h"

#include "firmware/capture/session.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

struct tally {
    int complete, aborted, frames, unverified, wrong, untold; // untold: no truth in the pixels
    int used_least, used_most;                                // frames of complete takes
    double worst;                                             // stops
};

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static void die(void)
{
    printf("error: %s\n", err_text());
    exit(2);
}

static void compare(const struct take *t, const struct take_frame *f, struct tally *n)
{
    struct truth is;
    n->frames++;
    if (!truth_read(f->data, f->bytes, &is)) {
        n->untold++;
        return;
    }
    double off = fabs(log2(take_exposure_s(f) / is.exposure));
    bool proven = f->evidence.proof <= BRACKET_PIXELS;
    n->unverified += !proven;
    if (proven)
        n->worst = fmax(n->worst, off);
    if (proven && off > t->tolerance) {
        n->wrong++;
        printf("camera %d frame %u: recorded %.6f s, was %.6f s\n", f->camera, is.number,
               take_exposure_s(f), is.exposure);
    }
}

static void look(const struct take *t, struct tally *n)
{
    for (int i = 0; i < t->n; i++)
        compare(t, &t->frame[i], n);
    if (t->status != TAKE_COMPLETE) {
        n->aborted++;
        printf("aborted: %s\n", t->reason);
        return;
    }
    n->complete++;
    if (n->complete == 1 || t->frames_used < n->used_least)
        n->used_least = t->frames_used;
    if (t->frames_used > n->used_most)
        n->used_most = t->frames_used;
}

static void order_of(const char *middle, const char *stops, struct session_order *o)
{
    *o = (struct session_order){.mode = SESSION_AUTO, .middle_s = atof(middle)};
    if (strcmp(stops, "-") == 0)
        return;
    o->mode = SESSION_LIST;
    while (o->n < BRACKET_EXPOSURES_MAX) {
        char *end;
        o->ev[o->n++] = strtod(stops, &end);
        if (*end != ',')
            break;
        stops = end + 1;
    }
}

static void run(struct session *s, struct session_order *o, int takes, struct tally *n)
{
    int64_t deadline, give_up = now_ns() + 600 * (int64_t)1000000000;
    while (n->complete + n->aborted < takes) {
        struct pollfd fds[2 * BRACKET_CAMERAS_MAX];
        struct take *t;
        if (session_state(s) == SESSION_ARMED) {
            o->trigger_ns = now_ns();
            if (session_begin(s, o))
                die();
        }
        int count = session_poll(s, fds, 2 * BRACKET_CAMERAS_MAX, &deadline);
        int64_t wait = deadline == INT64_MAX ? 1000 : (deadline - now_ns()) / 1000000 + 1;
        poll(fds, (nfds_t)count, wait < 0 ? 0 : wait > 1000 ? 1000 : (int)wait);
        if (session_step(s))
            die();
        if (session_state(s) == SESSION_READY) {
            if (session_collect(s, &t))
                die();
            look(t, n);
            take_free(t);
        }
        if (now_ns() > give_up) {
            printf("after 600 s: %s\n", session_status(s));
            exit(2);
        }
    }
}

int main(int argc, char **argv)
{
    struct session_config cfg = {.memory = 256 << 20};
    struct session_order order;
    struct session *s;
    struct tally n = {0};
    if (argc < 5 || argc - 4 > BRACKET_CAMERAS_MAX)
        return 3;
    setvbuf(stdout, NULL, _IOLBF, 0);
    order_of(argv[2], argv[3], &order);
    for (int i = 4; i < argc; i++)
        cfg.uri[cfg.n++] = argv[i];
    if (session_open(&cfg, &s))
        die();
    run(s, &order, atoi(argv[1]), &n);
    session_close(s);
    printf("%d takes complete, %d aborted; %d frames, %d unverified, %d untold, %d mislabelled, "
           "at most %.3f stops off; %d to %d frames used\n",
           n.complete, n.aborted, n.frames, n.unverified, n.untold, n.wrong, n.worst, n.used_least,
           n.used_most);
    return n.wrong > 0 || n.untold > 0;
}
