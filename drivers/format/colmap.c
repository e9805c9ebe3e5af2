/* The readers of both formats fill the same records (struct colmap_camera, struct rig_view,
 * struct colmap_point) and the checks are made on those. Text is taken line by line as COLMAP
 * itself does: in images.txt every image line is followed by one line of image points, which may be
 * empty. */
#include "drivers/format/colmap.h"

#include "core/base/bytes.h"
#include "drivers/format/file.h"
#include "drivers/format/name.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    LINE_CAP = 1024, // bytes of a text line that are read
    POINTS_MAX = 1 << 26,
    POINT_BYTES_BINARY = 51, // of a point without track
    IMAGE_POINT_BYTES = 24,  // x, y, point id
    TRACK_BYTES = 8,         // image id, index
    POINT_BYTES_TEXT = 14    // "1 0 0 0 0 0 0\n"
};

static const size_t FILE_BYTES_MAX = (size_t)4
                                     << 30; // image points of large reconstructions take gigabytes

/* colmap/src/colmap/sensor/models.h: ids 0 to 10 in this order. */
static const char *const models[] = {"SIMPLE_PINHOLE",
                                     "PINHOLE",
                                     "SIMPLE_RADIAL",
                                     "RADIAL",
                                     "OPENCV",
                                     "OPENCV_FISHEYE",
                                     "FULL_OPENCV",
                                     "FOV",
                                     "SIMPLE_RADIAL_FISHEYE",
                                     "RADIAL_FISHEYE",
                                     "THIN_PRISM_FISHEYE"};
enum { N_MODELS = sizeof models / sizeof models[0], SIMPLE_PINHOLE = 0, SIMPLE_PINHOLE_PARAMS = 3 };

/* A camera of COLMAP, which its images share. */
struct colmap_camera {
    uint32_t id;
    int model, w, h;
    double params[LENS_PARAMS];
};

struct colmap_cameras {
    const char *what;
    bool folders; // names of images are FOLDER_NAME
    int n;
    struct colmap_camera *v; // (n)
};

/* ---- checks common to both formats ---- */

static int n_params(int model)
{
    return model == SIMPLE_PINHOLE ? SIMPLE_PINHOLE_PARAMS : lens_count(lens_find(models[model]));
}

static err_t find_model(const char *what, int id, const char *name, int *out)
{
    int i = 0;
    while (i < N_MODELS && (name ? strcmp(models[i], name) != 0 : i != id))
        i++;
    *out = i;
    if (i == SIMPLE_PINHOLE || (i < N_MODELS && lens_find(models[i]) < LENS_MODELS))
        return OK;
    const char *said = i < N_MODELS ? models[i] : name;
    if (said)
        return err_fail(ERR_UNSUPPORTED,
                        "%s: camera model %s is not read; undistort the images to PINHOLE", what,
                        said);
    return err_fail(ERR_UNSUPPORTED, "%s: camera model %d is not known", what, id);
}

static err_t add_camera(struct colmap_cameras *out, const struct colmap_camera *head)
{
    for (int i = 0; i < out->n; i++)
        if (out->v[i].id == head->id)
            return err_fail(ERR_FORMAT, "%s: camera %u is there twice", out->what, head->id);
    out->v[out->n++] = *head;
    return OK;
}

/* Numbers that no camera can have are refused where an image uses it. */
static err_t assign_camera(const char *what, const struct colmap_camera *p, struct rig_view *v)
{
    const double *a = p->params;
    struct lens l = {LENS_PINHOLE, a[0], a[0], a[1], a[2], {0}, 0};
    if (p->model != SIMPLE_PINHOLE &&
        lens_from_params(lens_find(models[p->model]), a, n_params(p->model), &l) != OK)
        return err_fail(ERR_FORMAT, "%s: %s: camera %u: %s", what, v->name, p->id, err_text());
    return cameras_set_lens(what, v->name, &l, v);
}

