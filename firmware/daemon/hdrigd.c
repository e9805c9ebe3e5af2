/* hdrigd.c - the daemon: reads its settings and runs. */
#include "firmware/cmd/cmd.h"
#include "firmware/daemon/daemon.h"

#include "drivers/format/file.h"
#include "drivers/format/rigfile.h"

#include <getopt.h>
#include <libgen.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

enum { BAD_CONFIG = 78, OPT_SET = 256 }; // EX_CONFIG of sysexits.h: systemd does not restart then

static const char help[] =
    "usage: hdrigd [--config FILE] [--set KEY=VALUE]... [--check]\n\n"
    "Takes captures on a trigger, a command or a click, stores them and reconstructs them.\n\n"
    "  --config FILE      read these settings after those of " CONFIG_DIR "\n"
    "  --set KEY=VALUE    change one setting, see hdrig config --print\n"
    "  --check            read the settings, print what is wrong with them, and exit\n"
    "  --version          print the version\n"
    "  --help             print this text\n\n"
    "hdrig status, hdrig capture and hdrig cancel talk to it. SIGTERM ends it cleanly.\n";

struct request {
    const char *config_path;
    bool check, version, help;
};

static const struct option table[] = {
    {"config", required_argument, NULL, 'c'}, {"set", required_argument, NULL, OPT_SET},
    {"check", no_argument, NULL, 'k'},        {"version", no_argument, NULL, 'v'},
    {"help", no_argument, NULL, 'h'},         {0}};

/* First pass (c NULL): all but --set. Second pass: --set alone, after the files. */
static err_t scan_options(int argc, char **argv, struct request *q, struct config *c)
{
    err_t e = OK;
    opterr = 0;
    optind = 0;
    for (int o; !e && (o = getopt_long(argc, argv, "+:h", table, NULL)) != -1;) {
        if (o == '?' || o == ':')
            e = err_fail(ERR_ARG, o == ':' ? "%s needs an argument" : "unknown option %s",
                         argv[optind - 1]);
        q->check = q->check || o == 'k';
        q->version = q->version || o == 'v';
        q->help = q->help || o == 'h';
        if (o == 'c')
            q->config_path = optarg;
        if (o == OPT_SET && c)
            e = config_assign(c, optarg);
    }
    if (!e && optind < argc)
        e = err_fail(ERR_ARG, "unexpected argument \"%s\"", argv[optind]);
    return e;
}

/* The rig's calibration can be read, and has every camera. */
static err_t check_calibration(const struct config *c)
{
    struct rig rig;
    if (!c->rig_file[0])
        return OK;
    err_t e = rigfile_read(c->rig_file, &rig);
    // the cameras of a rig of several boards are others'
    for (int i = 0; i < CONFIG_CAMERAS && !e && c->rig_role == CONFIG_ALONE; i++) {
        char name[NAME_CAP];
        bool has = true;
        snprintf(name, sizeof name, "train_%02d_00.png", i); // as in a take
        if (c->camera[i][0])
            e = cameras_has(c->rig_file, &rig, name, &has);
        if (!e && !has)
            e = err_fail(ERR_FORMAT, "%s has no camera.%d: calibrate the rig again", c->rig_file,
                         i + 1);
    }
    cameras_free(&rig);
    return e ? err_fail(e, "rig.file: %s", err_text()) : OK;
}

/* The daemon alone needs it. */
static err_t read_token(struct config *c)
{
    if (!c->http_port || c->http_token[0] || !c->http_token_file[0])
        return OK;
    FILE *f = fopen(c->http_token_file, "re");
    const bool ok = f && fgets(c->http_token, sizeof c->http_token, f);
    if (f)
        fclose(f);
    c->http_token[strcspn(c->http_token, "\r\n")] = 0;
    return ok && c->http_token[0]
               ? OK
               : err_fail(ERR_IO, "http.token_file: %s cannot be read, or is empty",
                          c->http_token_file);
}

static err_t load_settings(int argc, char **argv, struct request *q, struct config *c)
{
    config_defaults(c);
    err_t e = config_load(c, CONFIG_DIR);
    if (!e && q->config_path)
        e = config_read(c, q->config_path);
    if (!e)
        e = scan_options(argc, argv, q, c);
    if (!e)
        e = config_check_rig(c);
    if (!e)
        e = read_token(c);
    return e ? e : check_calibration(c);
}

/* Path of hdrig, in the folder of this program. */
static err_t find_program(char path[FILE_PATH_CAP])
{
    char self[FILE_PATH_CAP];
    ssize_t n = readlink("/proc/self/exe", self, sizeof self - 1);
    if (n <= 0)
        return err_fail(ERR_IO, "/proc/self/exe cannot be read");
    self[n] = 0;
    return file_join(dirname(self), "hdrig", path);
}

static int print_error(err_t e, int code)
{
    fprintf(stderr, "hdrigd: %s\n", err_text());
    return e ? code : CMD_OK;
}

int main(int argc, char **argv)
{
    static struct config c;
    struct request q = {0};
    char program[FILE_PATH_CAP];
    err_t e = scan_options(argc, argv, &q, NULL);
    if (e)
        return print_error(e, CMD_USAGE);
    if (q.help) {
        fputs(help, stdout);
        return CMD_OK;
    }
    if (q.version) {
        puts("hdrigd " HDRIG_VERSION);
        return CMD_OK;
    }
    e = load_settings(argc, argv, &q, &c);
    if (e)
        return print_error(e, BAD_CONFIG);
    if (q.check) {
        puts("the settings are good");
        return CMD_OK;
    }
    e = find_program(program);
    struct daemon_config d = {&c, q.config_path, program, HDRIG_VERSION};
    if (!e)
        e = daemon_run(&d);
    return e ? print_error(e, e == ERR_ARG || e == ERR_UNSUPPORTED ? BAD_CONFIG : CMD_FAILURE)
             : CMD_OK;
}
