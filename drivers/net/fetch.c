/* Every byte of a file goes through the hash once: what is there already before the request, the
 * rest as it arrives. So a transfer can be judged when it ends, and a file that was begun by
 * somebody else, or by a machine that lost its power, shows up. A transfer that began at byte 0
 * fails if the hash is wrong; one that continued starts again at byte 0, so it ends after two. */
#include "drivers/net/fetch.h"

#include "core/base/sha256.h"
#include "drivers/format/file.h"

#include <curl/curl.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

enum {
    POLL_MS = 100,
    SLOW_BYTES = 1000, // a second
    CONNECTIONS = 64,  // that are kept
    HEAD_MAX = 1 << 15,
    READ_BYTES = 1 << 18
};

struct fetcher;

struct transfer {
    struct fetcher *f;
    const struct fetch_item *item; // NULL: free
    CURL *curl;
    int fd;
    uint64_t from; // the request begins with this byte
    uint64_t at;   // bytes in the file, all of them in the hash
    struct sha256 hash;
    bool judged;   // the head of the answer was
    size_t head;   // bytes of it
    err_t err;     // found while bytes arrived; ERR_AGAIN: start at byte 0
    char why[512]; // its sentence
    char text[CURL_ERROR_SIZE];
};

struct fetcher {
    const struct fetch_config *cfg;
    CURLM *multi;
    struct curl_slist *headers;
    int busy; // transfers under way
    uint64_t done, told, all;
    struct transfer slot[FETCH_PARALLEL_MAX];
};

static bool is_cancelled(const struct fetcher *f)
{
    return f->cfg->cancel && atomic_load(f->cfg->cancel);
}

static err_t item_fail(const struct transfer *t, err_t code, const char *why)
{
    return err_fail(code, "%s to %s: %s", t->item->url, t->item->path, why);
}

static err_t disk_fail(const struct transfer *t, const char *what)
{
    return err_fail(file_code(errno), "%s: cannot %s: %s", t->item->path, what, strerror(errno));
}

/* ---- the file ---- */

static err_t empty_file(struct transfer *t)
{
    t->f->done -= t->at;
    t->from = t->at = 0;
    sha256_init(&t->hash);
    return ftruncate(t->fd, 0) == 0 ? OK : disk_fail(t, "empty it");
}

static err_t append_bytes(struct transfer *t, const char *p, size_t n)
{
    sha256_add(&t->hash, p, n);
    for (size_t i = 0; i < n;) {
        ssize_t put = pwrite(t->fd, p + i, n - i, (off_t)(t->at + i));
        if (put < 0 && errno != EINTR)
            return disk_fail(t, "write");
        i += put > 0 ? (size_t)put : 0;
    }
    t->at += n;
    t->f->done += n;
    return OK;
}

/* Hash what is there. */
static err_t read_begun(struct transfer *t, uint64_t size)
{
    char *buffer = malloc(READ_BYTES);
    if (!buffer)
        return item_fail(t, ERR_NOMEM, "no memory to read what is there");
    err_t e = OK;
    while (!e && t->at < size) {
        size_t want = size - t->at < READ_BYTES ? (size_t)(size - t->at) : READ_BYTES;
        ssize_t n = pread(t->fd, buffer, want, (off_t)t->at);
        if (n < 0 && errno != EINTR)
            e = disk_fail(t, "read");
        else if (n == 0)
            break; // somebody made it shorter
        else if (is_cancelled(t->f))
            e = item_fail(t, ERR_CANCELLED, "cancelled");
        if (!e && n > 0) {
            sha256_add(&t->hash, buffer, (size_t)n);
            t->at += (uint64_t)n;
            t->f->done += (uint64_t)n;
        }
    }
    free(buffer);
    return e;
}