static err_t add_view(const char *what, const struct colmap_cameras *cameras, uint32_t camera_id,
                      struct rig_view *v)
{
    const struct colmap_camera *p = NULL;
    for (int i = 0; i < cameras->n; i++)
        if (cameras->v[i].id == camera_id)
            p = &cameras->v[i];
    if (!p)
        return err_fail(ERR_FORMAT, "%s: image %s is of camera %u, which %s lacks", what, v->name,
                        camera_id, cameras->what);
    v->cam.w = p->w;
    v->cam.h = p->h;
    err_t e = assign_camera(what, p, v);
    return e ? e : cameras_check(what, v->name, &v->cam);
}

static err_t set_size(const char *what, uint64_t w, uint64_t h, struct colmap_camera *out)
{
    if (w > INT32_MAX || h > INT32_MAX)
        return err_fail(ERR_FORMAT, "%s: camera %u has %ju x %ju px", what, out->id, (uintmax_t)w,
                        (uintmax_t)h);
    out->w = (int)w;
    out->h = (int)h;
    return OK;
}

static void set_pose(const double pose[7], struct camera *cam)
{
    for (int k = 0; k < 4; k++)
        cam->q[k] = (float)pose[k];
    for (int k = 0; k < 3; k++)
        cam->t[k] = (float)pose[4 + k];
}

static void add_point(const double xyz[3], const uint8_t rgb[3], struct colmap_points *out)
{
    struct colmap_point *p = &out->p[out->n];
    for (int k = 0; k < 3; k++) {
        p->xyz[k] = (float)xyz[k];
        p->rgb[k] = rgb[k];
    }
    out->n += isfinite(p->xyz[0]) && isfinite(p->xyz[1]) && isfinite(p->xyz[2]);
}

static err_t cut_short(const struct colmap_text *t, const char *object, uint64_t i, uint64_t n)
{
    return err_fail(ERR_FORMAT, "%s: ends inside %s %ju of %ju", t->what, object, (uintmax_t)i,
                    (uintmax_t)n);
}

/* ---- binary ---- */

/* The number of objects at the head of a file, at most max. */
static err_t read_count(const struct colmap_text *t, struct bytes *b, const char *objects,
                        uint64_t max, uint64_t *out)
{
    *out = bytes_u64(b);
    if (b->bad)
        return err_fail(ERR_FORMAT, "%s: %zu bytes hold no number of %s", t->what, t->n, objects);
    if (*out > max)
        return err_fail(ERR_FORMAT, "%s: %ju %s, at most %ju are read", t->what, (uintmax_t)*out,
                        objects, (uintmax_t)max);
    return OK;
}

static err_t read_binary_cameras(const struct colmap_text *t, struct colmap_cameras *out)
{
    struct bytes b = bytes_of(t->p, t->n);
    uint64_t n;
    err_t e = read_count(t, &b, "cameras", CAMERAS_MAX, &n);
    if (e)
        return e;
    for (uint64_t i = 0; i < n; i++) {
        struct colmap_camera head = {.id = bytes_u32(&b)};
        int model_id = (int)bytes_u32(&b);
        uint64_t w = bytes_u64(&b), h = bytes_u64(&b);
        if (b.bad)
            return cut_short(t, "camera", i, n);
        e = find_model(t->what, model_id, NULL, &head.model);
        if (!e)
            e = set_size(t->what, w, h, &head);
        if (e)
            return e;
        for (int k = 0; k < n_params(head.model); k++)
            head.params[k] = bytes_f64(&b);
        if (b.bad)
            return cut_short(t, "camera", i, n);
        e = add_camera(out, &head);
        if (e)
            return e;
    }
    return OK;
}

static err_t read_binary_image(const struct colmap_text *t, struct bytes *b,
                               const struct colmap_cameras *cameras, struct rig *out)
{
    struct rig_view *v = &out->views[out->n];
    double pose[7];
    bytes_skip(b, 4, 1); // image id
    for (int k = 0; k < 7; k++)
        pose[k] = bytes_f64(b);
    uint32_t camera_id = bytes_u32(b);
    const char *path = (const char *)b->p;
    const char *end = b->left > 0 ? memchr(path, 0, b->left) : NULL;
    bytes_skip(b, end ? (size_t)(end - path) + 1 : SIZE_MAX, 1);
    bytes_skip(b, bytes_u64(b), IMAGE_POINT_BYTES);
    if (b->bad)
        return OK; // the caller knows the number of the image and says it
    err_t e = name_of_path(t->what, path, (size_t)(end - path), cameras->folders, v->name);
    if (e)
        return e;
    set_pose(pose, &v->cam);
    out->n++;
    return add_view(t->what, cameras, camera_id, v);
}

