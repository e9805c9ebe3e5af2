/* Compares a store with the truth in its frames, which usbcam made: truth_check STORE
 * Every take is whole, and no frame is recorded with another exposure than its own, beyond the
 * take's tolerance. Unverified frames say so themselves and are counted apart. */
#include "tests/linux/truth.h"

#include "drivers/format/file.h"
#include "drivers/format/json.h"
#include "firmware/store/store.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { IDS_MAX = 4096, PATH_CAP = 1024 };

struct tally {
    int complete, aborted, frames, unverified, wrong;
    double worst; // stops
};

static void die(const char *what)
{
    printf("%s: %s\n", what, err_text());
    exit(1);
}

static double number(const struct cJSON *node, const char *key)
{
    double v = NAN;
    return json_number(json_member(node, key), &v) ? v : NAN;
}

static struct truth truth_of(const char *dir, const struct cJSON *frame)
{
    char path[PATH_CAP];
    struct truth t;
    struct file_map f;
    snprintf(path, sizeof path, "%s/%s", dir, json_string(json_member(frame, "raw")));
    if (file_map(path, 1 << 28, &f))
        die(path);
    if (!truth_read(f.p, f.n, &t)) {
        printf("%s: has no truth\n", path);
        exit(1);
    }
    file_unmap(&f);
    return t;
}

static void compare(const char *dir, const struct cJSON *doc, struct tally *n)
{
    const struct cJSON *f = json_first(json_member(doc, "frames"));
    for (; f; f = json_next(f)) {
        struct truth is = truth_of(dir, f);
        const char *proof = json_string(json_member(f, "proof"));
        double told = number(f, "exposure_s"), off = fabs(log2(told / is.exposure));
        n->frames++;
        if (!strncmp(proof, "unverified", 10)) {
            n->unverified++;
            continue;
        }
        n->worst = fmax(n->worst, off);
        if (off <= number(doc, "tolerance_stops"))
            continue;
        n->wrong++;
        printf("%s: frame %u is recorded with %.6f s, was %.6f s\n", dir, is.number, told,
               is.exposure);
    }
}

static void check(const char *dir, struct tally *n)
{
    char path[PATH_CAP + 16];
    struct cJSON *doc;
    snprintf(path, sizeof path, "%s/manifest.json", dir);
    if (store_verify(dir) || json_read(path, &doc))
        die(dir);
    const char *status = json_string(json_member(doc, "status"));
    if (strcmp(status, "complete") == 0)
        n->complete++;
    else
        n->aborted++;
    compare(dir, doc, n);
    json_free(doc);
}

int main(int argc, char **argv)
{
    static char ids[IDS_MAX][STORE_ID_CAP];
    struct store_config cfg = {.path = argc == 2 ? argv[1] : ""};
    struct store *s;
    struct tally n = {0};
    if (store_open(&cfg, &s))
        die("store");
    int count = store_list(s, ids, IDS_MAX);
    for (int i = 0; i < count; i++) {
        char dir[PATH_CAP - 64];
        snprintf(dir, sizeof dir, "%s/%.*s", cfg.path, STORE_ID_CAP - 1, ids[i]);
        check(dir, &n);
    }
    store_close(s);
    printf("%d takes complete, %d aborted; %d frames, %d unverified, %d mislabelled, at most %.3f "
           "stops off\n",
           n.complete, n.aborted, n.frames, n.unverified, n.wrong, n.worst);
    return n.wrong > 0;
}
