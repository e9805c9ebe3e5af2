/* A USB video camera that is a program: usbcam [-p PORT] SIM_URI
 *
 * It hands one end of a socket pair to vhci_hcd, the kernel's host side of USB/IP, and is the
 * device at the other end; uvcvideo binds to it and makes /dev/videoN. Frames, control timing and
 * misfortunes are those of the simulated camera (sim/device/camera_sim.h), which should have
 * length=limit,quantum=100 like real ones. Of its faults, those of the driver's queue (eio, index)
 * are lost frames here, a gap of the sequence is a broken frame, which uvcvideo drops, and unplug
 * is followed by plugging in again after 0.7 s, which SIGUSR1 does too. While exposure is automatic
 * it wanders. SIGTERM ends.
 * USB/IP: Documentation/usb/usbip_protocol.rst of the kernel; all numbers are big-endian. */
#include "tests/linux/truth.h"
#include "tests/linux/uvc.h"

#include "sim/device/camera_sim.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <time.h>
#include <turbojpeg.h>
#include <unistd.h>

enum { URBS_MAX = 64, OUT_MAX = 4096, SUBMIT = 1, UNLINK, RET_SUBMIT, RET_UNLINK };

struct header { // a header of USB/IP
    uint32_t command, seqnum, device, to_host, endpoint, word[5];
    uint8_t setup[8];
};

struct usbcam {
    struct uvc uvc;
    struct feed *camera; // state of camera_sim
    tjhandle jpeg;
    int sk, port;
    uint8_t *data; // the frame that is sent, NULL: none
    uint8_t *room;
    size_t n, at;
    int broken; // frames to be sent before it
    bool bad;
    uint8_t fid; // toggles with every frame
    uint32_t last_sequence;
    uint32_t urb[URBS_MAX]; // that wait for data
    int urb_bytes[URBS_MAX], n_urbs;
};

static volatile sig_atomic_t ended, replug;

static void on_signal(int s)
{
    if (s == SIGUSR1)
        replug = 1;
    else
        ended = 1;
}

/* ---- the socket; false: unplugged ---- */

static bool receive(struct usbcam *u, void *p, size_t n)
{
    uint8_t *c = p;
    while (n > 0) {
        ssize_t k = read(u->sk, c, n);
        if (k < 0 && errno == EINTR && !ended)
            continue;
        if (k <= 0)
            return false;
        c += k;
        n -= (size_t)k;
    }
    return true;
}

static bool transmit(struct usbcam *u, const void *p, size_t n)
{
    const uint8_t *c = p;
    while (n > 0) {
        ssize_t k = send(u->sk, c, n, MSG_NOSIGNAL);
        if (k < 0 && errno == EINTR)
            continue;
        if (k <= 0)
            return false;
        c += k;
        n -= (size_t)k;
    }
    return true;
}

static bool reply(struct usbcam *u, uint32_t seqnum, int status, const void *data, int n)
{
    struct header h = {.command = htonl(RET_SUBMIT),
                       .seqnum = htonl(seqnum),
                       .word = {htonl((uint32_t)status), htonl((uint32_t)n)}};
    return transmit(u, &h, sizeof h) && (!data || transmit(u, data, (size_t)n));
}

/* ---- frames ---- */

static uint8_t clip8(double v)
{
    return (uint8_t)(v + 0.5);
}

/* BT.601, limited range. */
static void to_yuyv(const struct frame *f, uint8_t *out)
{
    for (int i = 0; i < f->w * f->h; i += 2) {
        const uint8_t *p = f->data + 3 * i;
        double r = 0.5 * (p[0] + p[3]), g = 0.5 * (p[1] + p[4]), b = 0.5 * (p[2] + p[5]);
        for (int k = 0; k < 2; k++, p += 3)
            out[2 * i + 2 * k] = clip8(16 + 0.25679 * p[0] + 0.50413 * p[1] + 0.09791 * p[2]);
        out[2 * i + 1] = clip8(128 - 0.14822 * r - 0.29099 * g + 0.43922 * b);
        out[2 * i + 3] = clip8(128 + 0.43922 * r - 0.36779 * g - 0.07143 * b);
    }
}

/* The mosaic without black level, spread to 16 bits. */
static void to_rg16(const struct usbcam *u, const struct frame *f, uint8_t *out)
{
    struct camera_info info;
    feed_info(u->camera, &info);
    int most = (1 << info.bits) - 1 - info.black;
    for (int i = 0; i < f->w * f->h; i++) {
        int v = (f->data[2 * i] | f->data[2 * i + 1] << 8) - info.black;
        v = v < 0 ? 0 : v * 65535 / most;
        out[2 * i] = (uint8_t)v;
        out[2 * i + 1] = (uint8_t)(v >> 8);
    }
}

