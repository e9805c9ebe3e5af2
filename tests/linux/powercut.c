/* Power cuts under a store, from the log of dm-log-writes:
 *   powercut commit STORE                    commits one take, prints its name
 *   powercut replay LOG BASE WORK MOUNT      makes, mounts and checks what cuts would have left
 * LOG is the log's device, BASE an image of the file system before, WORK a device for the results.
 *
 * A cut may come after any write. What was flushed before, or forced (FUA), is on the disk; of the
 * writes since, a drive with a cache may have done none, all or some, in any order, a long one by
 * half: each of these is tried. A mark in the log ("=" and a take's name) says that store_commit
 * had returned. The store keeps KEEP takes. After each cut: the file system mounts, the store
 * opens, has the take that was committed last and as many as it keeps (or one more, which was to be
 * removed), all whole, and gives a new one a name of its own.
 * Format of the log: drivers/md/dm-log-writes.c of the kernel; one sector of struct entry, then the
 * data; the text of a mark is in its first sector. */
#include "firmware/store/store.h"

#include "sim/sensor/sensor.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <unistd.h>

enum { FLUSHED = 1, FORCED = 2, DISCARD = 4, MARK = 8 };
enum { SECTOR = 512, BLOCK = 2 }; // bytes; sectors of a block of the file system, which is whole
enum { IDS_MAX = 64, W = 48, H = 32, CAMERAS = 2, EXPOSURES = 3, KEEP = 2 };

struct super {
    uint64_t magic, version, n_entries;
    uint32_t sector;
};

struct entry {
    uint64_t sector, n_sectors, flags, n_bytes;
};

struct replay {
    const uint8_t **entry;
    int n, flushed; // entries; those before are on the disk
    uint8_t *disk;  // what is on it for sure
    size_t bytes;
    int work;
    const char *device, *mount;
    uint64_t seed, random;
    int cuts, seen[IDS_MAX + 1]; // with so many takes
};

static void die(const char *what, const char *why)
{
    printf("%s: %s\n", what, why);
    exit(1);
}

/* ---- a take ---- */

static void fill_camera(struct take_camera *c, int i)
{
    snprintf(c->uri, sizeof c->uri, "v4l2:/dev/video%d", i);
    snprintf(c->info.unit, sizeof c->info.unit, "cut-%d", i);
    c->info.w = c->info.stride = W;
    c->info.h = H;
    c->info.format = CAMERA_GREY;
    c->info.bits = 8;
    c->info.buffers = 4;
    c->info.period_s = 1.0 / 30.0;
    c->info.time_min_s = 1e-4;
    c->info.time_max_s = 1.0;
    c->info.gain_max = 1.0;
}

static void fill_frame(struct take_frame *f, uint8_t *px, int camera, int index)
{
    double t = 0.001 * (1 << 2 * index);
    f->camera = camera;
    f->index = index;
    f->data = px;
    f->bytes = W * H;
    for (int i = 0; i < W * H; i++)
        px[i] = (uint8_t)(255 * sensor_uniform((uint64_t)(camera * 9 + index), (uint64_t)i));
    f->evidence.exposure = f->evidence.requested = f->evidence.set = (struct exposure){t, 1.0};
    f->evidence.proof = BRACKET_PIXELS;
    f->evidence.sequence = (uint32_t)index;
    f->evidence.attempts = 1;
    f->evidence.start_ns = f->evidence.timestamp_ns = f->start.monotonic_ns = 1000000000;
    f->start.boottime_ns = 1000000000;
    f->start.realtime_ns = 1700000000000000000;
}

static void commit(struct store *s, char id[STORE_ID_CAP])
{
    static struct take t;
    static uint8_t px[CAMERAS * EXPOSURES][W * H];
    memset(&t, 0, sizeof t);
    t.n_cameras = CAMERAS;
    t.n = CAMERAS * EXPOSURES;
    t.tolerance = 0.1;
    t.trigger = (struct clocks){1000000000, 1000000000, 1700000000000000000};
    for (int i = 0; i < CAMERAS; i++)
        fill_camera(&t.camera[i], i);
    for (int i = 0; i < t.n; i++)
        fill_frame(&t.frame[i], px[i], i / EXPOSURES, i % EXPOSURES);
    if (store_commit(s, &t, id))
        die("store_commit", err_text());
}

