/* hdrig view: the page of a scene, in the browser of this machine. */
#include "drivers/device/clocks.h"
#include "firmware/base/engine.h"
#include "firmware/base/tempdir.h"
#include "firmware/cmd/cmd.h"
#include "firmware/daemon/http.h"
#include "firmware/result/sceneio.h"
#include "firmware/result/viewer.h"

#include "drivers/format/file.h"

#include <errno.h>
#include <limits.h>
#include <poll.h>
#include <spawn.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>

enum { STEP_MS = 500 };

struct shown {
    const char *what;        // as the user named it
    char dir[FILE_PATH_CAP]; // made for the page of a file, and goes when the command ends; else ""
    char page[FILE_PATH_CAP];
};

static bool ends_with(const char *text, const char *end)
{
    size_t n = strlen(text), m = strlen(end);
    return n > m && strcmp(text + n - m, end) == 0;
}

/* ---- the page ---- */

static err_t convert_scene(struct engine *en, const struct shown *v, const struct config *cfg)
{
    const struct sceneio_format format = {.title = file_name(v->what)};
    struct arena keep = arena_counter();
    struct sceneio_info info;
    struct scene scene;
    struct gaussians_report report;
    err_t e = sceneio_peek(v->what, &info);
    if (!e && info.n > VIEWER_SPLATS_MAX)
        e = err_fail(ERR_ARG, "%s: %d splats, a page can hold %d", v->what, info.n,
                     VIEWER_SPLATS_MAX);
    if (e)
        return e;
    arena_hold(&keep, info.need);
    e = engine_reserve(en, sceneio_write_plan(info.n, info.degree), keep.peak, 0,
                       config_memory_mb(cfg));
    if (!e)
        e = sceneio_read(v->what, &en->keep, &scene, &report);
    if (!e)
        e = sceneio_write(v->page, &scene, &format);
    if (!e)
        e = run_check(&en->run, v->what);
    if (!e)
        sceneio_warn(v->what, &info, &scene, &report);
    return e;
}

static err_t make_page(struct shown *v, const struct config *cfg)
{
    static struct engine engine;
    err_t e = tempdir_make("hdrig-view", v->dir);
    if (!e)
        e = file_join(v->dir, "view.html", v->page);
    if (!e)
        e = engine_open(&engine, cfg->threads);
    if (!e)
        e = convert_scene(&engine, v, cfg);
    engine_close(&engine);
    return e;
}

/* That of a page itself, of a result, or of a scene's file. */
static err_t find_page(struct shown *v, const struct config *cfg)
{
    const char *what = v->what;
    bool dir = file_is_dir(what);
    if (!file_exists(what))
        return err_fail(ERR_IO, "%s: no such file or folder", what);
    if (!dir && !ends_with(what, ".html"))
        return make_page(v, cfg);
    snprintf(v->page, FILE_PATH_CAP, "%s", what);
    err_t e = dir ? file_join(what, "view.html", v->page) : OK;
    if (!e && !file_is_regular(v->page))
        e = dir ? err_fail(ERR_IO,
                           "%s has no view.html: make one with hdrig convert-scene %s --out "
                           "%s/view.html",
                           what, what, what)
                : err_fail(ERR_IO, "%s: no file", what);
    return e;
}

/* ---- the browser ---- */

/* Open the page with the desktop's browser, if there is a desktop. Returns the error's text. */
static const char *start_browser(const char *address, pid_t *child)
{
    char *const argv[] = {"xdg-open", (char *)(uintptr_t)address, NULL};
    extern char **environ;
    if (!getenv("DISPLAY") && !getenv("WAYLAND_DISPLAY") && !getenv("BROWSER"))
        return "there is no desktop here";
    int why = posix_spawnp(child, argv[0], NULL, NULL, argv, environ);
    return why == 0        ? NULL
           : why == ENOENT ? "xdg-open is not installed: apt-get install xdg-utils"
                           : strerror(why);
}

static void wait_for_end(void)
{
    fputs("Ctrl-C ends it and removes the page\n", stderr);
    while (!atomic_load(&engine_cancel))
        poll(NULL, 0, STEP_MS);
}

static err_t open_page(const struct shown *v)
{
    char whole[PATH_MAX];
    pid_t child;
    int status = 0;
    if (!realpath(v->page, whole))
        return err_fail(ERR_IO, "%s: cannot be found", v->page);
    const char *why = start_browser(whole, &child);
    if (!why && (waitpid(child, &status, 0) != child || status != 0))
        why = "xdg-open found none";
    if (why && v->dir[0])
        return err_fail(ERR_UNSUPPORTED,
                        "no browser could be started (%s): use --serve, or make a page with hdrig "
                        "convert-scene %s --out NAME.html",
                        why, v->what);
    if (why)
        return err_fail(ERR_UNSUPPORTED,
                        "no browser could be started (%s); open this file in one: %s", why, whole);
    printf("%s\n", whole);
    fflush(stdout);
    if (v->dir[0])
        wait_for_end();
    return OK;
}

/* Until the user interrupts. */
static err_t serve_page(const char *dir, int port)
{
    const struct http_config cfg = {
        .address = "127.0.0.1", .port = port, .token = "", .results = dir};
    struct http *http;
    char address[64];
    pid_t child;
    err_t e = http_open(&cfg, &http);
    if (e)
        return e;
    snprintf(address, sizeof address, "http://127.0.0.1:%d/results/view.html", http_port(http));
    printf("%s\n", address);
    fflush(stdout);
    fputs("Ctrl-C ends it\n", stderr);
    const char *why = start_browser(address, &child);
    if (why)
        fprintf(stderr, "no browser could be started (%s); open that address in one\n", why);
    while (!atomic_load(&engine_cancel)) {
        int64_t now = clocks_now(), deadline = now + STEP_MS * 1000000;
        struct pollfd p = http_poll(http, now, &deadline);
        poll(&p, 1, (int)((deadline - now) / 1000000));
        http_step(http);
    }
    http_close(http);
    return OK;
}

int cmd_view_run(int argc, char **argv)
{
    static struct shown v;
    const char *port_text = "0";
    struct config cfg;
    bool serves = false;
    int port;
    int code;
    const struct cmd_option options[] = {
        {"serve", NULL, "for browsers that refuse local files: on this machine, until Ctrl-C", NULL,
         NULL, &serves},
        {"port", "N", "of --serve; else any free one", NULL, &port_text, NULL},
        CMD_MEMORY,
    };
    const struct cmd_usage usage = {
        "view", "DIR|FILE ",
        "The page of a scene in the browser of this machine: of a result, or any file that\n"
        "convert-scene reads, whose page goes when the command ends.",
        options, sizeof options / sizeof options[0]};
    if (argc > 1 && argv[1][0] != '-') { // the folder comes before the options
        v.what = *++argv;
        *argv = argv[-1];
        argc--;
    }
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    if (!v.what)
        return cmd_misuse(&usage, "the folder of a result or the file of a scene is needed");
    if (cmd_whole("--port", port_text, 0, 65535, &port) != OK)
        return cmd_misuse(&usage, err_text());
    if (serves && !file_is_dir(v.what) && ends_with(v.what, ".html"))
        return cmd_misuse(&usage, "--serve needs the folder of a result or the file of a scene");
    err_t e = find_page(&v, &cfg);
    if (!e)
        e = serves ? serve_page(v.dir[0] ? v.dir : v.what, port) : open_page(&v);
    tempdir_remove(v.dir);
    return cmd_finish(usage.name, e);
}
