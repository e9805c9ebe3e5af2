/* Opens a trigger and prints its events until a second passes without one:
 *   trigger_probe gpio|gpiod|evdev|timer URI [DEAF_MS]
 * DEAF_MS: events wait so long before they are read for the first time, so that the kernel's buffer
 * overflows. Events are printed with the milliseconds since the one before. Exits with 0 when
 * silence ends it, 1 when an error does, 2 when the device cannot be opened. */
#include "drivers/device/trigger.h"

#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const struct trigger_ops *find(const char *name)
{
    static const struct trigger_ops *const all[] = {&trigger_gpio, &trigger_gpiod, &trigger_evdev,
                                                    &trigger_timer};
    for (size_t i = 0; i < sizeof all / sizeof all[0]; i++)
        if (!strcmp(all[i]->name, name))
            return all[i];
    fprintf(stderr, "no trigger %s\n", name);
    exit(2);
}

static int follow(const struct trigger_ops *t, void *st)
{
    struct pollfd p = {.fd = t->fd(st), .events = POLLIN};
    int64_t before = 0;
    while (poll(&p, 1, 1000) > 0) {
        struct trigger_event ev;
        err_t e;
        while ((e = t->next(st, &ev)) == OK) {
            printf("event %u lost %u after %lld ms\n", ev.count, ev.lost,
                   before ? (long long)(ev.time_ns - before + 500000) / 1000000 : 0);
            before = ev.time_ns;
        }
        if (e != ERR_AGAIN) {
            printf("error %d: %s\n", (int)e, err_text());
            return 1;
        }
    }
    return 0;
}

int main(int argc, char **argv)
{
    if (argc < 3)
        return 2;
    const struct trigger_ops *t = find(argv[1]);
    setvbuf(stdout, NULL, _IOLBF, 0);
    void *st = malloc(t->state_bytes);
    if (!st)
        return 2;
    err_t e = t->open(st, argv[2]);
    if (e) {
        printf("error %d: %s\n", (int)e, err_text());
        return 2;
    }
    puts("ready");
    if (argc > 3)
        usleep((useconds_t)atoi(argv[3]) * 1000);
    int rc = follow(t, st);
    t->close(st);
    free(st);
    return rc;
}
