/* random_calls HDRIG TEMPLATE WORK SEED N - calls the tool N times with random commands, options,
 * folders and files in WORK, a copy of TEMPLATE that is laid anew every RENEW calls. TEMPLATE.list
 * names the files of it that are somebody else's, one a line: after every call they must be there,
 * as they were. A call that ends by a signal, takes longer than SECONDS, ends with an unknown code
 * or fails without a sentence is told, and the exit code is 1. */
#include "drivers/format/file.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

enum { RENEW = 100, SECONDS = 60, ARGS = 24, FILES = 256, NAME = 256 };

static char name[FILES][NAME];
static int n_files;
static uint64_t rng;
static const char *hdrig, *template, *work;

static unsigned below(unsigned n)
{
    rng = rng * 6364136223846793005u + 1442695040888963407u;
    return (unsigned)(rng >> 33) % n;
}

#define PICK(list) (list)[below(sizeof(list) / sizeof(list)[0])]

/* In WORK, or beside it. */
static const char *const places[] = {"photos",
                                     "photos/",
                                     "photos/a.png",
                                     "photos/new",
                                     "thesis",
                                     "thesis/new",
                                     "thesis/thesis.txt",
                                     "thesis/report.json",
                                     "listed",
                                     "made",
                                     "made/",
                                     "./made/.",
                                     "made/scene.ply",
                                     "made/ldr",
                                     "made/cameras.json",
                                     "made/notes.txt",
                                     "noted",
                                     "noted/scene.ply",
                                     "noted/notes.txt",
                                     "edited",
                                     "edited/scene.ply",
                                     "world",
                                     "world/images",
                                     "world/exposure.json",
                                     "world/sparse/0",
                                     "link",
                                     "linked.ply",
                                     "own.ply",
                                     "own.hdrig",
                                     "own.spz",
                                     "own.json",
                                     "foreign.ply",
                                     "foreign.json",
                                     "foreign.mp4",
                                     "foreign.hdrig",
                                     "foreign.spz",
                                     "foreign.glb",
                                     "foreign.html",
                                     ".tmp-new-99999999",
                                     "take",
                                     "take/images",
                                     "take/new",
                                     "new",
                                     "new/deeper",
                                     "new.ply",
                                     "new.hdrig",
                                     "new.json",
                                     "new.html",
                                     "new.spz",
                                     "new.glb",
                                     "new.mp4",
                                     "empty",
                                     "none/at/all",
                                     ".",
                                     "..",
                                     "",
                                     "/dev/null",
                                     "-",
                                     "../stage/thesis",
                                     "photos/../made",
                                     "own.conf",
                                     "store",
                                     "a\nb",
                                     "\xff\xfe"};

static const char *place(void)
{
    return PICK(places);
}

static const char *number(void)
{
    static const char *const numbers[] = {"0",    "1",           "2",   "3",    "56", "28",
                                          "-1",   "1e9",         "nan", "x",    "",   "0.5",
                                          "4096", "99999999999", "1,2", "-3..3"};
    return PICK(numbers);
}

enum kind { PLACE, NUMBER, WORD, SWITCH };

struct option {
    const char *name;
    enum kind kind;
    const char *word; // for WORD: "a|b|c"; for PLACE: valid ones, taken half of the time
};

struct command {
    const char *name;
    bool operand; // comes before the options
    struct option option[16];
};