static struct store *open_store(const char *path)
{
    struct store_config cfg = {.path = path, .merge = true, .keep = KEEP};
    struct store *s;
    if (store_open(&cfg, &s))
        die("store_open", err_text());
    return s;
}

static int commit_one(const char *path)
{
    char id[STORE_ID_CAP];
    struct store *s = open_store(path);
    commit(s, id);
    store_close(s);
    puts(id);
    return 0;
}

/* ---- the log ---- */

static uint8_t *load(const char *path, size_t *n)
{
    int fd = open(path, O_RDONLY);
    off_t end = fd < 0 ? -1 : lseek(fd, 0, SEEK_END);
    uint8_t *p = end > 0 ? malloc((size_t)end) : NULL;
    if (!p)
        die(path, strerror(errno));
    for (off_t at = 0; at < end;) {
        ssize_t k = pread(fd, p + at, (size_t)(end - at), at);
        if (k <= 0)
            die(path, "cannot be read");
        at += k;
    }
    close(fd);
    *n = (size_t)end;
    return p;
}

static const struct entry *entry_of(const struct replay *r, int i)
{
    return (const struct entry *)r->entry[i];
}

static const char *mark_of(const struct replay *r, int i)
{
    return entry_of(r, i)->flags & MARK ? (const char *)r->entry[i] + sizeof(struct entry) : NULL;
}

static void index_log(struct replay *r, const char *path)
{
    size_t n, at = SECTOR;
    const uint8_t *log = load(path, &n);
    struct super super;
    memcpy(&super, log, sizeof super);
    if (super.magic != 0x6a736677736872 || super.sector != SECTOR)
        die(path, "is no log of writes");
    r->n = (int)super.n_entries;
    r->entry = malloc(sizeof *r->entry * (size_t)(r->n + 1));
    if (!r->entry)
        die(path, "no memory");
    for (int i = 0; i < r->n; i++) {
        r->entry[i] = log + at;
        at += SECTOR;
        if (!(entry_of(r, i)->flags & (MARK | DISCARD)))
            at += entry_of(r, i)->n_sectors * SECTOR;
        if (at > n)
            die(path, "is full: the device is too small");
    }
}

/* ---- cuts ---- */

static double uniform(struct replay *r)
{
    return sensor_uniform(r->seed, r->random++);
}

/* Write the data of an entry, or their first n sectors. */
static void apply(const struct replay *r, int i, uint8_t *disk, uint64_t n)
{
    const struct entry *e = entry_of(r, i);
    if (e->flags & (MARK | DISCARD) || n == 0)
        return;
    if ((e->sector + e->n_sectors) * SECTOR > r->bytes)
        die("log", "a write beyond the device");
    memcpy(disk + e->sector * SECTOR, r->entry[i] + SECTOR, n * SECTOR);
}

enum kind { NONE, ALL, SOME, KINDS };

static void put_disk(const struct replay *r, const uint8_t *disk)
{
    for (size_t at = 0; at < r->bytes;) {
        ssize_t k = pwrite(r->work, disk + at, r->bytes - at, (off_t)at);
        if (k <= 0)
            die(r->device, strerror(errno));
        at += (size_t)k;
    }
}

/* The disk after a cut behind entry `end`. */
static void cut(struct replay *r, int end, enum kind kind)
{
    uint8_t *disk = malloc(r->bytes);
    if (!disk)
        die("cut", "no memory");
    memcpy(disk, r->disk, r->bytes);
    for (int i = r->flushed; i < end; i++) {
        uint64_t n = entry_of(r, i)->n_sectors;
        bool done = kind == ALL || (kind == SOME && uniform(r) < 0.5);
        if (entry_of(r, i)->flags & FORCED && i < end - 1)
            done = true;
        else if (kind == SOME && done && uniform(r) < 0.2)
            n = (uint64_t)(uniform(r) * (double)n / BLOCK) * BLOCK;
        if (done)
            apply(r, i, disk, n);
    }
    put_disk(r, disk);
    free(disk);
}

static bool listed(const char *id, char (*ids)[STORE_ID_CAP], int n)
{
    for (int k = 0; k < n; k++)
        if (!strcmp(ids[k], id))
            return true;
    return false;
}

