/* video.h - a film from pictures, by ffmpeg as a child process: raw pictures go through a pipe,
 * MP4 comes out, 4:2:0 in Rec. 709. H.264, which phones and browsers play, where that ffmpeg can;
 * else another format that it has. It gets its name when it is complete (partial.h).
 * SIGPIPE must be ignored. Waiting ends early when engine_cancel is set.
 * thread: any. */
#ifndef RESULT_VIDEO_H
#define RESULT_VIDEO_H

#include "drivers/format/partial.h"

#include "core/base/types.h"

#include <sys/types.h>

enum { VIDEO_FPS_MAX = 240 };

struct video_format {
    const char *codec, *encoder; // common name; name in ffmpeg
    const char *option, *value;  // sets its quality
};

struct video {
    char path[FILE_PATH_CAP];
    struct partial partial;
    const struct video_format *format;
    int w, h;     // px
    int pipe;     // to ffmpeg; 0 if there is none
    int messages; // pipe with the messages of ffmpeg
    pid_t pid;    // 0 when it has ended
};

/* Begin a film of pictures of w x h px.
 * own:  video_close.
 * err:  ERR_UNSUPPORTED (no ffmpeg, or none of the formats), ERR_ARG (path), ERR_IO, ERR_LIMIT (no
 *       space), ERR_NOMEM, ERR_BUSY (partial.h), ERR_CANCELLED. On error *v is zeroed and the file
 *       removed. */
MUST_USE err_t video_open(const char *path, int w, int h, double fps, struct video *v);

/* The next picture, of the size given to video_open.
 * err:  ERR_IO, ERR_LIMIT (no space) with ffmpeg's message, ERR_CANCELLED. */
MUST_USE err_t video_put(struct video *v, const struct image8 *picture);

/* Wait for ffmpeg and show the film.
 * err:  as video_put. */
MUST_USE err_t video_finish(struct video *v);

/* Kill ffmpeg and remove the file unless it was finished. Accepts a zeroed struct. */
void video_close(struct video *v);

#endif
