/* Shows states on a lamp and looks at its line every 10 ms, as often as COUNT says:
 *   lamp_probe URI VALUE_FILE STATE COUNT [STATE COUNT]...
 * Prints what was seen as runs: "busy 12+ 13- " is 12 times lit, then 13 times dark. The file is
 * the line's value in sysfs. */
#include "drivers/device/lamp.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static const char *const names[] = {"off", "armed", "busy", "fault"};

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static void sleep_until(int64_t ns)
{
    struct timespec t = {ns / 1000000000, ns % 1000000000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
}

static int value(const char *path)
{
    FILE *f = fopen(path, "re");
    int c = f ? fgetc(f) : '?';
    if (f)
        fclose(f);
    return c;
}

static err_t look(struct lamp *l, const char *path, int count)
{
    int64_t next = now_ns() + 5000000; // between the flashes' edges
    int last = 0, run = 0;
    err_t e = OK;
    for (int i = 0; i < count && !e; i++, next += 10000000) {
        while (!e && lamp_next_ns(l) <= now_ns())
            e = lamp_tick(l, now_ns());
        while (!e && lamp_next_ns(l) < next) {
            sleep_until(lamp_next_ns(l));
            e = lamp_tick(l, now_ns());
        }
        sleep_until(next);
        int c = value(path);
        if (c != last && run > 0) {
            printf(" %d%c", run, last == '1' ? '+' : '-');
            run = 0;
        }
        last = c;
        run++;
    }
    printf(" %d%c\n", run, last == '1' ? '+' : '-');
    return e;
}

static int state_of(const char *name)
{
    for (int i = 0; i < 4; i++)
        if (!strcmp(name, names[i]))
            return i;
    fprintf(stderr, "no state %s\n", name);
    exit(2);
}

int main(int argc, char **argv)
{
    struct lamp *l;
    if (argc < 3)
        return 2;
    err_t e = lamp_open(argv[1], &l);
    if (e) {
        printf("error %d: %s\n", (int)e, err_text());
        return 2;
    }
    for (int i = 3; i + 1 < argc && !e; i += 2) {
        lamp_show(l, (enum lamp_state)state_of(argv[i]), now_ns());
        printf("%s", argv[i]);
        e = look(l, argv[2], atoi(argv[i + 1]));
    }
    if (e)
        printf("error %d: %s\n", (int)e, err_text());
    lamp_close(l);
    printf("closed %c\n", value(argv[2]));
    return e != OK;
}
