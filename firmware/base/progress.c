#include "firmware/base/progress.h"

#include "drivers/device/clocks.h"

#include <string.h>
#include <time.h>
#include <unistd.h>

#define REDRAW_NS 100000000 // ten lines a second are enough for the eye

void progress_init(struct progress *p, FILE *f)
{
    *p = (struct progress){.f = f, .terminal = isatty(fileno(f)) == 1};
}

const char *progress_line(const char *stage, int done, int total, double seconds_left,
                          const char *note, char buf[160])
{
    char left[32] = "";
    if (seconds_left >= 0.5)
        snprintf(left, sizeof left, ", %.0f s left", seconds_left);
    int percent = total > 0 ? (int)(100LL * done / total) : 100;
    bool has_note = note && *note;
    snprintf(buf, 160, "%s %d %% step %d/%d%s%s%s", stage, percent, done, total, left,
             has_note ? ", " : "", has_note ? note : "");
    return buf;
}

void progress_end(struct progress *p)
{
    if (p->open)
        putc('\n', p->f);
    p->open = false;
}

void progress_step(void *ctx, const char *stage, int done, int total, const char *note)
{
    struct progress *p = ctx;
    int64_t now = clocks_now();
    bool fresh = strncmp(p->stage, stage, sizeof p->stage - 1) != 0;
    if (fresh) {
        progress_end(p);
        snprintf(p->stage, sizeof p->stage, "%s", stage);
        p->start_ns = now;
        p->first = done;
        p->tenth = -1;
    }
    bool last = done >= total;
    int tenth = total > 0 ? (int)(10LL * done / total) : 10;
    bool due = p->terminal ? now - p->shown_ns >= REDRAW_NS || fresh || last : tenth != p->tenth;
    if (!due)
        return;
    double seconds = (double)(now - p->start_ns) * 1e-9;
    double left = done > p->first ? seconds / (done - p->first) * (total - done) : -1;
    char buf[160];
    progress_line(stage, done, total, left, note, buf);
    fprintf(p->f, p->terminal ? "\r%s\033[K" : "%s\n", buf);
    fflush(p->f);
    p->open = p->terminal;
    p->tenth = tenth;
    p->shown_ns = now;
}
