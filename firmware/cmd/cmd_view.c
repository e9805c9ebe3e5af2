/* hdrig view: the page of a scene, in the browser of this machine. */
#include "drivers/device/clocks.h"
#include "firmware/base/engine.h"
#include "firmware/cmd/cmd.h"
#include "firmware/daemon/http.h"

#include "drivers/format/file.h"

#include <errno.h>
#include <limits.h>
#include <poll.h>
#include <spawn.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>

enum { STEP_MS = 500 };

static bool ends_with(const char *text, const char *end)
{
    size_t n = strlen(text), m = strlen(end);
    return n > m && strcmp(text + n - m, end) == 0;
}

/* The page of `what`, a page itself or a result. */
static err_t find_page(const char *what, char page[FILE_PATH_CAP])
{
    bool dir = file_is_dir(what);
    if (!dir && !ends_with(what, ".html"))
        return file_exists(what)
                   ? err_fail(
                         ERR_ARG,
                         "%s is not a page: make one with hdrig convert-scene %s --out NAME.html",
                         what, what)
                   : err_fail(ERR_IO, "%s: no such folder", what);
    snprintf(page, FILE_PATH_CAP, "%s", what);
    err_t e = dir ? file_join(what, "view.html", page) : OK;
    if (!e && !file_is_regular(page))
        e = dir ? err_fail(ERR_IO,
                           "%s has no view.html: make one with hdrig convert-scene %s --out "
                           "%s/view.html",
                           what, what, what)
                : err_fail(ERR_IO, "%s: no such file", what);
    return e;
}

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

static err_t open_page(const char *page)
{
    char whole[PATH_MAX];
    pid_t child;
    int status = 0;
    if (!realpath(page, whole))
        return err_fail(ERR_IO, "%s: cannot be found", page);
    const char *why = start_browser(whole, &child);
    if (!why && (waitpid(child, &status, 0) != child || status != 0))
        why = "xdg-open found none";
    if (why)
        return err_fail(ERR_UNSUPPORTED,
                        "no browser could be started (%s); open this file in one: %s", why, whole);
    printf("%s\n", whole);
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
    const char *what = NULL, *port_text = "0";
    char page[FILE_PATH_CAP];
    struct config cfg;
    bool serves = false;
    int port;
    int code;
    const struct cmd_option options[] = {
        {"serve", NULL, "for browsers that refuse local files: on this machine, until Ctrl-C", NULL,
         NULL, &serves},
        {"port", "N", "of --serve; else any free one", NULL, &port_text, NULL},
    };
    const struct cmd_usage usage = {"view", "DIR|FILE.html ",
                                    "The page of a scene in the browser of this machine.", options,
                                    sizeof options / sizeof options[0]};
    if (argc > 1 && argv[1][0] != '-') { // the folder comes before the options
        what = *++argv;
        *argv = argv[-1];
        argc--;
    }
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    if (!what)
        return cmd_misuse(&usage, "the folder of a result is needed");
    if (cmd_whole("--port", port_text, 0, 65535, &port) != OK)
        return cmd_misuse(&usage, err_text());
    if (serves && !file_is_dir(what))
        return cmd_misuse(&usage, "--serve needs the folder of a result");
    err_t e = find_page(what, page);
    if (!e)
        e = serves ? serve_page(what, port) : open_page(page);
    return cmd_finish(usage.name, e);
}
