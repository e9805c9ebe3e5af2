/* One configuration: interface 0 with a camera terminal and a processing unit, interface 1 with
 * one bulk endpoint for the frames; its formats are YUYV and motion JPEG, or a 16-bit mosaic.
 * Refused settings stall, and the host is told why when it asks for the error code, which
 * uvcvideo turns into EBUSY, EACCES or ERANGE. */
#include "tests/linux/uvc.h"

#include <math.h>
#include <string.h>

enum { CONTROL_IF = 0, STREAM_IF = 1, TERMINAL = 1, PROCESSING = 2, OUTPUT = 3 };
enum { SET_CUR = 0x01, GET_CUR = 0x81, GET_MIN, GET_MAX, GET_RES, GET_LEN, GET_INFO, GET_DEF };
enum { NOT_READY = 1, WRONG_STATE = 2, OUT_OF_RANGE = 4, INVALID_REQUEST = 7 };
enum { CLOCK_HZ = 48000000, MANUAL = 1, APERTURE_PRIORITY = 8 };

#define STEP_S 1e-4    // step of exposure times
#define GAIN_STEP 64.0 // per factor of 1

/* ---- descriptors ---- */

static void put8(struct uvc *u, int v)
{
    u->conf[u->conf_len++] = (uint8_t)v;
}

static void put(struct uvc *u, int n, const uint8_t *bytes)
{
    memcpy(u->conf + u->conf_len, bytes, (size_t)n);
    u->conf_len += n;
}

#define PUT(u, ...) put(u, (int)sizeof((uint8_t[]){__VA_ARGS__}), (const uint8_t[]){__VA_ARGS__})

static void put16(struct uvc *u, int v)
{
    PUT(u, (uint8_t)v, (uint8_t)(v >> 8));
}

void uvc_put32(uint8_t *p, uint32_t v)
{
    for (int i = 0; i < 4; i++)
        p[i] = (uint8_t)(v >> 8 * i);
}

static void put32(struct uvc *u, uint32_t v)
{
    uvc_put32(u->conf + u->conf_len, v);
    u->conf_len += 4;
}

