/* hdrig rig broker, add, remove, join: from single boards to a rig. The line that a board joins by
 * goes to stdout, and comes in by stdin: arguments and the logs of sudo are no place for a
 * password. */
#include "firmware/base/tool.h"
#include "firmware/cmd/cmd_rig.h"
#include "firmware/rig/boards.h"
#include "firmware/rig/broker.h"
#include "firmware/rig/join.h"

#include "drivers/format/qr.h"

#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

enum { PORT = 8883 };

#define CMD_DIR(to)                                                                                \
    {                                                                                              \
        "dir", "DIR", "folder of mosquitto's settings (" BROKER_DIR ")", NULL, &(to), NULL         \
    }

/* ---- the line ---- */

static void print_code(const char *line, bool asked)
{
    struct winsize w = {0};
    const bool terminal = isatty(STDERR_FILENO) && isatty(STDOUT_FILENO);
    if (!asked && !terminal)
        return;
    if (isatty(STDERR_FILENO) && ioctl(STDERR_FILENO, TIOCGWINSZ, &w) != 0)
        w.ws_col = 0;
    if (qr_print(line, w.ws_col, stderr) != OK)
        fprintf(stderr, "no QR code: %s\n", err_text());
}

static err_t print_line(const struct joinline *j, bool conductor, bool qr)
{
    char line[JOINLINE_CAP];
    const err_t e = joinline_write(j, line);
    if (e)
        return e;
    if (isatty(STDOUT_FILENO))
        fprintf(stderr,
                "On %s call: sudo hdrig rig join%s\n"
                "and paste this line, which is a secret, since it has the board's password:\n",
                j->board, conductor ? " --conductor" : "");
    puts(line);
    fflush(stdout);
    print_code(line, qr);
    explicit_bzero(line, sizeof line);
    return OK;
}

/* The system's broker, if that is the one. */
static void reload_broker(const char *dir)
{
    char *const ask[] = {"systemctl", "is-active", "--quiet", "mosquitto", NULL};
    char *const tell[] = {"systemctl", "reload", "mosquitto", NULL};
    if (strcmp(dir, BROKER_DIR) == 0 && tool_run(ask) == OK && tool_run(tell) == OK)
        fputs("mosquitto has read its users again\n", stderr);
    else
        fputs("send SIGHUP to mosquitto, or start it: it reads its users then\n", stderr);
}

/* ---- broker ---- */

struct broker_words {
    struct config cfg;
    const char *host, *port, *conductor, *dir;
    bool qr;
};

static err_t make_broker(const struct broker_words *q)
{
    struct broker_site site = {.port = PORT};
    struct joinline j = {0};
    bool known = false;
    if (strlen(q->host) >= sizeof site.host || strlen(q->cfg.rig_name) >= sizeof site.rig ||
        (q->conductor && strlen(q->conductor) >= sizeof site.conductor))
        return err_fail(ERR_ARG, "the host, or a name, is too long");
    err_t e = q->port ? cmd_whole("--port", q->port, 1, 65535, &site.port) : OK;
    if (!e && q->conductor)
        snprintf(site.conductor, sizeof site.conductor, "%s", q->conductor);
    else if (!e)
        e = boards_open_name(&q->cfg, site.conductor);
    snprintf(site.host, sizeof site.host, "%s", q->host);
    snprintf(site.rig, sizeof site.rig, "%s", q->cfg.rig_name);
    if (!e)
        e = broker_make(q->dir, &site);
    if (!e)
        e = broker_knows(q->dir, site.conductor, &known);
    if (e)
        return e;
    fprintf(stderr,
            "broker of rig %s: %s port %d, by %s/conf.d/hdrig.conf\n"
            "now start mosquitto again: sudo systemctl restart mosquitto\n",
            site.rig, site.host, site.port, q->dir);
    if (known) {
        fprintf(stderr,
                "%s and the other boards stay as they are; hdrig rig add gives a board a "
                "new password\n",
                site.conductor);
        return OK;
    }
    e = broker_add(q->dir, site.conductor, &j);
    if (!e)
        e = print_line(&j, true, q->qr);
    explicit_bzero(&j, sizeof j);
    return e;
}

int cmd_rig_setup_broker(int argc, char **argv)
{
    static struct broker_words q = {.dir = BROKER_DIR};
    int code;
    const struct cmd_option options[] = {
        {"host", "HOST", "name or address of this machine, as the boards reach it", NULL, &q.host,
         NULL},
        {"port", "N", "of the broker (8883)", NULL, &q.port, NULL},
        CMD_KEY("name", "RIG", "rig.name", "name of the rig"),
        {"conductor", "BOARD", "board that leads the rig (this one)", NULL, &q.conductor, NULL},
        CMD_DIR(q.dir),
        {"qr", NULL, "the line as a QR code, too, also without a terminal", NULL, NULL, &q.qr},
    };
    const struct cmd_usage usage = {
        "rig broker", "--host HOST ",
        "Makes mosquitto on this machine the broker of a rig: certificates, rules, and the\n"
        "conductor as its first user, whose line for hdrig rig join --conductor it prints.\n"
        "Called again, for another host, it keeps the boards that have joined.",
        options, sizeof options / sizeof options[0]};
    if (!cmd_parse(&usage, argc, argv, &q.cfg, &code))
        return code;
    if (!q.host)
        return cmd_misuse(&usage, "--host is needed");
    return cmd_finish(usage.name, make_broker(&q));
}