static err_t open_file(struct transfer *t)
{
    struct stat st;
    t->fd = open(t->item->path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK, 0666);
    if (t->fd < 0 || fstat(t->fd, &st) != 0)
        return disk_fail(t, "open");
    if (!S_ISREG(st.st_mode))
        return item_fail(t, ERR_ARG, "no regular file");
    sha256_init(&t->hash);
    if ((uint64_t)st.st_size > t->item->bytes)
        return empty_file(t);
    err_t e = read_begun(t, (uint64_t)st.st_size);
    t->from = t->at;
    return e;
}

static bool is_right(const struct transfer *t)
{
    struct sha256 h = t->hash;
    char hex[SHA256_HEX_CAP];
    return strcasecmp(sha256_hex(&h, hex), t->item->sha256) == 0;
}

static void free_slot(struct transfer *t)
{
    if (t->fd >= 0)
        close(t->fd);
    t->fd = -1;
    t->item = NULL;
}

static err_t finish_file(struct transfer *t)
{
    err_t e = fsync(t->fd) == 0 ? OK : disk_fail(t, "sync");
    free_slot(t);
    return e;
}

/* ---- the answer ---- */

static err_t status_fail(const struct transfer *t, long status)
{
    char why[64];
    snprintf(why, sizeof why, "HTTP status %ld", status);
    switch (status) {
    case 401:
    case 403:
        return item_fail(t, ERR_ARG, "the server refuses our token");
    case 404:
    case 410:
        return item_fail(t, ERR_IO, "the server has no such file");
    case 429:
    case 503:
        return item_fail(t, ERR_BUSY, why);
    default:
        return item_fail(t, ERR_IO, why);
    }
}

/* "bytes FROM-LAST/SIZE", exactly as asked. */
static bool has_range(const struct transfer *t)
{
    char want[96];
    struct curl_header *h;
    snprintf(want, sizeof want, "bytes %" PRIu64 "-%" PRIu64 "/%" PRIu64, t->from,
             t->item->bytes - 1, t->item->bytes);
    return curl_easy_header(t->curl, "Content-Range", 0, CURLH_HEADER, -1, &h) == CURLHE_OK &&
           strcmp(h->value, want) == 0;
}

static err_t judge_head(struct transfer *t)
{
    long status = 0;
    curl_off_t length = -1;
    t->judged = true;
    curl_easy_getinfo(t->curl, CURLINFO_RESPONSE_CODE, &status);
    curl_easy_getinfo(t->curl, CURLINFO_CONTENT_LENGTH_DOWNLOAD_T, &length);
    if (status == 416 && t->from > 0)
        return ERR_AGAIN;
    if (status != 200 && (status != 206 || t->from == 0))
        return status_fail(t, status);
    if (status == 206 && !has_range(t))
        return item_fail(t, ERR_FORMAT, "the server sends another range than asked for");
    if (status == 200 && t->from > 0) {
        err_t e = empty_file(t);
        if (e)
            return e;
    }
    if (length >= 0 && (uint64_t)length != t->item->bytes - t->from)
        return err_fail(ERR_FORMAT,
                        "%s to %s: the server has %" PRIu64 " bytes, announced were %" PRIu64,
                        t->item->url, t->item->path, (uint64_t)length + t->from, t->item->bytes);
    return OK;
}

/* The sentence too: another transfer may fail before this one is collected. */
static void keep_error(struct transfer *t, err_t e)
{
    t->err = e;
    snprintf(t->why, sizeof t->why, "%s", e && e != ERR_AGAIN ? err_text() : "");
}

static err_t take_body(struct transfer *t, const char *p, size_t n)
{
    err_t e = t->judged ? OK : judge_head(t);
    if (!e && n > t->item->bytes - t->at)
        e = err_fail(ERR_FORMAT,
                     "%s to %s: the server sends more than the announced %" PRIu64 " bytes",
                     t->item->url, t->item->path, t->item->bytes);
    return e ? e : append_bytes(t, p, n);
}

static size_t on_body(char *p, size_t size, size_t n, void *ctx)
{
    struct transfer *t = ctx;
    n *= size;
    keep_error(t, take_body(t, p, n));
    return t->err ? 0 : n;
}

