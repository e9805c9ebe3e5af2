/* libcamera_shim.h - interface of the module hdrig-libcamera.so. libcamera is C++ and its library
 * changes its name with every release, so the program loads it through this table when a camera
 * needs it, and runs without it otherwise.
 * thread: one per camera; cameras of several threads do not disturb each other. */
#ifndef DEVICE_LIBCAMERA_SHIM_H
#define DEVICE_LIBCAMERA_SHIM_H

#include "drivers/device/camera.h"
#include "drivers/device/focus.h"

/* Program and module were built from the same structs; count up when the meaning changes. */
#define LIBCAMERA_SHIM_STAMP                                                                       \
    (4u << 24 | (unsigned)sizeof(struct camera_info) << 12 | (unsigned)sizeof(struct frame))

#define LIBCAMERA_SHIM_TABLE "libcamera_shim_table" // symbol of the module

/* How frames of several cameras begin together; the first three are values of SyncMode. WIRED: by a
 * line between sensors, which their drivers know of. */
enum libcamera_sync {
    LIBCAMERA_SYNC_OFF,
    LIBCAMERA_SYNC_SERVER,
    LIBCAMERA_SYNC_CLIENT,
    LIBCAMERA_SYNC_WIRED
};

struct libcamera_shim_cfg {
    const char *camera;       // id, or a part of one camera's id or model; "" if there is only one
    struct camera_cfg wanted; // without uri
    enum camera_stamp stamp;
    struct focus focus; // position: LensPosition, 1/m, 0: far away
    enum libcamera_sync sync;
};

struct libcamera_shim_camera;

/* As camera_ops; sentences of errors are in text(). */
struct libcamera_shim {
    unsigned stamp;
    const char *(*text)(void); // sentence of the last error of this thread
    err_t (*open)(const struct libcamera_shim_cfg *cfg, struct libcamera_shim_camera **out);
    void (*close)(struct libcamera_shim_camera *c);
    void (*info)(const struct libcamera_shim_camera *c, struct camera_info *out);
    int (*fd)(const struct libcamera_shim_camera *c);
    err_t (*request)(struct libcamera_shim_camera *c, const struct exposure *requested,
                     struct exposure *set);
    err_t (*next)(struct libcamera_shim_camera *c, struct frame *out);
    void (*release)(struct libcamera_shim_camera *c, struct frame *f);
    err_t (*focus)(struct libcamera_shim_camera *c, bool again);
};

#endif
