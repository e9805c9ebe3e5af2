/* uvc.h - the USB side of a video camera: its descriptors and the requests to its controls (USB
 * Device Class Definition for Video Devices 1.1). No I/O.
 * thread: one. */
#ifndef LINUX_UVC_H
#define LINUX_UVC_H

#include "drivers/device/camera.h"

enum { UVC_ENDPOINT = 1, UVC_HEADER = 12, UVC_PAYLOAD = 16384, UVC_REPLY_MAX = 1024 };

struct uvc_control {
    uint8_t unit, selector, bytes;
    int32_t cur, min, max, step, def;
};

enum { UVC_AUTO, UVC_PRIORITY, UVC_TIME, UVC_BRIGHTNESS, UVC_GAIN, UVC_CONTROLS };

struct uvc {
    struct uvc_control control[UVC_CONTROLS];
    int w, h, n_formats;
    enum camera_format format[2]; // offered
    int chosen;                   // index of the chosen one
    bool streaming, began;        // `began` is for the caller to clear
    uint32_t interval;            // 100 ns
    uint8_t probe[26], error;     // error: of the last request, as the host may ask
    uint8_t conf[512], serial;
    int conf_len;
    /* Somebody sets the exposure: *e becomes what the camera has now. */
    err_t (*set)(void *ctx, struct exposure *e);
    void *ctx;
};

/* The rest of *u, from the camera: .set and .ctx stay. serial tells units apart. */
void uvc_init(struct uvc *u, const struct camera_info *info, int serial);

/* Most bytes of a frame. */
uint32_t uvc_bytes(const struct uvc *u);

/* Answer a control request; n_out bytes came with it. Returns the bytes of `in`, -1 to stall. */
int uvc_request(struct uvc *u, const uint8_t setup[8], const uint8_t *out, int n_out,
                uint8_t in[UVC_REPLY_MAX]);

void uvc_put32(uint8_t *p, uint32_t v);

#endif