static err_t read_binary_images(const struct colmap_text *t, const struct colmap_cameras *cameras,
                                struct rig *out)
{
    struct bytes b = bytes_of(t->p, t->n);
    uint64_t n;
    err_t e = read_count(t, &b, "images", CAMERAS_MAX, &n);
    if (e)
        return e;
    for (uint64_t i = 0; i < n; i++) {
        e = read_binary_image(t, &b, cameras, out);
        if (e)
            return e;
        if (b.bad)
            return cut_short(t, "image", i, n);
    }
    return OK;
}

static err_t read_binary_points(const struct colmap_text *t, struct colmap_points *out)
{
    struct bytes b = bytes_of(t->p, t->n);
    uint64_t n;
    err_t e = read_count(t, &b, "points", POINTS_MAX, &n);
    if (e)
        return e;
    for (uint64_t i = 0; i < n; i++) {
        double xyz[3];
        uint8_t rgb[3];
        bytes_skip(&b, 8, 1); // point id
        for (int k = 0; k < 3; k++)
            xyz[k] = bytes_f64(&b);
        for (int k = 0; k < 3; k++)
            rgb[k] = bytes_u8(&b);
        bytes_skip(&b, 8, 1); // reprojection error
        bytes_skip(&b, bytes_u64(&b), TRACK_BYTES);
        if (b.bad)
            return cut_short(t, "point", i, n);
        add_point(xyz, rgb, out);
    }
    return OK;
}

/* ---- text ---- */

struct line_reader {
    const char *what;
    const char *p, *end;
    int number;
    char line[LINE_CAP]; // the current line without blanks at both ends; longer lines are cut
};

static struct line_reader lines_of(const struct colmap_text *t)
{
    return (struct line_reader){
        .what = t->what, .p = t->p, .end = t->n ? (const char *)t->p + t->n : t->p};
}

static bool is_blank(char c)
{
    return c == ' ' || c == '\t' || c == '\r';
}

static bool next_line(struct line_reader *r)
{
    if (r->p == r->end)
        return false;
    const char *stop = memchr(r->p, '\n', (size_t)(r->end - r->p));
    const char *from = r->p, *to = stop ? stop : r->end;
    r->p = stop ? stop + 1 : r->end;
    r->number++;
    while (from < to && is_blank(*from))
        from++;
    while (to > from && is_blank(to[-1]))
        to--;
    size_t n = (size_t)(to - from) < LINE_CAP ? (size_t)(to - from) : LINE_CAP - 1;
    memcpy(r->line, from, n);
    r->line[n] = 0;
    return true;
}

/* Next line that is neither empty nor a comment. */
static bool next_record(struct line_reader *r)
{
    while (next_line(r))
        if (r->line[0] && r->line[0] != '#')
            return true;
    return false;
}

static err_t read_numbers(const struct line_reader *r, const char **at, int n, double *out)
{
    for (int i = 0; i < n; i++) {
        char *end;
        out[i] = strtod(*at, &end);
        if (end == *at || (*end && !is_blank(*end)))
            return err_fail(ERR_FORMAT, "%s: line %d: \"%.24s\" where a number belongs", r->what,
                            r->number, *at);
        *at = end + strspn(end, " \t\r");
    }
    return OK;
}

/* Numbers that must be whole and fit 32 bits. */
static err_t read_whole(const struct line_reader *r, const char **at, int n, uint32_t *out)
{
    for (int i = 0; i < n; i++) {
        double v;
        err_t e = read_numbers(r, at, 1, &v);
        if (e)
            return e;
        if (!(v >= 0 && v <= UINT32_MAX && v == floor(v)))
            return err_fail(ERR_FORMAT, "%s: line %d: %g where a whole number belongs", r->what,
                            r->number, v);
        out[i] = (uint32_t)v;
    }
    return OK;
}