/* The library would keep any number of them. */
static size_t on_header(char *p, size_t size, size_t n, void *ctx)
{
    struct transfer *t = ctx;
    (void)p;
    n *= size;
    t->head += n;
    if (t->head > HEAD_MAX && !t->err)
        keep_error(t, item_fail(t, ERR_FORMAT, "the server sends endless headers"));
    return t->err ? 0 : n;
}

static err_t transport_fail(const struct transfer *t, CURLcode rc)
{
    const char *text = t->text[0] ? t->text : curl_easy_strerror(rc);
    switch (rc) {
    case CURLE_COULDNT_RESOLVE_HOST:
    case CURLE_COULDNT_CONNECT:
    case CURLE_GOT_NOTHING:
    case CURLE_SEND_ERROR:
    case CURLE_RECV_ERROR:
    case CURLE_PARTIAL_FILE:
        return item_fail(t, ERR_LOST, text);
    case CURLE_OPERATION_TIMEDOUT:
        return item_fail(t, ERR_TIMEOUT, text);
    case CURLE_OUT_OF_MEMORY:
        return item_fail(t, ERR_NOMEM, text);
    case CURLE_URL_MALFORMAT:
        return item_fail(t, ERR_ARG, text);
    case CURLE_WEIRD_SERVER_REPLY:
    case CURLE_UNSUPPORTED_PROTOCOL: // "HTTP/0.9"
        return item_fail(t, ERR_FORMAT, text);
    default:
        return item_fail(t, ERR_IO, text);
    }
}

/* ---- transfers ---- */

static err_t request_file(struct transfer *t)
{
    const struct fetch_config *g = t->f->cfg;
    CURL *c = t->curl;
    char range[32];
    t->judged = false;
    t->head = 0;
    t->err = OK;
    t->text[0] = 0;
    snprintf(range, sizeof range, "%" PRIu64 "-", t->from);
    curl_easy_reset(c); // keeps connections
    bool ok = curl_easy_setopt(c, CURLOPT_URL, t->item->url) == CURLE_OK &&
              curl_easy_setopt(c, CURLOPT_PROTOCOLS_STR, "http,https") == CURLE_OK &&
              curl_easy_setopt(c, CURLOPT_RANGE, t->from ? range : NULL) == CURLE_OK &&
              curl_easy_setopt(c, CURLOPT_NOPROXY, "*") == CURLE_OK;
    curl_easy_setopt(c, CURLOPT_HTTP_VERSION, (long)CURL_HTTP_VERSION_1_1);
    curl_easy_setopt(c, CURLOPT_FOLLOWLOCATION, 0L);
    curl_easy_setopt(c, CURLOPT_HTTPHEADER, t->f->headers);
    curl_easy_setopt(c, CURLOPT_NOSIGNAL, 1L);
    curl_easy_setopt(c, CURLOPT_CONNECTTIMEOUT_MS, (long)FETCH_CONNECT_MS);
    curl_easy_setopt(c, CURLOPT_LOW_SPEED_LIMIT, (long)SLOW_BYTES);
    curl_easy_setopt(c, CURLOPT_LOW_SPEED_TIME, (long)(g->stall_s ? g->stall_s : FETCH_STALL_S));
    curl_easy_setopt(c, CURLOPT_ERRORBUFFER, t->text);
    curl_easy_setopt(c, CURLOPT_WRITEFUNCTION, on_body);
    curl_easy_setopt(c, CURLOPT_WRITEDATA, t);
    curl_easy_setopt(c, CURLOPT_HEADERFUNCTION, on_header);
    curl_easy_setopt(c, CURLOPT_HEADERDATA, t);
    curl_easy_setopt(c, CURLOPT_PRIVATE, t);
    if (!ok || curl_multi_add_handle(t->f->multi, c) != CURLM_OK)
        return item_fail(t, ERR_NOMEM, "no memory for a request");
    t->f->busy++;
    return OK;
}