static uint32_t get32(const uint8_t *p)
{
    return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static void set16(struct uvc *u, int at, int v)
{
    u->conf[at] = (uint8_t)v;
    u->conf[at + 1] = (uint8_t)(v >> 8);
}

uint32_t uvc_bytes(const struct uvc *u)
{
    return (uint32_t)u->w * (uint32_t)u->h * 2;
}

static void put_format(struct uvc *u, int i)
{
    static const uint8_t tail[] = {0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71};
    enum camera_format f = u->format[i];
    bool jpeg = f == CAMERA_MJPG;
    if (jpeg) {
        PUT(u, 11, 0x24, 6, (uint8_t)(i + 1), 1, 0, 1, 0, 0, 0, 0);
    } else {
        PUT(u, 27, 0x24, 4, (uint8_t)(i + 1), 1);
        put(u, 4, (const uint8_t *)(f == CAMERA_YUYV ? "YUY2" : "RG16"));
        put(u, sizeof tail, tail);
        PUT(u, 16, 1, 0, 0, 0, 0);
    }
    PUT(u, 30, 0x24, jpeg ? 7 : 5, 1, 0);
    put16(u, u->w);
    put16(u, u->h);
    put32(u, uvc_bytes(u) * 8);
    put32(u, uvc_bytes(u) * 8 * 60);
    put32(u, uvc_bytes(u));
    put32(u, u->interval);
    put8(u, 1);
    put32(u, u->interval);
    PUT(u, 6, 0x24, 0x0d, 1, 1, 4); // BT.709 primaries, sRGB-like transfer, BT.601 matrix
}

static void build(struct uvc *u)
{
    int control, stream;
    u->conf_len = 0;
    PUT(u, 9, 2, 0, 0, 2, 1, 0, 0x80, 250);
    PUT(u, 8, 11, 0, 2, 14, 3, 0, 0); // both interfaces are one function
    PUT(u, 9, 4, CONTROL_IF, 0, 0, 14, 1, 0, 0);
    control = u->conf_len;
    PUT(u, 13, 0x24, 1, 0x00, 0x01, 0, 0);
    put32(u, CLOCK_HZ);
    PUT(u, 1, STREAM_IF);
    PUT(u, 18, 0x24, 2, TERMINAL, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0x0e, 0, 0);
    PUT(u, 11, 0x24, 5, PROCESSING, TERMINAL, 0, 0, 2, 0x01, 0x02, 0);
    PUT(u, 9, 0x24, 3, OUTPUT, 0x01, 0x01, 0, PROCESSING, 0);
    set16(u, control + 5, u->conf_len - control);
    PUT(u, 9, 4, STREAM_IF, 0, 1, 14, 2, 0, 0);
    stream = u->conf_len;
    PUT(u, (uint8_t)(13 + u->n_formats), 0x24, 1, (uint8_t)u->n_formats, 0, 0, 0x80 | UVC_ENDPOINT,
        0, OUTPUT, 0, 0, 0, 1);
    for (int i = 0; i < u->n_formats; i++)
        put8(u, 0);
    for (int i = 0; i < u->n_formats; i++)
        put_format(u, i);
    set16(u, stream + 4, u->conf_len - stream);
    PUT(u, 7, 5, 0x80 | UVC_ENDPOINT, 2, 0x00, 0x02, 0);
    set16(u, 2, u->conf_len);
}

static int device_descriptor(uint8_t *in)
{
    static const uint8_t d[18] = {18,   1,    0,    2, 0xef, 2, 1, 64, 9,
                                  0x12, 0xda, 0xca, 0, 1,    1, 2, 3,  1};
    memcpy(in, d, sizeof d);
    return sizeof d;
}

static int string_descriptor(const struct uvc *u, int i, uint8_t *in)
{
    static const char *const text[] = {"", "hdrig", "Software HDR camera", "SIM000"};
    int n = 0;
    if (i == 0) {
        memcpy(in, "\x04\x03\x09\x04", 4); // English
        return 4;
    }
    if (i > 3)
        return -1;
    for (const char *c = text[i]; *c; c++, n++) {
        in[2 + 2 * n] = (uint8_t)*c;
        in[3 + 2 * n] = 0;
    }
    if (i == 3) {
        in[2 + 2 * n] = (uint8_t)('0' + u->serial);
        in[3 + 2 * n++] = 0;
    }
    in[0] = (uint8_t)(2 + 2 * n);
    in[1] = 3;
    return in[0];
}

/* ---- what is streamed ---- */

static void set_probe(struct uvc *u, int format)
{
    memset(u->probe, 0, sizeof u->probe);
    u->probe[0] = 1; // the interval is fixed
    u->probe[2] = (uint8_t)(format + 1);
    u->probe[3] = 1;
    uvc_put32(u->probe + 4, u->interval);
    uvc_put32(u->probe + 18, uvc_bytes(u));
    uvc_put32(u->probe + 22, UVC_PAYLOAD);
}

void uvc_init(struct uvc *u, const struct camera_info *info, int serial)
{
    int longest = (int)floor(info->time_max_s / STEP_S + 0.5);
    int gain = (int)(info->gain_max * GAIN_STEP);
    u->control[UVC_AUTO] = (struct uvc_control){
        TERMINAL, 0x02, 1, APERTURE_PRIORITY, 1, APERTURE_PRIORITY, 9, APERTURE_PRIORITY};
    u->control[UVC_PRIORITY] = (struct uvc_control){TERMINAL, 0x03, 1, 0, 0, 1, 1, 0};
    u->control[UVC_TIME] = (struct uvc_control){TERMINAL, 0x04, 4, 100, 1, longest, 1, 100};
    u->control[UVC_BRIGHTNESS] = (struct uvc_control){PROCESSING, 0x02, 2, 0, -64, 64, 1, 0};
    u->control[UVC_GAIN] = (struct uvc_control){PROCESSING, 0x04, 2, 64, 64, gain, 1, 64};
    u->w = info->w;
    u->h = info->h;
    u->interval = (uint32_t)floor(info->period_s * 1e7 + 0.5);
    u->n_formats = info->format == CAMERA_RGB8 ? 2 : 1;
    u->format[0] = info->format == CAMERA_RGB8 ? CAMERA_YUYV : CAMERA_RGGB16;
    u->format[1] = CAMERA_MJPG;
    u->streaming = u->began = false;
    u->error = 0;
    u->serial = (uint8_t)serial;
    set_probe(u, 0);
    build(u);
}

static int stream_request(struct uvc *u, int request, int selector, const uint8_t *out, int n_out,
                          uint8_t *in)
{
    switch (request) {
    case SET_CUR:
        if (n_out < 3)
            return -1;
        set_probe(u, out[2] >= 1 && out[2] <= u->n_formats ? out[2] - 1 : 0);
        if (selector == 2) { // commit
            u->chosen = u->probe[2] - 1;
            u->streaming = u->began = true;
        }
        return 0;
    case GET_LEN:
        in[0] = sizeof u->probe;
        in[1] = 0;
        return 2;
    case GET_INFO:
        in[0] = 3;
        return 1;
    default:
        memcpy(in, u->probe, sizeof u->probe);
        return sizeof u->probe;
    }
}

/* ---- controls ---- */

static int refuse(struct uvc *u, int why)
{
    u->error = (uint8_t)why;
    return -1;
}

static int set_control(struct uvc *u, struct uvc_control *c, int32_t v)
{
    int32_t before = c->cur;
    struct exposure e;
    err_t err;
    if (v < c->min || v > c->max)
        return refuse(u, OUT_OF_RANGE);
    if (c == &u->control[UVC_TIME] && u->control[UVC_AUTO].cur != MANUAL)
        return refuse(u, WRONG_STATE);
    c->cur = v;
    if (c == &u->control[UVC_PRIORITY] || c == &u->control[UVC_BRIGHTNESS])
        return 0;
    e = (struct exposure){u->control[UVC_TIME].cur * STEP_S, u->control[UVC_GAIN].cur / GAIN_STEP};
    err = u->set(u->ctx, &e);
    if (err) {
        c->cur = before;
        return refuse(u, err == ERR_BUSY          ? NOT_READY
                         : err == ERR_UNSUPPORTED ? WRONG_STATE
                                                  : OUT_OF_RANGE);
    }
    u->control[UVC_TIME].cur = (int32_t)floor(e.time_s / STEP_S + 0.5);
    u->control[UVC_GAIN].cur = (int32_t)floor(e.gain * GAIN_STEP + 0.5);
    return 0;
}

static struct uvc_control *find(struct uvc *u, int unit, int selector)
{
    for (int i = 0; i < UVC_CONTROLS; i++)
        if (u->control[i].unit == unit && u->control[i].selector == selector)
            return &u->control[i];
    return NULL;
}

static int get_control(const struct uvc_control *c, int request, uint8_t *in)
{
    const int32_t value[] = {c->cur, c->min, c->max, c->step};
    int32_t v = c->def;
    if (request == GET_LEN || request == GET_INFO) {
        in[0] = request == GET_LEN ? c->bytes : 3;
        in[1] = 0;
        return request == GET_LEN ? 2 : 1;
    }
    if (request >= GET_CUR && request <= GET_RES)
        v = value[request - GET_CUR];
    for (int i = 0; i < c->bytes; i++)
        in[i] = (uint8_t)((uint32_t)v >> 8 * i);
    return c->bytes;
}

static int control_request(struct uvc *u, const uint8_t s[8], const uint8_t *out, int n_out,
                           uint8_t *in)
{
    struct uvc_control *c = find(u, s[5], s[3]);
    uint8_t word[4] = {0};
    if (s[5] == 0 && s[3] == 2) { // the error code
        in[0] = u->error;
        return 1;
    }
    if (!c || (s[1] == SET_CUR && n_out < c->bytes))
        return refuse(u, INVALID_REQUEST);
    u->error = 0;
    if (s[1] != SET_CUR)
        return get_control(c, s[1], in);
    memcpy(word, out, c->bytes);
    return set_control(u, c, c->bytes == 2 ? (int16_t)get32(word) : (int32_t)get32(word));
}

/* ---- any request ---- */

static int standard_request(struct uvc *u, const uint8_t s[8], uint8_t *in)
{
    enum { TO_HOST = 0x80, GET_STATUS = 0, CLEAR_FEATURE = 1, DESCRIPTOR = 6, GET_INTERFACE = 10 };
    if (s[0] & TO_HOST && s[1] == DESCRIPTOR) {
        if (s[3] == 1)
            return device_descriptor(in);
        if (s[3] == 2)
            memcpy(in, u->conf, (size_t)u->conf_len);
        return s[3] == 2 ? u->conf_len : s[3] == 3 ? string_descriptor(u, s[2], in) : -1;
    }
    if (s[0] & TO_HOST) {
        in[0] = in[1] = 0;
        return s[1] == GET_STATUS ? 2 : s[1] == GET_INTERFACE ? 1 : -1;
    }
    if (s[0] == 2 && s[1] == CLEAR_FEATURE) // halt of the endpoint: uvcvideo stops streaming
        u->streaming = false;
    return 0;
}

int uvc_request(struct uvc *u, const uint8_t setup[8], const uint8_t *out, int n_out,
                uint8_t in[UVC_REPLY_MAX])
{
    if ((setup[0] & 0x60) == 0)
        return standard_request(u, setup, in);
    if (setup[4] == STREAM_IF)
        return setup[3] == 1 || setup[3] == 2
                   ? stream_request(u, setup[1], setup[3], out, n_out, in)
                   : -1;
    return control_request(u, setup, out, n_out, in);
}