static err_t read_text_camera(const struct line_reader *r, struct colmap_cameras *out)
{
    const char *at = r->line;
    struct colmap_camera head = {0};
    err_t e = read_whole(r, &at, 1, &head.id);
    if (e)
        return e;
    char name[32] = "";
    size_t n = strcspn(at, " \t\r");
    memcpy(name, at, n < sizeof name ? n : sizeof name - 1);
    at += n;
    uint32_t size[2];
    e = find_model(r->what, -1, name, &head.model);
    if (!e)
        e = read_whole(r, &at, 2, size);
    if (!e)
        e = set_size(r->what, size[0], size[1], &head);
    if (!e)
        e = read_numbers(r, &at, n_params(head.model), head.params);
    if (!e && *at)
        e = err_fail(ERR_FORMAT, "%s: line %d: more parameters than %s has", r->what, r->number,
                     name);
    return e ? e : add_camera(out, &head);
}

static err_t read_text_cameras(const struct colmap_text *t, struct colmap_cameras *out)
{
    struct line_reader r = lines_of(t);
    while (next_record(&r)) {
        if (out->n == CAMERAS_MAX)
            return err_fail(ERR_FORMAT, "%s: more than %d cameras", t->what, CAMERAS_MAX);
        err_t e = read_text_camera(&r, out);
        if (e)
            return e;
    }
    return OK;
}

static err_t read_text_image(const struct line_reader *r, const struct colmap_cameras *cameras,
                             struct rig *out)
{
    const char *at = r->line;
    uint32_t image_id, camera_id = 0;
    double pose[7];
    struct rig_view *v = &out->views[out->n];
    err_t e = read_whole(r, &at, 1, &image_id);
    if (!e)
        e = read_numbers(r, &at, 7, pose);
    if (!e)
        e = read_whole(r, &at, 1, &camera_id);
    if (!e)
        e = name_of_path(r->what, at, strlen(at), cameras->folders, v->name);
    if (e)
        return e;
    set_pose(pose, &v->cam);
    out->n++;
    return add_view(r->what, cameras, camera_id, v);
}

static err_t read_text_images(const struct colmap_text *t, const struct colmap_cameras *cameras,
                              struct rig *out)
{
    struct line_reader r = lines_of(t);
    while (next_record(&r)) {
        if (out->n == CAMERAS_MAX)
            return err_fail(ERR_FORMAT, "%s: more than %d images", t->what, CAMERAS_MAX);
        err_t e = read_text_image(&r, cameras, out);
        if (e)
            return e;
        (void)next_line(&r); // the image's points; the last image may lack the line
    }
    return OK;
}

static err_t read_text_points(const struct colmap_text *t, struct colmap_points *out)
{
    struct line_reader r = lines_of(t);
    while (next_record(&r)) {
        const char *at = r.line;
        double v[7]; // id, x, y, z, r, g, b
        err_t e = read_numbers(&r, &at, 7, v);
        if (e)
            return e;
        uint8_t rgb[3];
        for (int k = 0; k < 3; k++) {
            if (!(v[4 + k] >= 0 && v[4 + k] <= 255))
                return err_fail(ERR_FORMAT, "%s: line %d: colour %g, allowed is 0 to 255", t->what,
                                r.number, v[4 + k]);
            rgb[k] = (uint8_t)v[4 + k];
        }
        add_point(v + 1, rgb, out);
    }
    return OK;
}

/* ---- both ---- */

static err_t parse_images(bool binary, const struct colmap_text *images,
                          const struct colmap_cameras *cameras, struct rig *out)
{
    out->n = 0;
    memset(out->views, 0, CAMERAS_MAX * sizeof *out->views);
    err_t e =
        binary ? read_binary_images(images, cameras, out) : read_text_images(images, cameras, out);
    if (!e && out->n == 0)
        e = err_fail(ERR_FORMAT, "%s: no images in it", images->what);
    return e;
}

