/* ffmpeg is played by shell scripts; the last test takes the real one where it is installed. */
#include "drivers/format/origin.h"
#include "firmware/base/engine.h"
#include "firmware/result/video.h"
#include "tests/unit/tmpdir.h"

#include <dirent.h>
#include <math.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/time.h>
#include <unistd.h>

#include <cmocka.h>

enum { SIDE_MAX = 64 };

static struct video v;
static uint8_t px[3 * SIDE_MAX * SIDE_MAX];

/* What ffmpeg does with its input; $out is the file to write. */
static void play(const char *encoders, const char *body)
{
    char text[1024];
    tmpdir_text("encoders", encoders);
    snprintf(text, sizeof text,
             "#!/bin/sh\ncase \"$*\" in *-encoders*) cat '%s'; exit;; esac\n"
             "for out; do :; done\nout=${out#file:}\n%s\n",
             tmpdir_path("encoders"), body);
    assert_int_equal(chmod(tmpdir_text("ffmpeg", text), 0755), 0);
}

static const char x264[] = " V....D libx264              libx264 H.264 (codec h264)\n"
                           " V....D libx264rgb           libx264 RGB (codec h264)\n"
                           " V.S... mpeg4                MPEG-4 part 2\n";

static int setup(void **state)
{
    char path[256];
    (void)state;
    tmpdir_make();
    tmpdir_mkdir("films");
    snprintf(path, sizeof path, "%s:/usr/bin:/bin", tmpdir_root);
    setenv("PATH", path, 1);
    atomic_store(&engine_cancel, false);
    for (size_t i = 0; i < sizeof px; i++)
        px[i] = (uint8_t)(i * 7 + i / 100);
    return 0;
}

static int teardown(void **state)
{
    (void)state;
    video_close(&v);
    tmpdir_remove();
    setenv("PATH", "/usr/bin:/bin", 1);
    return 0;
}

static int files(void)
{
    DIR *d = opendir(tmpdir_path("films"));
    int n = -2; // . and ..
    while (d && readdir(d))
        n++;
    if (d)
        closedir(d);
    return n;
}

static void assert_says(const char *words)
{
    if (!strstr(err_text(), words))
        fail_msg("\"%s\" does not say \"%s\"", err_text(), words);
}

static err_t film(int w, int h, int frames)
{
    const struct image8 picture = {w, h, 3, px};
    err_t e = video_open(tmpdir_path("films/a.mp4"), w, h, 30, &v);
    for (int i = 0; i < frames && !e; i++)
        e = video_put(&v, &picture);
    if (!e)
        e = video_finish(&v);
    return e;
}

/* ---- what ffmpeg gets ---- */

static void odd_sides_are_made_even(void **state)
{
    (void)state;
    enum { W = 5, H = 3, ROW = 3 * (W + 1) };
    uint8_t got[2 * ROW * (H + 1) + 1];
    play(x264, "cat >\"$out\"");
    assert_int_equal(film(W, H, 2), OK);
    assert_string_equal(v.format->encoder, "libx264");
    assert_int_equal(files(), 1);
    FILE *f = fopen(tmpdir_path("films/a.mp4"), "rb");
    assert_non_null(f);
    assert_int_equal(fread(got, 1, sizeof got, f), 2 * ROW * (H + 1));
    fclose(f);
    for (int i = 0; i < 2 * (H + 1); i++) {
        int y = i % (H + 1) < H ? i % (H + 1) : H - 1;
        assert_memory_equal(got + i * ROW, px + 3 * W * y, 3 * W);
        assert_memory_equal(got + i * ROW + 3 * W, px + 3 * (W * y + W - 1), 3);
    }
}

static void is_told_size_and_rate(void **state)
{
    (void)state;
    play(x264, "cat >/dev/null; echo \"$@\" >\"$out\"");
    assert_int_equal(film(5, 8, 1), OK);
    char text[1024] = "";
    FILE *f = fopen(tmpdir_path("films/a.mp4"), "r");
    assert_non_null(f);
    assert_non_null(fgets(text, sizeof text, f));
    fclose(f);
    assert_non_null(strstr(text, "-s 6x8 "));
    assert_non_null(strstr(text, "-r 30 "));
    assert_non_null(strstr(text, "-c:v libx264 "));
}