/* Room for the comment is left behind the first two bytes. */
static size_t to_jpeg(struct usbcam *u, const struct frame *f, uint8_t *out)
{
    unsigned char *p = out + TRUTH_COMMENT;
    unsigned long n = uvc_bytes(&u->uvc) - TRUTH_COMMENT;
    if (tjCompress2(u->jpeg, f->data, f->w, 0, f->h, TJPF_RGB, &p, &n, TJSAMP_422, 90,
                    TJFLAG_NOREALLOC)) {
        fprintf(stderr, "usbcam: %s\n", tjGetErrorStr2(u->jpeg));
        exit(2);
    }
    memcpy(out, "\xff\xd8\xff\xfe\0", 5);
    out[5] = TRUTH_COMMENT - 2;
    return n + TRUTH_COMMENT;
}

/* Begin to send a frame of the camera. */
static void begin(struct usbcam *u, const struct frame *f)
{
    struct feed_truth is = feed_truth(u->camera, f);
    struct truth t = {.magic = "HDRT",
                      .number = (uint32_t)is.number,
                      .exposure = is.exposure.time_s * is.exposure.gain};
    enum camera_format format = u->uvc.format[u->uvc.chosen];
    u->data = u->room;
    u->n = uvc_bytes(&u->uvc);
    if (format == CAMERA_MJPG)
        u->n = to_jpeg(u, f, u->data);
    else if (format == CAMERA_YUYV)
        to_yuyv(f, u->data);
    else
        to_rg16(u, f, u->data);
    memcpy(u->data + (format == CAMERA_MJPG ? 6 : 0), &t, sizeof t);
    if (f->flags & FRAME_SHORT)
        u->n = u->n * f->bytes / ((size_t)f->stride * (size_t)f->h);
    u->bad = f->flags & FRAME_ERROR;
    u->at = 0;
    u->fid ^= (u->broken + 1) & 1;
}

static void wander(struct usbcam *u, uint32_t number)
{
    struct exposure e = {number % 2 ? 0.005 : 0.02, 1.0};
    if (u->uvc.control[UVC_AUTO].cur != 1 && feed_request(u->camera, &e, &e))
        fprintf(stderr, "usbcam: %s\n", err_text());
}

/* Take the frame that waits; false: the camera is gone. */
static bool take(struct usbcam *u)
{
    struct frame f;
    err_t e = feed_next(u->camera, &f);
    if (e)
        return e != ERR_LOST;
    u->broken = u->uvc.began ? 0 : (int)(f.sequence - u->last_sequence - 1);
    if (u->broken < 0 || u->broken > 100)
        u->broken = 0;
    u->last_sequence = f.sequence;
    wander(u, f.sequence);
    if (u->uvc.streaming) {
        u->uvc.began = false;
        begin(u, &f);
    }
    feed_release(u->camera, &f);
    return true;
}

static bool send_part(struct usbcam *u)
{
    static uint8_t p[UVC_PAYLOAD];
    struct timespec now;
    size_t room = (size_t)u->urb_bytes[0] < sizeof p ? (size_t)u->urb_bytes[0] : sizeof p;
    size_t n = u->broken > 0 ? 1 : room - UVC_HEADER;
    if (n > u->n - u->at)
        n = u->n - u->at;
    bool last = u->broken > 0 || u->at + n == u->n, bad = u->broken > 0 || (last && u->bad);
    clock_gettime(CLOCK_MONOTONIC, &now);
    uint32_t ticks = (uint32_t)(now.tv_sec * 48000000 + now.tv_nsec * 6 / 125);
    p[0] = UVC_HEADER;
    p[1] = (uint8_t)(0x8c | (u->fid ^ (u->broken & 1)) | (last ? 2 : 0) | (bad ? 0x40 : 0));
    uvc_put32(p + 2, ticks);
    uvc_put32(p + 6, ticks);
    p[10] = p[11] = 0;
    memcpy(p + UVC_HEADER, u->data + u->at, n);
    if (u->broken > 0)
        u->broken--;
    else
        u->at += n;
    if (u->at == u->n)
        u->data = NULL;
    uint32_t seqnum = u->urb[0];
    u->n_urbs--;
    memmove(u->urb, u->urb + 1, (size_t)u->n_urbs * sizeof u->urb[0]);
    memmove(u->urb_bytes, u->urb_bytes + 1, (size_t)u->n_urbs * sizeof u->urb_bytes[0]);
    return reply(u, seqnum, 0, p, (int)n + UVC_HEADER);
}

/* ---- requests of the host ---- */