err_t colmap_parse(bool binary, const struct colmap_text *cameras, const struct colmap_text *images,
                   struct rig *out)
{
    struct colmap_cameras list = {.what = cameras->what};
    *out = (struct rig){.stored = true}; // COLMAP does not look at the orientation in EXIF
    list.v = calloc(CAMERAS_MAX, sizeof *list.v);
    out->views = calloc(CAMERAS_MAX, sizeof *out->views);
    err_t e = OK;
    if (!list.v || !out->views)
        e = err_fail(ERR_NOMEM, "%s: no memory for %d cameras", cameras->what, CAMERAS_MAX);
    if (!e)
        e = binary ? read_binary_cameras(cameras, &list) : read_text_cameras(cameras, &list);
    if (!e)
        e = parse_images(binary, images, &list, out);
    if (!e && cameras_check_names(images->what, out) == ERR_FORMAT) {
        list.folders = true; // a rig: a folder for each camera
        e = parse_images(binary, images, &list, out);
    }
    if (!e)
        e = cameras_check_names(images->what, out);
    free(list.v);
    if (e)
        cameras_free(out);
    return e;
}

err_t colmap_parse_points(bool binary, const struct colmap_text *points, struct colmap_points *out)
{
    *out = (struct colmap_points){0};
    size_t room = points->n / (binary ? POINT_BYTES_BINARY : POINT_BYTES_TEXT) + 1;
    if (room > POINTS_MAX)
        return err_fail(ERR_FORMAT, "%s: room for %zu points, at most %d are read", points->what,
                        room, POINTS_MAX);
    out->p = calloc(room, sizeof *out->p);
    if (!out->p)
        return err_fail(ERR_NOMEM, "%s: no memory for %zu points", points->what, room);
    err_t e = binary ? read_binary_points(points, out) : read_text_points(points, out);
    if (e)
        colmap_free_points(out);
    return e;
}

void colmap_free_points(struct colmap_points *points)
{
    free(points->p);
    *points = (struct colmap_points){0};
}

/* Path of dir/stem.bin or, if that is not there, dir/stem.txt. */
static err_t choose_file(const char *dir, const char *stem, bool *binary, char path[FILE_PATH_CAP])
{
    char name[32];
    snprintf(name, sizeof name, "%s.bin", stem);
    err_t e = file_join(dir, name, path);
    *binary = !e && file_is_regular(path);
    if (e || *binary)
        return e;
    snprintf(name, sizeof name, "%s.txt", stem);
    return file_join(dir, name, path);
}

err_t colmap_read(const char *dir, struct rig *out)
{
    char cameras[FILE_PATH_CAP], images[FILE_PATH_CAP];
    struct file_map c = {0}, i = {0};
    bool binary, images_binary;
    *out = (struct rig){0};
    err_t e = choose_file(dir, "cameras", &binary, cameras);
    if (!e)
        e = choose_file(dir, "images", &images_binary, images);
    if (!e && binary != images_binary)
        e = err_fail(ERR_FORMAT, "%s: cameras and images must both be .bin or both .txt", dir);
    if (!e)
        e = file_map(cameras, FILE_BYTES_MAX, &c);
    if (!e)
        e = file_map(images, FILE_BYTES_MAX, &i);
    if (!e)
        e = colmap_parse(binary, &(struct colmap_text){cameras, c.p, c.n},
                         &(struct colmap_text){images, i.p, i.n}, out);
    file_unmap(&c);
    file_unmap(&i);
    return e;
}

err_t colmap_read_points(const char *dir, struct colmap_points *out)
{
    char path[FILE_PATH_CAP];
    struct file_map m;
    bool binary;
    *out = (struct colmap_points){0};
    err_t e = choose_file(dir, "points3D", &binary, path);
    if (e || !file_is_regular(path))
        return e;
    e = file_map(path, FILE_BYTES_MAX, &m);
    if (e)
        return e;
    e = colmap_parse_points(binary, &(struct colmap_text){path, m.p, m.n}, out);
    file_unmap(&m);
    return e;
}