static void takes_what_there_is(void **state)
{
    (void)state;
    play(" V....D libopenh264   OpenH264\n V.S... mpeg4    MPEG-4\n", "cat >\"$out\"");
    assert_int_equal(film(2, 2, 1), OK);
    assert_string_equal(v.format->encoder, "libopenh264");
    video_close(&v);
    assert_int_equal(remove(tmpdir_path("films/a.mp4")), 0);
    play(" V....D libx264rgb   RGB\n V.S... mpeg4    MPEG-4\n", "cat >\"$out\"");
    assert_int_equal(film(2, 2, 1), OK);
    assert_string_equal(v.format->encoder, "mpeg4");
    video_close(&v);
    assert_int_equal(remove(tmpdir_path("films/a.mp4")), 0);
    play(" V....D libx264rgb   RGB\n", "cat >\"$out\"");
    assert_int_equal(film(2, 2, 1), ERR_UNSUPPORTED);
    assert_says("libx264");
}

/* ---- what goes wrong ---- */

static void no_ffmpeg(void **state)
{
    (void)state;
    setenv("PATH", tmpdir_root, 1);
    assert_int_equal(film(2, 2, 1), ERR_UNSUPPORTED);
    assert_says("apt-get install ffmpeg");
    assert_int_equal(files(), 0);
}

static void it_fails(err_t code, const char *body, const char *words)
{
    play(x264, body);
    assert_int_equal(film(SIDE_MAX, SIDE_MAX, 40), code); // more than a pipe holds
    assert_says(words);
    video_close(&v);
    assert_int_equal(files(), 0);
}

static void ffmpeg_fails(void **state)
{
    (void)state;
    it_fails(ERR_IO, "head -c 20000 >\"$out\"; exit 3", "a.mp4: ffmpeg ended with exit code 3");
    it_fails(ERR_IO, "head -c 20000 >\"$out\"; kill -9 $$", "ended by signal 9");
    it_fails(ERR_IO, "head -c 20000 >\"$out\"", "ended too early");
    it_fails(ERR_IO, "cat >\"$out\"; echo 'Codec: no' >&2; echo more >&2", "ffmpeg: Codec: no");
    assert_null(strstr(err_text(), "more"));
    it_fails(ERR_LIMIT, "cat >/dev/null; echo 'trailer: No space left on device' >&2", "No space");
    it_fails(ERR_IO, "cat >/dev/null; exit 9", "exit code 9");
    play("", "");
    tmpdir_text("ffmpeg", "#!/bin/sh\necho broken library >&2; exit 127\n");
    assert_int_equal(film(2, 2, 1), ERR_IO);
    assert_says("broken library");
}

static void bad_paths(void **state)
{
    (void)state;
    char path[FILE_PATH_CAP + 8];
    struct video other;
    play(x264, "cat >\"$out\"");
    assert_int_equal(video_open(tmpdir_path("nowhere/a.mp4"), 2, 2, 30, &v), ERR_IO);
    assert_says("nowhere/a.mp4: cannot create: No such file");
    assert_int_equal(video_open(tmpdir_path("films"), 2, 2, 30, &v), ERR_ARG);
    for (size_t n = FILE_PATH_CAP - 6; n < sizeof path; n++) { // where .tmp- still fits, and not
        memset(path, 'a', n);
        path[n] = 0;
        err_t e = video_open(path, 2, 2, 30, &v);
        assert_true(e == ERR_ARG || e == ERR_IO);
    }
    assert_int_equal(video_open(tmpdir_path("films/a.mp4"), 2, 2, 30, &v), OK);
    assert_int_equal(video_open(tmpdir_path("films/a.mp4"), 2, 2, 30, &other), ERR_BUSY);
    assert_int_equal(files(), 1); // that of the first
    assert_int_equal(video_finish(&v), OK);
}

/* A former film stays when the new one fails. */
static void former_film_stays(void **state)
{
    (void)state;
    static const char former[] = "size"
                                 "ftyp" ORIGIN_COMMENT;
    char text[64] = "";
    tmpdir_text("films/a.mp4", former);
    play(x264, "head -c 20000 >\"$out\"; exit 3");
    assert_int_equal(film(SIDE_MAX, SIDE_MAX, 40), ERR_IO);
    video_close(&v);
    FILE *f = fopen(tmpdir_path("films/a.mp4"), "r");
    assert_non_null(f);
    assert_non_null(fgets(text, sizeof text, f));
    fclose(f);
    assert_string_equal(text, former);
    assert_int_equal(files(), 1);
}

/* Somebody else's film is refused before a picture is drawn. */
static void keeps_somebody_elses_film(void **state)
{
    (void)state;
    tmpdir_text("films/a.mp4", "size"
                               "ftyp"
                               "isom, a wedding");
    play(x264, "cat >\"$out\"");
    assert_int_equal(film(2, 2, 0), ERR_ARG);
    assert_says("films/a.mp4: already exists");
    assert_int_equal(files(), 1);
}

static void stop(int number)
{
    (void)number;
    atomic_store(&engine_cancel, true);
}