static const struct command commands[] = {
    {"reconstruct",
     false,
     {{"--images", PLACE, "world|photos|one"},
      {"--out", PLACE, "new|made|edited|noted|thesis|new.ply|new.hdrig"},
      {"--exposures", PLACE, "world/exposure.json"},
      {"--rig", PLACE, "world/sparse/0|made/cameras.json"},
      {"--model", WORD, "none|own.hdrig|made"},
      {"--json", PLACE, NULL},
      {"--dump", PLACE, NULL},
      {"--force", SWITCH, NULL},
      {"--strict", SWITCH, NULL},
      {"--refine-poses", SWITCH, NULL},
      {"--seed", NUMBER, NULL},
      {"--config", PLACE, NULL}}},
    {"eval",
     false,
     {{"--data", PLACE, "world"},
      {"--out", PLACE, "new|made|edited|noted|thesis|new.ply|new.hdrig"},
      {"--scene", PLACE, "made|own.ply|own.hdrig|noted"},
      {"--rig", PLACE, "world/sparse/0|made/cameras.json"},
      {"--json", PLACE, NULL},
      {"--views", NUMBER, NULL},
      {"--force", SWITCH, NULL},
      {"--strict", SWITCH, NULL}}},
    {"render",
     false,
     {{"--scene", PLACE, "made|own.ply|own.hdrig|noted"},
      {"--out", PLACE, "new|made|edited|noted|thesis|new.ply|new.hdrig"},
      {"--cameras", PLACE, "made/cameras.json"},
      {"--path", WORD, "inputs|orbit|moon"},
      {"--frames", WORD, "1|2|0"},
      {"--ev", NUMBER, NULL},
      {"--hdr", SWITCH, NULL},
      {"--false-colour", SWITCH, NULL},
      {"--video", PLACE, NULL},
      {"--force", SWITCH, NULL}}},
    {"convert-scene",
     true,
     {{"--out", PLACE, "new|made|edited|noted|thesis|new.ply|new.hdrig"},
      {"--json", PLACE, NULL},
      {"--crop", WORD, "-1,-1,0,1,1,3|0,0,0,1,1|1,1,1,0,0,0"},
      {"--without-guesses", SWITCH, NULL},
      {"--spz", WORD, "3|4|5"}}},
    {"export",
     true,
     {{"--images", PLACE, "world"},
      {"--colmap", PLACE, "new|made|edited|noted|thesis|new.ply|new.hdrig"},
      {"--nerfstudio", PLACE, "new/t.json|made/t.json|noted/t.json|thesis/t.json"},
      {"--lens", WORD, "photographed|none"},
      {"--force", SWITCH, NULL}}},
    {"convert",
     true,
     {{"--out", PLACE, "new|made|edited|noted|thesis|new.ply|new.hdrig"},
      {"--config", WORD, "mini|own.json|photos"},
      {"--precision", WORD, "int8|fp32|bf16|int4"}}},
    {"simulate",
     false,
     {{"--out", PLACE, "new|made|edited|noted|thesis|new.ply|new.hdrig"},
      {"--views", WORD, "2|3|1"},
      {"--force", SWITCH, NULL},
      {"--noise-free", SWITCH, NULL}}},
    {"capture",
     false,
     {{"--camera", WORD, "replay:photos|replay:world|sim:nothing=1"},
      {"--out", PLACE, "new|made|edited|noted|thesis|new.ply|new.hdrig"},
      {"--bracket", NUMBER, NULL}}},
    {"calibrate", false, {{"--camera", WORD, "replay:photos|v4l2:/dev/none"}}},
    {"selftest",
     false,
     {{"--camera", WORD, "v4l2:/dev/none|replay:none"}, {"--json", PLACE, NULL}}},
    {"status", false, {{"--json", SWITCH, NULL}, {"--config", PLACE, NULL}}},
    {"config", false, {{"--print", SWITCH, NULL}, {"--config", PLACE, NULL}}},
};

static const char *value(const struct option *o)
{
    static char word[64];
    if (o->kind == PLACE && (!o->word || below(2)))
        return place();
    if (o->kind == NUMBER)
        return number();
    int n = 1;
    for (const char *c = o->word; *c; c++)
        n += *c == '|';
    const char *from = o->word;
    for (int k = (int)below((unsigned)n); k > 0; k--)
        from = strchr(from, '|') + 1;
    snprintf(word, sizeof word, "%.*s", (int)strcspn(from, "|"), from);
    return word;
}

/* Small and quick where the command has such options. */
static int bound(const char *command, char *argv[])
{
    int n = 0;
    bool job = strcmp(command, "reconstruct") == 0 || strcmp(command, "eval") == 0;
    if (job || strcmp(command, "simulate") == 0 || strcmp(command, "render") == 0) {
        argv[n++] = strdup("--size");
        argv[n++] = strdup("56");
        argv[n++] = strdup("--threads");
        argv[n++] = strdup("1");
    }
    if (job) {
        argv[n++] = strdup("--refine");
        argv[n++] = strdup(below(8) ? "0" : "1");
    }
    if (strcmp(command, "simulate") == 0) {
        argv[n++] = strdup("--samples");
        argv[n++] = strdup("1");
    }
    return n;
}

static void make_call(char *argv[ARGS + 1])
{
    const struct command *c = &PICK(commands);
    int n = 0, n_options = 0;
    argv[n++] = strdup(hdrig);
    argv[n++] = strdup(c->name);
    if (c->operand && below(16))
        argv[n++] = strdup(below(2) ? place() : "made");
    n += bound(c->name, argv + n);
    while (n_options < 16 && c->option[n_options].name)
        n_options++;
    for (int i = 0; i < n_options && n + 2 < ARGS; i++) {
        const struct option *o = &c->option[i];
        if (below(i < 2 ? 16 : 8) == 0 ? i < 2 : i >= 2)
            continue; // the first two are needed
        argv[n++] = strdup(o->name);
        if (o->kind != SWITCH)
            argv[n++] = strdup(value(o));
    }
    if (below(64) == 0)
        argv[n++] = strdup(place());
    argv[n] = NULL;
}