/* The last take that was marked before entry `end` is there, and as many as are kept. */
static void check_committed(const struct replay *r, int end, char (*ids)[STORE_ID_CAP], int n)
{
    const char *last = NULL;
    int marks = 0;
    for (int i = 0; i < end; i++) {
        const char *name = mark_of(r, i);
        if (name && name[0] == '=') {
            last = name + 1;
            marks++;
        }
    }
    if (last && !listed(last, ids, n))
        die(last, "was committed and is not there");
    if (n < (marks < KEEP ? marks : KEEP) || n > KEEP + 1)
        die("store", "has lost takes, or kept too many");
}

static void check_leftovers(const char *path)
{
    DIR *d = opendir(path);
    for (struct dirent *e; d && (e = readdir(d)) != NULL;)
        if (!strncmp(e->d_name, ".tmp", 4) || !strncmp(e->d_name, "damaged", 7))
            die(e->d_name, "was left");
    if (d)
        closedir(d);
}

static void check_store(struct replay *r, int end)
{
    static char ids[IDS_MAX][STORE_ID_CAP], more[STORE_ID_CAP];
    char path[256], take[sizeof path + STORE_ID_CAP + 1];
    snprintf(path, sizeof path, "%s/store", r->mount);
    struct store *s = open_store(path);
    int n = store_list(s, ids, IDS_MAX);
    check_committed(r, end, ids, n);
    check_leftovers(path);
    for (int i = 0; i < n; i++) {
        snprintf(take, sizeof take, "%s/%.*s", path, STORE_ID_CAP - 1, ids[i]);
        if (store_verify(take))
            die(ids[i], err_text());
    }
    commit(s, more);
    if (listed(more, ids, n))
        die(more, "is the name of two takes");
    store_close(s);
    r->seen[n]++;
}

static void check(struct replay *r, int end, enum kind kind)
{
    cut(r, end, kind);
    if (mount(r->device, r->mount, "ext4", 0, ""))
        die("mount", strerror(errno));
    check_store(r, end);
    if (umount(r->mount))
        die("umount", strerror(errno));
    r->cuts++;
}

static bool pending(const struct replay *r, int end)
{
    for (int i = r->flushed; i < end; i++)
        if (entry_of(r, i)->n_sectors > 0 && !(entry_of(r, i)->flags & (MARK | DISCARD)))
            return true;
    return false;
}

/* A cut behind entry i - 1; what that one settles is settled for all later ones. */
static void step(struct replay *r, int i)
{
    const struct entry *e = entry_of(r, i - 1);
    if (e->flags & FLUSHED) {
        for (int k = r->flushed; k < i - 1; k++)
            apply(r, k, r->disk, entry_of(r, k)->n_sectors);
        r->flushed = i - 1;
    }
    // Without what is pending, the disk is as before.
    for (int kind = e->flags & (FLUSHED | FORCED | MARK) ? NONE : ALL; kind < KINDS; kind++)
        if (kind == NONE || pending(r, i))
            check(r, i, (enum kind)kind);
}

static int first_mark(const struct replay *r)
{
    for (int i = 0; i < r->n; i++)
        if (mark_of(r, i))
            return i;
    die("log", "no mark");
    return 0;
}

static int replay(char **argv)
{
    struct replay r = {.device = argv[2], .mount = argv[3], .seed = 1};
    index_log(&r, argv[0]);
    r.disk = load(argv[1], &r.bytes);
    r.work = open(r.device, O_WRONLY);
    if (r.work < 0)
        die(r.device, strerror(errno));
    int first = first_mark(&r); // the store's folder is there, mounted and synced
    for (int i = 0; i < first; i++)
        apply(&r, i, r.disk, entry_of(&r, i)->n_sectors);
    r.flushed = first;
    for (int i = first + 1; i <= r.n; i++)
        step(&r, i);
    printf("%d writes and marks, %d cuts; so many times so many takes:", r.n - first, r.cuts);
    for (int n = 0; n <= IDS_MAX; n++)
        if (r.seen[n])
            printf(" %d:%d", n, r.seen[n]);
    putchar('\n');
    close(r.work);
    free(r.disk);
    return 0;
}

int main(int argc, char **argv)
{
    if (argc == 3 && !strcmp(argv[1], "commit"))
        return commit_one(argv[2]);
    if (argc == 6 && !strcmp(argv[1], "replay"))
        return replay(argv + 2);
    fprintf(stderr, "usage: powercut commit STORE | replay LOG BASE WORK MOUNT\n");
    return 2;
}
