/* ffmpeg ends with 0 although a disk was full (5.1), so every error message of it counts as a
 * failure. A side of odd length gets its last line twice: 4:2:0 has pairs. */
#include "firmware/result/video.h"

#include "firmware/base/engine.h"

#include "drivers/format/origin.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

static const struct video_format formats[] = {
    {"H.264", "libx264", "-crf", "18"},
    {"H.264", "libopenh264", "-b:v", "8M"},
    {"MPEG-4 part 2, which browsers do not play", "mpeg4", "-q:v", "3"},
};

enum {
    FORMATS = sizeof formats / sizeof formats[0],
    TEXT_CAP = 65536,
    LINE_CAP = 200,
    WAIT_MS = 20
};

/* ---- the child ---- */

/* in, out, messages: file descriptors, -1 for /dev/null. It has its own process group, so
 * that Ctrl-C reaches only this process, which then ends it. */
static err_t spawn_encoder(char *const argv[], int in, int out, int messages, pid_t *pid)
{
    posix_spawn_file_actions_t files;
    posix_spawnattr_t attr;
    const int from[3] = {in, out, messages};
    if (posix_spawn_file_actions_init(&files) != 0)
        return err_fail(ERR_NOMEM, "video: no memory");
    if (posix_spawnattr_init(&attr) != 0) {
        posix_spawn_file_actions_destroy(&files);
        return err_fail(ERR_NOMEM, "video: no memory");
    }
    int why = posix_spawnattr_setflags(&attr, POSIX_SPAWN_SETPGROUP);
    for (int k = 0; k < 3 && !why; k++)
        why = from[k] < 0 ? posix_spawn_file_actions_addopen(&files, k, "/dev/null", O_RDWR, 0)
                          : posix_spawn_file_actions_adddup2(&files, from[k], k);
    if (!why)
        why = posix_spawnp(pid, argv[0], &files, &attr, argv, environ);
    posix_spawnattr_destroy(&attr);
    posix_spawn_file_actions_destroy(&files);
    if (!why)
        return OK;
    *pid = 0;
    if (why == ENOENT)
        return err_fail(ERR_UNSUPPORTED,
                        "ffmpeg, which makes videos, is not installed: apt-get install ffmpeg");
    return err_fail(ERR_IO, "ffmpeg: cannot start: %s", strerror(why));
}

static bool is_cancelled(void)
{
    return atomic_load(&engine_cancel);
}

/* Its status; it is killed if the user wants to stop. A signal may come just before any call that
 * would wait for good, so none does. */
static int wait_for(pid_t *pid)
{
    int status = 0;
    for (pid_t ended = 0; ended == 0 || (ended < 0 && errno == EINTR);) {
        if (is_cancelled())
            kill(*pid, SIGKILL);
        ended = waitpid(*pid, &status, WNOHANG);
        if (ended == 0)
            poll(NULL, 0, WAIT_MS);
    }
    *pid = 0;
    return status;
}

/* False if ffmpeg takes no more, or the user wants to stop. */
static bool send_bytes(int pipe, const uint8_t *p, size_t n)
{
    struct pollfd room = {.fd = pipe, .events = POLLOUT};
    while (n > 0 && !is_cancelled()) {
        ssize_t put = write(pipe, p, n);
        if (put > 0) {
            p += put;
            n -= (size_t)put;
        } else if (put < 0 && errno == EAGAIN) {
            poll(&room, 1, WAIT_MS);
        } else if (put == 0 || errno != EINTR) {
            break;
        }
    }
    return n == 0;
}

/* Read the text that the child wrote to a memory file. */
static void read_text(int fd, size_t cap, char *text)
{
    ssize_t n = pread(fd, text, cap - 1, 0);
    text[n > 0 ? n : 0] = 0;
}

/* err:  ERR_IO or ERR_LIMIT with the first thing that ffmpeg said, if it said any or failed. */
static err_t explain_exit(const char *what, int messages, int status)
{
    char line[LINE_CAP];
    read_text(messages, sizeof line, line);
    line[strcspn(line, "\n")] = 0;
    if (is_cancelled())
        return ERR_CANCELLED;
    if (status == 0 && !*line)
        return OK;
    bool full = strstr(line, strerror(ENOSPC)) || strstr(line, strerror(EFBIG));
    err_t e = full ? ERR_LIMIT : ERR_IO;
    if (*line)
        return err_fail(e, "%s: ffmpeg: %s", what, line);
    if (WIFSIGNALED(status))
        return err_fail(e, "%s: ffmpeg was ended by signal %d", what, WTERMSIG(status));
    return err_fail(e, "%s: ffmpeg ended with exit code %d", what, WEXITSTATUS(status));
}

/* ---- formats ---- */

/* The first of the formats in a list like " V....D libx264    libx264 H.264 / AVC ...". */
static const struct video_format *choose_format(const char *list)
{
    for (int i = 0; i < FORMATS; i++) {
        char word[32];
        snprintf(word, sizeof word, " %s ", formats[i].encoder);
        if (strstr(list, word))
            return &formats[i];
    }
    return NULL;
}