static void tell(const char *what, char *argv[])
{
    printf("%s:", what);
    for (int i = 0; argv[i]; i++)
        printf(" '%s'", argv[i]);
    putchar('\n');
}

/* Exit code, or 256 and more. out: bytes that it said on stderr. */
static int call(char *argv[], off_t *out)
{
    char log[] = "/tmp/random-calls-XXXXXX";
    int status = 0, fd = mkstemp(log);
    struct stat st = {0};
    if (fd < 0)
        return 512;
    unlink(log);
    pid_t pid = fork();
    if (pid == 0) {
        int null = open("/dev/null", O_RDWR);
        if (chdir(work) != 0 || dup2(null, 0) < 0 || dup2(null, 1) < 0 || dup2(fd, 2) < 0)
            _exit(99);
        alarm(SECONDS);
        execv(hdrig, argv);
        _exit(99);
    }
    while (waitpid(pid, &status, 0) < 0 && errno == EINTR)
        ;
    *out = fstat(fd, &st) == 0 ? st.st_size : 0;
    close(fd);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 256 + WTERMSIG(status);
}

static bool same(const char *file)
{
    char a[FILE_PATH_CAP], b[FILE_PATH_CAP], to_a[NAME] = "", to_b[NAME] = "";
    struct stat x, y;
    if (file_join(template, file, a) != OK || file_join(work, file, b) != OK || lstat(a, &x) != 0 ||
        lstat(b, &y) != 0 || x.st_mode != y.st_mode || x.st_size != y.st_size)
        return false;
    if (S_ISLNK(x.st_mode))
        return readlink(a, to_a, NAME - 1) == readlink(b, to_b, NAME - 1) &&
               strcmp(to_a, to_b) == 0;
    if (!S_ISREG(x.st_mode))
        return true;
    struct file_map m = {0}, n = {0};
    bool ok = file_map(a, SIZE_MAX, &m) == OK && file_map(b, SIZE_MAX, &n) == OK && m.n == n.n &&
              (m.n == 0 || memcmp(m.p, n.p, m.n) == 0);
    file_unmap(&m);
    file_unmap(&n);
    return ok;
}

static bool renew(void)
{
    char line[3 * FILE_PATH_CAP];
    snprintf(line, sizeof line, "chmod -R u+w '%s' 2>/dev/null; rm -rf '%s' && cp -a '%s' '%s'",
             work, work, template, work);
    return system(line) == 0;
}

static bool read_list(void)
{
    char path[FILE_PATH_CAP];
    snprintf(path, sizeof path, "%s.list", template);
    FILE *f = fopen(path, "r");
    while (f && n_files < FILES && fgets(name[n_files], NAME, f)) {
        name[n_files][strcspn(name[n_files], "\n")] = 0;
        n_files++;
    }
    if (f)
        fclose(f);
    return n_files > 0 && n_files < FILES;
}

/* Faults of a call and of what it left of the files. */
static int judge(char *argv[], int code, off_t said)
{
    int bad = 0;
    if (code > 3) {
        printf("code %d: ", code);
        tell("unknown end", argv);
        bad++;
    } else if (code && !said) {
        tell("fails without a word", argv);
        bad++;
    }
    for (int k = 0; k < n_files; k++)
        if (!same(name[k])) {
            printf("%s changed or gone: ", name[k]);
            tell("by", argv);
            bad++;
        }
    return bad;
}

int main(int argc, char **argv)
{
    int bad = 0, codes[5] = {0};
    if (argc != 6)
        return 2;
    hdrig = argv[1]; // an absolute path
    template = argv[2];
    work = argv[3];
    rng = strtoull(argv[4], NULL, 10);
    int n = atoi(argv[5]);
    if (!read_list()) {
        fprintf(stderr, "%s.list: no list of files\n", template);
        return 2;
    }
    for (int i = 0; i < n && !bad; i++) {
        char *args[ARGS + 1];
        off_t said = 0;
        if (i % RENEW == 0 && !renew())
            return 2;
        make_call(args);
        int code = call(args, &said);
        codes[code < 4 ? code : 4]++;
        bad += judge(args, code, said);
        for (int k = 0; args[k]; k++)
            free(args[k]);
    }
    printf("%d calls: %d succeeded, %d failed, %d misused, %d refused, %d otherwise; %d files of "
           "others looked at after each\n",
           n, codes[0], codes[1], codes[2], codes[3], codes[4], n_files);
    return bad > 0;
}