static bool submitted(struct usbcam *u, const struct header *h)
{
    static uint8_t out[OUT_MAX], in[UVC_REPLY_MAX];
    int n = (int)ntohl(h->word[1]), most = h->setup[6] | h->setup[7] << 8;
    bool to_host = ntohl(h->to_host) != 0;
    uint32_t seqnum = ntohl(h->seqnum);
    if (ntohl(h->endpoint) != 0) {
        if (u->n_urbs == URBS_MAX)
            return false;
        u->urb[u->n_urbs] = seqnum;
        u->urb_bytes[u->n_urbs++] = n;
        return true;
    }
    if (!to_host && (n < 0 || n > OUT_MAX || !receive(u, out, (size_t)n)))
        return false;
    int k = uvc_request(&u->uvc, h->setup, out, to_host ? 0 : n, in);
    if (u->uvc.began || !u->uvc.streaming)
        u->data = NULL; // what was being sent is of the last stream
    if (k < 0)
        return reply(u, seqnum, -EPIPE, NULL, 0);
    return to_host ? reply(u, seqnum, 0, in, k < most ? k : most) : reply(u, seqnum, 0, NULL, n);
}

static bool unlinked(struct usbcam *u, const struct header *h)
{
    struct header answer = {.command = htonl(RET_UNLINK), .seqnum = h->seqnum};
    for (int i = 0; i < u->n_urbs; i++) {
        if (u->urb[i] != ntohl(h->word[0]))
            continue;
        u->n_urbs--;
        memmove(u->urb + i, u->urb + i + 1, (size_t)(u->n_urbs - i) * sizeof u->urb[0]);
        memmove(u->urb_bytes + i, u->urb_bytes + i + 1,
                (size_t)(u->n_urbs - i) * sizeof u->urb_bytes[0]);
        answer.word[0] = htonl((uint32_t)-ECONNRESET);
        break;
    }
    return transmit(u, &answer, sizeof answer);
}

static bool serve_request(struct usbcam *u)
{
    struct header h;
    if (!receive(u, &h, sizeof h))
        return false;
    switch (ntohl(h.command)) {
    case SUBMIT:
        return submitted(u, &h);
    case UNLINK:
        return unlinked(u, &h);
    default:
        return false;
    }
}

static void serve(struct usbcam *u)
{
    struct pollfd p[2] = {{.fd = u->sk, .events = POLLIN}, {.fd = feed_fd(u->camera)}};
    while (!ended && !replug) {
        while (u->data && u->n_urbs > 0)
            if (!send_part(u))
                return;
        p[1].events = u->data ? 0 : POLLIN; // the camera keeps frames meanwhile, or loses them
        if (poll(p, 2, -1) < 0)
            continue;
        if (p[0].revents && !serve_request(u))
            return;
        if (p[1].revents && !take(u))
            return;
    }
}

/* ---- the plug ---- */

static void plug(struct usbcam *u)
{
    int s[2], bytes = 4 << 20, file = open("/sys/devices/platform/vhci_hcd.0/attach", O_WRONLY);
    char text[64];
    if (file < 0 || socketpair(AF_UNIX, SOCK_STREAM, 0, s)) {
        perror("usbcam: vhci_hcd");
        exit(2);
    }
    setsockopt(s[0], SOL_SOCKET, SO_SNDBUF, &bytes, sizeof bytes);
    int n = snprintf(text, sizeof text, "%d %d %d 3", u->port, s[1], 0x10002 + u->port);
    if (write(file, text, (size_t)n) != n) {
        perror("usbcam: attach");
        exit(2);
    }
    close(file);
    close(s[1]);
    u->sk = s[0];
}

static void session(struct usbcam *u, const char *uri)
{
    struct camera_cfg cfg = {.uri = uri};
    struct camera_info info;
    if (camera_sim.open(u->camera, &cfg)) {
        fprintf(stderr, "usbcam: %s\n", err_text());
        exit(2);
    }
    camera_sim.info(u->camera, &info);
    uvc_init(&u->uvc, &info, u->port);
    u->room = malloc(uvc_bytes(&u->uvc));
    if (!u->room)
        exit(2);
    u->data = NULL;
    u->n_urbs = 0;
    plug(u);
    serve(u);
    close(u->sk);
    camera_sim.close(u->camera);
    free(u->room);
}

static err_t set_exposure(void *ctx, struct exposure *e)
{
    struct exposure requested = *e;
    return feed_request(ctx, &requested, e);
}

int main(int argc, char **argv)
{
    struct usbcam u = {.jpeg = tjInitCompress()};
    struct sigaction sa = {.sa_handler = on_signal};
    for (int c; (c = getopt(argc, argv, "p:")) != -1;) {
        if (c != 'p')
            return 2;
        u.port = atoi(optarg);
    }
    if (optind + 1 != argc)
        return 2;
    u.camera = malloc(camera_sim.state_bytes);
    if (!u.camera || !u.jpeg)
        return 2;
    u.uvc.set = set_exposure;
    u.uvc.ctx = u.camera;
    sigaction(SIGTERM, &sa, NULL);
    sigaction(SIGUSR1, &sa, NULL);
    while (!ended) {
        session(&u, argv[optind]);
        replug = 0;
        if (!ended)
            usleep(700000);
    }
    tjDestroy(u.jpeg);
    free(u.camera);
    return 0;
}
