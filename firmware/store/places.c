/* A look at the folder of the store, from the newest take down. */
#include "firmware/store/places.h"

#include "firmware/store/manifest.h"
#include "firmware/store/store_fs.h"

#include "drivers/format/file.h"
#include "drivers/format/json.h"

#include <stdlib.h>
#include <string.h>

enum { LIST_MAX = 8192 }; // takes looked at

/* Session of a take by its manifest. False: it cannot be read. */
static bool read_session(const char *store, const char *id, char session[STORE_ID_CAP],
                         struct develop *balance)
{
    char dir[FILE_PATH_CAP], path[FILE_PATH_CAP];
    double red, blue;
    struct cJSON *doc;
    if (file_join(store, id, dir) != OK || file_join(dir, MANIFEST_FILE, path) != OK ||
        json_read(path, &doc) != OK)
        return false;
    const char *text = json_string(json_member(doc, "session"));
    snprintf(session, STORE_ID_CAP, "%s", text && store_is_id(text) ? text : "");
    *balance = (struct develop){0};
    if (json_number(json_member(doc, "white_red"), &red) &&
        json_number(json_member(doc, "white_blue"), &blue) && red > 0 && blue > 0)
        *balance = (struct develop){(float)red, (float)blue};
    json_free(doc);
    return true;
}

/* "ID\n"; false: the file is missing or not ours. */
static bool read_ended(const char *path, char session[STORE_ID_CAP])
{
    size_t n;
    if (store_fs_read(&store_fs_system, path, session, STORE_ID_CAP - 1, &n) != OK)
        return false;
    session[n] = 0;
    if (n == 0 || session[n - 1] != '\n')
        return false;
    session[n - 1] = 0;
    return store_is_id(session);
}

static void reverse_places(struct places *p)
{
    for (int i = 0, j = p->n - 1; i < j; i++, j--) {
        char swap[STORE_ID_CAP];
        memcpy(swap, p->take[i], sizeof swap);
        memcpy(p->take[i], p->take[j], sizeof swap);
        memcpy(p->take[j], swap, sizeof swap);
    }
}

/* session "": that of the newest complete take. */
static void collect_places(const char *store, const char *session, char (*ids)[STORE_ID_CAP],
                           struct places *out)
{
    char of[STORE_ID_CAP];
    bool is_aborted, of_aborted;
    struct develop balance;
    int n = store_list_in(store, ids, LIST_MAX);
    snprintf(out->id, sizeof out->id, "%s", session);
    for (int i = 0; i < n && out->n < PLACES_MAX; i++) {
        uint64_t number = store_number(ids[i], &is_aborted);
        if (out->id[0] && number < store_number(out->id, &of_aborted)) // older than the session
            break;
        if (is_aborted || !read_session(store, ids[i], of, &balance))
            continue;
        if (!out->id[0] && !of[0])
            break;
        if (!out->id[0])
            memcpy(out->id, of, sizeof of);
        if (strcmp(of, out->id) != 0)
            continue;
        memcpy(out->take[out->n++], ids[i], STORE_ID_CAP);
        out->balance = balance; // in the end that of the oldest
    }
    reverse_places(out);
}

err_t places_of(const char *store, const char *session, struct places *out)
{
    char(*ids)[STORE_ID_CAP] = calloc(LIST_MAX, sizeof *ids);
    *out = (struct places){0};
    if (!ids)
        return err_fail(ERR_NOMEM, "%s: no memory for %d captures", store, LIST_MAX);
    collect_places(store, session, ids, out);
    free(ids);
    return OK;
}

err_t places_open(const char *store, struct places *out)
{
    char path[FILE_PATH_CAP], ended[STORE_ID_CAP];
    err_t e = places_of(store, "", out);
    if (!e && file_join(store, STORE_SESSION_ENDED, path) == OK && read_ended(path, ended) &&
        strcmp(out->id, ended) == 0)
        *out = (struct places){0};
    return e;
}

err_t places_end(const char *store, const char *session)
{
    char path[FILE_PATH_CAP], tmp[FILE_PATH_CAP], text[STORE_ID_CAP + 1];
    const struct store_fs *fs = &store_fs_system;
    err_t e = file_join(store, STORE_SESSION_ENDED, path);
    if (!e)
        e = file_join(store, ".tmp-" STORE_SESSION_ENDED, tmp);
    if (!e && file_exists(path) && !read_ended(path, text))
        e = err_fail(ERR_ARG, "%s: already exists and was not written by hdrig", path);
    if (e)
        return e;
    int n = snprintf(text, sizeof text, "%s\n", session);
    fs->unlink(tmp); // left by an end that failed
    e = store_fs_write(fs, tmp, text, (size_t)n);
    if (!e && fs->rename(tmp, path, 0) != 0)
        e = err_fail(ERR_IO, "%s: cannot be replaced", path);
    return e ? e : store_fs_sync_dir(fs, store);
}