/* May be done at once: the file is there. */
static err_t begin_item(struct transfer *t, const struct fetch_item *item)
{
    t->item = item;
    t->from = t->at = 0;
    err_t e = open_file(t);
    if (!e && t->at == item->bytes && is_right(t))
        return finish_file(t);
    if (!e && t->at == item->bytes)
        e = empty_file(t);
    return e ? e : request_file(t);
}

static err_t judge_end(struct transfer *t, CURLcode rc)
{
    if (t->err)
        return t->err == ERR_AGAIN ? t->err : err_fail(t->err, "%s", t->why);
    if (rc != CURLE_OK)
        return transport_fail(t, rc);
    err_t e = t->judged ? OK : judge_head(t); // there was no body
    if (e)
        return e;
    if (t->at != t->item->bytes)
        return err_fail(ERR_FORMAT,
                        "%s to %s: the server sends %" PRIu64 " bytes, announced were %" PRIu64,
                        t->item->url, t->item->path, t->at, t->item->bytes);
    if (is_right(t))
        return OK;
    if (t->from > 0)
        return ERR_AGAIN;
    unlink(t->item->path);
    return item_fail(t, ERR_FORMAT, "the bytes are others than announced: wrong SHA-256");
}

static err_t end_transfer(struct transfer *t, CURLcode rc)
{
    err_t e = judge_end(t, rc);
    curl_multi_remove_handle(t->f->multi, t->curl);
    t->f->busy--;
    if (e == ERR_AGAIN) {
        e = empty_file(t);
        return e ? e : request_file(t);
    }
    return e ? e : finish_file(t);
}

static err_t collect_ended(struct fetcher *f)
{
    CURLMsg *m;
    int left;
    err_t e = OK;
    while (!e && (m = curl_multi_info_read(f->multi, &left)) != NULL) {
        void *t = NULL;
        CURLcode rc = m->data.result; // *m is gone with the handle
        curl_easy_getinfo(m->easy_handle, CURLINFO_PRIVATE, &t);
        e = end_transfer(t, rc);
    }
    return e;
}

static void tell_progress(struct fetcher *f)
{
    if (f->cfg->progress && f->done != f->told)
        f->cfg->progress(f->cfg->ctx, f->done, f->all);
    f->told = f->done;
}

static err_t fill_slots(struct fetcher *f, const struct fetch_item *items, int n, int *next)
{
    err_t e = OK;
    for (int i = 0; i < f->cfg->parallel && !e; i++)
        while (!e && !f->slot[i].item && *next < n) {
            e = is_cancelled(f) ? err_fail(ERR_CANCELLED, "cancelled")
                                : begin_item(&f->slot[i], &items[*next]);
            *next += 1;
            tell_progress(f);
        }
    return e;
}

static err_t run_transfers(struct fetcher *f, const struct fetch_item *items, int n)
{
    int next = 0, running;
    err_t e = OK;
    while (!e) {
        e = fill_slots(f, items, n, &next);
        if (e || f->busy == 0)
            break;
        if (curl_multi_perform(f->multi, &running) != CURLM_OK)
            return err_fail(ERR_NOMEM, "transfers: no memory");
        e = collect_ended(f);
        tell_progress(f);
        if (!e && is_cancelled(f))
            e = err_fail(ERR_CANCELLED, "cancelled");
        if (!e && f->busy && running)
            curl_multi_poll(f->multi, NULL, 0, POLL_MS, NULL);
    }
    return e;
}

/* Names last, too: the folders, each once if its files stand together. */
static err_t sync_folders(const struct fetch_item *items, int n)
{
    char folder[FILE_PATH_CAP], before[FILE_PATH_CAP] = "";
    err_t e = OK;
    for (int i = 0; i < n && !e; i++) {
        e = file_parent(items[i].path, folder);
        if (!e && strcmp(folder, before) != 0)
            e = file_sync(folder);
        memcpy(before, folder, sizeof before);
    }
    return e;
}

/* ---- life ---- */