static err_t find_format(struct video *v)
{
    char *argv[] = {"ffmpeg", "-hide_banner", "-loglevel", "error", "-encoders", NULL};
    char *text = malloc(TEXT_CAP);
    int list = memfd_create("encoders", MFD_CLOEXEC);
    err_t e = text && list >= 0 ? OK : err_fail(ERR_NOMEM, "video: no memory");
    if (!e)
        e = spawn_encoder(argv, -1, list, v->messages, &v->pid);
    if (!e)
        e = explain_exit("its list of encoders", v->messages, wait_for(&v->pid));
    if (!e) {
        read_text(list, TEXT_CAP, text);
        v->format = choose_format(text);
        if (!v->format)
            e = err_fail(ERR_UNSUPPORTED, "this ffmpeg has none of the encoders %s, %s and %s",
                         formats[0].encoder, formats[1].encoder, formats[2].encoder);
    }
    if (list >= 0)
        close(list);
    free(text);
    return e;
}

/* ---- the film ---- */

static err_t start_ffmpeg(struct video *v, double fps)
{
    char size[32], rate[32], file[FILE_PATH_CAP], out[FILE_PATH_CAP + 8];
    int ends[2];
    err_t e = partial_path(&v->partial, v->path, file);
    if (e)
        return e;
    snprintf(size, sizeof size, "%dx%d", v->w + v->w % 2, v->h + v->h % 2);
    snprintf(rate, sizeof rate, "%g", fps);
    snprintf(out, sizeof out, "file:%s", file); // a name with a colon is no address
    char *argv[] = {"ffmpeg", "-hide_banner", "-loglevel", "error", "-xerror", "-y",
                    /* in */
                    "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", rate, "-i", "pipe:0",
                    /* out */
                    "-vf", "scale=out_color_matrix=bt709:out_range=tv", "-pix_fmt", "yuv420p",
                    "-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709",
                    "-c:v", (char *)v->format->encoder, (char *)v->format->option,
                    (char *)v->format->value, "-metadata", "comment=" ORIGIN_COMMENT, "-movflags",
                    "+faststart", "-f", "mp4", out, NULL};
    if (pipe2(ends, O_CLOEXEC) != 0)
        return err_fail(ERR_IO, "video: %s", strerror(errno));
    v->pipe = ends[1];
    e = fcntl(ends[1], F_SETFL, O_NONBLOCK) == 0
            ? spawn_encoder(argv, ends[0], -1, v->messages, &v->pid)
            : err_fail(ERR_IO, "video: %s", strerror(errno));
    close(ends[0]);
    return e;
}

err_t video_open(const char *path, int w, int h, double fps, struct video *v)
{
    memset(v, 0, sizeof *v);
    v->w = w;
    v->h = h;
    int n = snprintf(v->path, sizeof v->path, "%s", path);
    v->messages = memfd_create("messages", MFD_CLOEXEC);
    err_t e = v->messages >= 0 ? OK : err_fail(ERR_NOMEM, "video: no memory");
    if (!e && n >= (int)sizeof v->path)
        e = err_fail(ERR_ARG, "%.64s...: path too long", path);
    if (!e)
        e = find_format(v);
    if (!e && file_is_dir(path))
        e = err_fail(ERR_ARG, "%s: is a folder", path);
    if (!e)
        e = origin_check_place(path);
    if (!e)
        e = partial_open(path, &v->partial);
    if (!e)
        e = start_ffmpeg(v, fps);
    if (e)
        video_close(v);
    return e;
}

/* Why ffmpeg takes no more. */
static err_t fail_lost(struct video *v)
{
    int status = wait_for(&v->pid);
    err_t e = explain_exit(v->path, v->messages, status);
    return e ? e : err_fail(ERR_IO, "%s: ffmpeg ended too early", v->path);
}

err_t video_put(struct video *v, const struct image8 *picture)
{
    size_t row = 3 * (size_t)v->w;
    bool ok = true;
    for (int y = 0; y < v->h + v->h % 2 && ok; y++) {
        const uint8_t *px = picture->px + (size_t)(y < v->h ? y : v->h - 1) * row;
        ok =
            send_bytes(v->pipe, px, row) && (v->w % 2 == 0 || send_bytes(v->pipe, px + row - 3, 3));
    }
    return is_cancelled() ? ERR_CANCELLED : ok ? OK : fail_lost(v);
}

err_t video_finish(struct video *v)
{
    close(v->pipe);
    v->pipe = 0;
    err_t e = explain_exit(v->path, v->messages, wait_for(&v->pid));
    if (!e)
        e = partial_show(&v->partial, v->path);
    if (!e)
        partial_close(&v->partial);
    return e;
}

void video_close(struct video *v)
{
    if (v->pid > 0) {
        kill(v->pid, SIGKILL);
        wait_for(&v->pid);
    }
    if (v->pipe > 0)
        close(v->pipe);
    partial_close(&v->partial);
    if (v->messages > 0)
        close(v->messages);
    memset(v, 0, sizeof *v);
}