/* The user stops while ffmpeg takes nothing: at a picture, and at the end. */
static void cancelled(void **state)
{
    (void)state;
    const struct sigaction act = {.sa_handler = stop};
    const struct itimerval soon = {.it_value.tv_usec = 400000};
    sigaction(SIGALRM, &act, NULL);
    for (int frames = 1; frames <= 40; frames += 39) {
        atomic_store(&engine_cancel, false);
        play(x264, "echo $$ >\"$out\"; exec sleep 100");
        setitimer(ITIMER_REAL, &soon, NULL);
        assert_int_equal(film(SIDE_MAX, SIDE_MAX, frames), ERR_CANCELLED);
        pid_t pid = v.pid;
        video_close(&v);
        assert_int_equal(files(), 0);
        assert_true(pid == 0 || kill(pid, 0) != 0);
    }
}

/* The signal came before, and no other will. */
static void cancelled_before(void **state)
{
    (void)state;
    const struct image8 picture = {SIDE_MAX, SIDE_MAX, 3, px};
    play(x264, "exec sleep 100");
    assert_int_equal(video_open(tmpdir_path("films/a.mp4"), SIDE_MAX, SIDE_MAX, 30, &v), OK);
    atomic_store(&engine_cancel, true);
    for (int i = 0; i < 40; i++) // more than a pipe holds
        assert_int_equal(video_put(&v, &picture), ERR_CANCELLED);
    assert_int_equal(video_finish(&v), ERR_CANCELLED);
    video_close(&v);
    assert_int_equal(files(), 0);
    atomic_store(&engine_cancel, false);
    assert_int_equal(video_open(tmpdir_path("films/a.mp4"), SIDE_MAX, SIDE_MAX, 30, &v), OK);
    assert_int_equal(video_put(&v, &picture), OK);
    atomic_store(&engine_cancel, true);
    assert_int_equal(video_finish(&v), ERR_CANCELLED);
}

/* ---- the real one ---- */

/* Four flat colours come back within what 8 bits of Rec. 709 can. */
static void colours_come_back(void **state)
{
    (void)state;
    static const uint8_t colours[4][3] = {{255, 0, 0}, {20, 90, 200}, {255, 255, 255}, {0, 0, 0}};
    enum { SIDE = 32 };
    char command[512];
    setenv("PATH", "/usr/bin:/bin", 1);
    const struct image8 picture = {SIDE, SIDE, 3, px};
    if (system("command -v ffmpeg >/dev/null") != 0)
        skip();
    assert_int_equal(video_open(tmpdir_path("films/a.mp4"), SIDE, SIDE, 25, &v), OK);
    for (int i = 0; i < 4; i++) {
        for (int k = 0; k < 3 * SIDE * SIDE; k++)
            px[k] = colours[i][k % 3];
        assert_int_equal(video_put(&v, &picture), OK);
    }
    assert_int_equal(video_finish(&v), OK);
    snprintf(command, sizeof command,
             "ffmpeg -v error -i '%s' -vf scale=in_color_matrix=bt709 -f rawvideo -pix_fmt rgb24 -",
             tmpdir_path("films/a.mp4"));
    FILE *f = popen(command, "r");
    assert_non_null(f);
    for (int i = 0; i < 4; i++) {
        assert_int_equal(fread(px, 1, 3 * SIDE * SIDE, f), 3 * SIDE * SIDE);
        for (int k = 0; k < 3 * SIDE * SIDE; k++)
            if (abs(px[k] - colours[i][k % 3]) > 5)
                fail_msg("colour %d: %d, wanted %d", i, px[k], colours[i][k % 3]);
    }
    assert_int_equal(fgetc(f), EOF);
    assert_int_equal(pclose(f), 0);
}

int main(void)
{
    signal(SIGPIPE, SIG_IGN);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(odd_sides_are_made_even, setup, teardown),
        cmocka_unit_test_setup_teardown(is_told_size_and_rate, setup, teardown),
        cmocka_unit_test_setup_teardown(takes_what_there_is, setup, teardown),
        cmocka_unit_test_setup_teardown(no_ffmpeg, setup, teardown),
        cmocka_unit_test_setup_teardown(ffmpeg_fails, setup, teardown),
        cmocka_unit_test_setup_teardown(bad_paths, setup, teardown),
        cmocka_unit_test_setup_teardown(former_film_stays, setup, teardown),
        cmocka_unit_test_setup_teardown(keeps_somebody_elses_film, setup, teardown),
        cmocka_unit_test_setup_teardown(cancelled, setup, teardown),
        cmocka_unit_test_setup_teardown(cancelled_before, setup, teardown),
        cmocka_unit_test_setup_teardown(colours_come_back, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
