/* The one file that knows libzip. */
#include "drivers/format/zipfile.h"

#include <stdlib.h>
#include <zip.h>

static err_t zip_fail(const char *what, const char *member, zip_error_t *z)
{
    err_t code = zip_error_code_zip(z) == ZIP_ER_MEMORY   ? ERR_NOMEM
                 : zip_error_system_type(z) == ZIP_ET_SYS ? ERR_IO
                                                          : ERR_FORMAT;
    return err_fail(code, "%s%s%s: %s", what, *member ? ": " : "", member, zip_error_strerror(z));
}

err_t zipfile_open(const char *path, struct zipfile *out)
{
    zip_error_t why;
    int code;
    *out = (struct zipfile){path, zip_open(path, ZIP_RDONLY, &code)};
    if (out->zip)
        return OK;
    *out = (struct zipfile){0};
    zip_error_init_with_code(&why, code);
    err_t e = zip_fail(path, "", &why);
    zip_error_fini(&why);
    return e;
}

err_t zipfile_open_bytes(const char *what, const void *p, size_t n, struct zipfile *out)
{
    zip_error_t why;
    err_t e = OK;
    zip_error_init(&why);
    zip_source_t *source = zip_source_buffer_create(p, n, 0, &why);
    *out = (struct zipfile){what, source ? zip_open_from_source(source, ZIP_RDONLY, &why) : NULL};
    if (!out->zip) {
        zip_source_free(source);
        e = zip_fail(what, "", &why);
        *out = (struct zipfile){0};
    }
    zip_error_fini(&why);
    return e;
}

void zipfile_close(struct zipfile *z)
{
    if (z->zip)
        zip_discard(z->zip);
    *z = (struct zipfile){0};
}

uint64_t zipfile_count(const struct zipfile *z)
{
    zip_int64_t n = zip_get_num_entries(z->zip, 0);
    return n > 0 ? (uint64_t)n : 0;
}

const char *zipfile_name(const struct zipfile *z, uint64_t index)
{
    return zip_get_name(z->zip, index, 0);
}

/* For sentences. */
static const char *member_name(const struct zipfile *z, uint64_t index)
{
    const char *name = zipfile_name(z, index);
    return name ? name : "a member";
}

bool zipfile_find(const struct zipfile *z, const char *name, uint64_t *index)
{
    zip_int64_t i = zip_name_locate(z->zip, name, 0);
    *index = i < 0 ? 0 : (uint64_t)i;
    return i >= 0;
}

err_t zipfile_look(const struct zipfile *z, uint64_t index, struct zipfile_info *out)
{
    zip_stat_t st;
    const zip_uint64_t need =
        ZIP_STAT_SIZE | ZIP_STAT_COMP_SIZE | ZIP_STAT_COMP_METHOD | ZIP_STAT_ENCRYPTION_METHOD;
    *out = (struct zipfile_info){0};
    if (zip_stat_index(z->zip, index, 0, &st) != 0)
        return zip_fail(z->what, "", zip_get_error(z->zip));
    if ((st.valid & need) != need)
        return err_fail(ERR_FORMAT, "%s: %s has no size", z->what, member_name(z, index));
    out->bytes = st.size;
    out->stored = st.comp_method == ZIP_CM_STORE && st.encryption_method == ZIP_EM_NONE &&
                  st.size == st.comp_size;
    return OK;
}

err_t zipfile_read(const struct zipfile *z, uint64_t index, uint64_t at, void *out, size_t n)
{
    const char *name = member_name(z, index);
    char more;
    zip_file_t *f = zip_fopen_index(z->zip, index, 0);
    if (!f)
        return zip_fail(z->what, name, zip_get_error(z->zip));
    err_t e = at == 0 || zip_fseek(f, (zip_int64_t)at, SEEK_SET) == 0
                  ? OK
                  : zip_fail(z->what, name, zip_file_get_error(f));
    for (size_t got = 0; got < n && !e;) {
        zip_int64_t more_bytes = zip_fread(f, (char *)out + got, n - got);
        if (more_bytes < 0)
            e = zip_fail(z->what, name, zip_file_get_error(f));
        else if (more_bytes == 0)
            e = err_fail(ERR_FORMAT, "%s: %s ends after %zu of %zu bytes", z->what, name, got, n);
        else
            got += (size_t)more_bytes;
    }
    if (!e && zip_fread(f, &more, 1) < 0) // at the end: the checksum
        e = zip_fail(z->what, name, zip_file_get_error(f));
    zip_fclose(f);
    return e;
}

err_t zipfile_load(const struct zipfile *z, uint64_t index, size_t max, void **out, size_t *n)
{
    struct zipfile_info info;
    *out = NULL;
    err_t e = zipfile_look(z, index, &info);
    if (!e && info.bytes > max)
        e = err_fail(ERR_FORMAT, "%s: %s has %ju bytes, at most %zu are read", z->what,
                     member_name(z, index), (uintmax_t)info.bytes, max);
    if (e)
        return e;
    *n = (size_t)info.bytes;
    *out = malloc(*n + 1);
    e = *out ? zipfile_read(z, index, 0, *out, *n)
             : err_fail(ERR_NOMEM, "%s: no memory for %zu bytes", z->what, *n);
    if (e) {
        free(*out);
        *out = NULL;
    }
    return e;
}