static err_t check_item(const struct fetch_item *t)
{
    if (strncmp(t->url, "http://", 7) != 0 && strncmp(t->url, "https://", 8) != 0)
        return err_fail(ERR_ARG, "%s: neither http:// nor https://", t->url);
    if (strspn(t->sha256, "0123456789abcdefABCDEF") != SHA256_HEX_CAP - 1 ||
        t->sha256[SHA256_HEX_CAP - 1])
        return err_fail(ERR_ARG, "%s: its SHA-256 has 64 hexadecimal digits", t->url);
    if (t->bytes > INT64_MAX)
        return err_fail(ERR_ARG, "%s: no file has %" PRIu64 " bytes", t->url, t->bytes);
    return OK;
}

static err_t check_config(const struct fetch_config *cfg)
{
    if (cfg->parallel < 1 || cfg->parallel > FETCH_PARALLEL_MAX)
        return err_fail(ERR_ARG, "transfers: %d at a time, allowed are 1 to %d", cfg->parallel,
                        FETCH_PARALLEL_MAX);
    if (cfg->token && strpbrk(cfg->token, "\r\n"))
        return err_fail(ERR_ARG, "transfers: the token has several lines");
    return OK;
}

static err_t make_headers(struct fetcher *f)
{
    char *line = NULL;
    if (!f->cfg->token)
        return OK;
    if (asprintf(&line, "Authorization: Bearer %s", f->cfg->token) < 0)
        line = NULL;
    f->headers = line ? curl_slist_append(NULL, line) : NULL;
    free(line);
    return f->headers ? OK : err_fail(ERR_NOMEM, "transfers: no memory");
}

/* Kept from one call to the next, with their connections. */
static err_t open_handles(struct fetcher *f)
{
    for (int i = 0; i < f->cfg->parallel; i++) {
        struct transfer *t = &f->slot[i];
        t->curl = t->curl ? t->curl : curl_easy_init();
        if (!t->curl)
            return err_fail(ERR_NOMEM, "transfers: no memory");
    }
    return OK;
}

/* What is still under way breaks off. */
static void end_call(struct fetcher *f)
{
    for (int i = 0; i < FETCH_PARALLEL_MAX; i++) {
        if (f->slot[i].curl)
            curl_multi_remove_handle(f->multi, f->slot[i].curl);
        free_slot(&f->slot[i]);
    }
    curl_slist_free_all(f->headers);
    f->headers = NULL;
}

static void init_library(void)
{
    curl_global_init(CURL_GLOBAL_DEFAULT);
}

err_t fetch_open(struct fetcher **out)
{
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    pthread_once(&once, init_library);
    struct fetcher *f = calloc(1, sizeof *f);
    CURLM *multi = f ? curl_multi_init() : NULL;
    *out = NULL;
    if (!multi) {
        free(f);
        return err_fail(ERR_NOMEM, "transfers: no memory");
    }
    f->multi = multi;
    curl_multi_setopt(multi, CURLMOPT_MAXCONNECTS, (long)CONNECTIONS);
    for (int i = 0; i < FETCH_PARALLEL_MAX; i++)
        f->slot[i] = (struct transfer){.f = f, .fd = -1};
    *out = f;
    return OK;
}

void fetch_close(struct fetcher *f)
{
    if (!f)
        return;
    for (int i = 0; i < FETCH_PARALLEL_MAX; i++)
        curl_easy_cleanup(f->slot[i].curl);
    curl_multi_cleanup(f->multi);
    free(f);
}

err_t fetch_files(struct fetcher *f, const struct fetch_config *cfg, const struct fetch_item *items,
                  int n)
{
    err_t e = check_config(cfg);
    for (int i = 0; i < n && !e; i++)
        e = check_item(&items[i]);
    if (e)
        return e;
    f->cfg = cfg;
    f->busy = 0;
    f->done = f->told = f->all = 0;
    for (int i = 0; i < n; i++)
        f->all += items[i].bytes;
    e = make_headers(f);
    if (!e)
        e = open_handles(f);
    if (!e)
        e = run_transfers(f, items, n);
    if (!e)
        e = sync_folders(items, n);
    end_call(f);
    return e;
}