/* ---- add ---- */

static err_t add_board(const char *dir, const char *board, bool qr)
{
    struct broker_site site;
    struct joinline j = {0};
    err_t e = broker_site(dir, &site);
    if (!e)
        e = broker_add(dir, board, &j);
    if (e)
        return e;
    reload_broker(dir);
    const bool conductor = strcmp(board, site.conductor) == 0;
    e = print_line(&j, conductor, qr);
    explicit_bzero(&j, sizeof j);
    if (!e && !conductor)
        fprintf(stderr,
                "Captures wait for it if the settings of %s have a line\n"
                "  rig.member.N = %s\n",
                site.conductor, board);
    return e;
}

int cmd_rig_setup_add(int argc, char **argv)
{
    struct config cfg;
    const char *dir = BROKER_DIR;
    bool qr = false;
    int code;
    const struct cmd_option options[] = {
        CMD_DIR(dir),
        {"qr", NULL, "the line as a QR code, too, also without a terminal", NULL, NULL, &qr},
    };
    const struct cmd_usage usage = {
        "rig add", "BOARD ",
        "On the machine of the broker: lets a board in, with a new password, and prints the line\n"
        "that hdrig rig join needs there. A line of before does not work any more.",
        options, sizeof options / sizeof options[0]};
    const char *board = cmd_rig_word(&argc, &argv);
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    if (!*board)
        return cmd_misuse(&usage, "the name of the board is needed");
    return cmd_finish(usage.name, add_board(dir, board, qr));
}

/* ---- remove ---- */

static err_t remove_board(const char *dir, const char *board)
{
    struct broker_site site;
    err_t e = broker_site(dir, &site);
    if (!e)
        e = broker_remove(dir, board);
    if (e)
        return e;
    reload_broker(dir);
    fprintf(stderr,
            "The broker then ends the connection of %s, and lets it in no more. %s notices that\n"
            "within 30 s; take rig.member.N = %s out of its settings, if it is there, and call\n"
            "  hdrig rig forget %s\n",
            board, site.conductor, board, board);
    return OK;
}

int cmd_rig_setup_remove(int argc, char **argv)
{
    struct config cfg;
    const char *dir = BROKER_DIR;
    int code;
    const struct cmd_option options[] = {CMD_DIR(dir)};
    const struct cmd_usage usage = {
        "rig remove", "BOARD ",
        "On the machine of the broker: takes back what hdrig rig add gave, so that the board does\n"
        "not get in any more. The other boards are not disturbed.",
        options, 1};
    const char *board = cmd_rig_word(&argc, &argv);
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    if (!*board)
        return cmd_misuse(&usage, "the name of the board is needed");
    return cmd_finish(usage.name, remove_board(dir, board));
}

/* ---- join ---- */

static err_t read_line(struct joinline *out)
{
    char line[JOINLINE_CAP];
    if (isatty(STDIN_FILENO))
        fputs("paste the line that hdrig rig add has printed:\n", stderr);
    const bool some = fgets(line, sizeof line, stdin) != NULL;
    const err_t e = some ? joinline_read(line, out)
                         : err_fail(ERR_FORMAT, "no line on stdin: the one that hdrig rig add "
                                                "prints is needed there");
    explicit_bzero(line, sizeof line);
    return e;
}

static err_t join_rig(const char *dir, bool conductor)
{
    static struct joinline line;
    static struct join_outcome done;
    const struct join j = {dir, conductor, &line};
    err_t e = read_line(&line);
    if (!e)
        e = join_write(&j, stdout, &done);
    if (!e && done.token[0])
        printf("password of this board's page: %s\n", done.token);
    fflush(stdout);
    if (!e) {
        fprintf(stderr, "%s is %s of rig %s. Now: sudo systemctl restart hdrigd\n", line.board,
                conductor ? "the conductor" : "a member", line.rig);
        if (join_try(&done.set, &line) == OK)
            fputs("the broker lets it in\n", stderr);
        else
            fprintf(stderr, "but the broker does not let it in yet: %s\n", err_text());
    }
    explicit_bzero(&line, sizeof line);
    explicit_bzero(&done, sizeof done);
    return e;
}

int cmd_rig_setup_join(int argc, char **argv)
{
    struct config cfg;
    const char *dir = CONFIG_DIR;
    bool conductor = false;
    int code;
    const struct cmd_option options[] = {
        {"conductor", NULL, "this board leads the rig", NULL, NULL, &conductor},
        {"dir", "DIR", "folder of the settings (" CONFIG_DIR ")", NULL, &dir, NULL},
    };
    const struct cmd_usage usage = {
        "rig join", "<LINE ",
        "Makes this machine a board of a rig: reads the line of hdrig rig add on stdin, writes\n"
        "its settings, password and certificate, and tells what has changed.",
        options, sizeof options / sizeof options[0]};
    char *word = cmd_rig_word(&argc, &argv);
    const bool has_word = *word != 0;
    if (has_word)
        explicit_bzero(word, strlen(word));
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    if (has_word)
        return cmd_misuse(&usage, "the line has a password, which others can read in arguments: "
                                  "give it on stdin, after a new hdrig rig add");
    return cmd_finish(usage.name, join_rig(dir, conductor));
}
