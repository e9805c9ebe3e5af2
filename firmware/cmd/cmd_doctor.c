/* hdrig doctor: lists programs, libraries and devices of this machine. */
#include "firmware/base/engine.h"
#include "firmware/cmd/cmd.h"

#include "core/base/cpu.h"
#include "drivers/device/camera.h"
#include "drivers/format/file.h"
#include "drivers/format/modelfile.h"
#include "drivers/net/ranks.h"

#include <glob.h>
#include <link.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* Name of the processor; device trees have no "model name", then it is the machine's model. */
static void print_processor(void)
{
    char line[256], name[200] = "";
    FILE *f = fopen("/proc/cpuinfo", "re");
    while (f && !*name && fgets(line, sizeof line, f))
        if (sscanf(line, "model name : %199[^\n]", name) != 1)
            name[0] = 0;
    if (f)
        fclose(f);
    f = *name ? NULL : fopen("/proc/device-tree/model", "re");
    if (f && !fgets(name, sizeof name, f))
        name[0] = 0;
    if (f)
        fclose(f);
    printf("processor      %s\n", *name ? name : "unknown");
}

static void print_memory(const struct config *cfg)
{
    double page = (double)sysconf(_SC_PAGESIZE) * 1e-6;
    printf("cores          %ld\n", sysconf(_SC_NPROCESSORS_ONLN));
    printf("memory         %.0f MB, %.0f MB free; jobs take up to %d MB\n",
           page * (double)sysconf(_SC_PHYS_PAGES), page * (double)sysconf(_SC_AVPHYS_PAGES),
           config_memory_mb(cfg));
}

/* The file behind a shared library carries its version: libspng.so.0 is libspng.so.0.7.3. */
static int print_library(struct dl_phdr_info *info, size_t size, void *ctx)
{
    (void)size;
    (void)ctx;
    char *real = info->dlpi_name[0] ? realpath(info->dlpi_name, NULL) : NULL;
    if (real)
        printf("library        %s\n", strrchr(real, '/') + 1);
    free(real);
    return 0;
}

/* Device nodes, with a hint where rights are missing. */
static void print_nodes(const char *what, const char *pattern, const char *group)
{
    glob_t g;
    bool found = glob(pattern, 0, NULL, &g) == 0;
    for (size_t i = 0; found && i < g.gl_pathc; i++) {
        bool ours = access(g.gl_pathv[i], R_OK | W_OK) == 0;
        printf("%-14s %s%s%s%s\n", what, g.gl_pathv[i],
               ours ? "" : ": no permission, add the user: ", ours ? "" : "sudo adduser $USER ",
               ours ? "" : group);
    }
    if (!found)
        printf("%-14s none at %s\n", what, pattern);
    globfree(&g);
}

/* Only opening a camera shows whether module, library and rights are there. */
static void print_libcamera(void)
{
    struct camera_cfg cfg = {.uri = "libcamera:0"};
    void *st = calloc(1, camera_libcamera.state_bytes);
    if (st && camera_libcamera.open(st, &cfg) == OK) {
        printf("libcamera      the first camera streams\n");
        camera_libcamera.close(st);
    } else if (st)
        printf("libcamera      %s\n", err_text());
    free(st);
}

static void print_ranks(void)
{
    for (int i = 0; i < RANKS_LIBRARIES; i++) {
        const char *what;
        const bool can = ranks_probe(i, &what) == OK;
        printf("ranks          %s%s\n", can ? what : err_text(),
               can ? ": mpirun can start several" : "");
    }
}

static const char *kind_of(const struct net_dims *d)
{
    if (d->lpips != LPIPS_NONE)
        return d->lpips == LPIPS_VGG16 ? "LPIPS of vgg16" : "LPIPS of alexnet";
    return !d->gauss        ? "VGGT: cameras and depth"
           : !d->appearance ? "AnySplat: Gaussians of one exposure"
                            : "InstantHDR: Gaussians, radiance, tone curve";
}

/* Print the facts of a weights file; reads all of it. */
static err_t print_model(const char *path)
{
    struct modelfile file;
    err_t e = modelfile_open(path, &file);
    if (e)
        return e;
    const struct model *m = &file.model;
    const struct net_dims *d = &m->dims;
    printf("model          %s\n", kind_of(d));
    printf("weights        %s, %.0f MB, %d tensors\n", modelfile_precision(m->precision),
           (double)m->bytes * 1e-6, m->n);
    if (d->lpips == LPIPS_NONE)
        printf("dimensions     tokens of %d, %d heads, %d + 2 x %d blocks, views of %d px, cells "
               "of %g\n",
               d->embed, d->heads, d->dino_depth, d->depth, d->size, (double)d->voxel);
    printf("source         %s\nlicence        %s\n", m->source, m->licence);
    e = modelfile_verify(&file);
    if (!e)
        printf("checksum       right\n");
    modelfile_close(&file);
    return e;
}

int cmd_doctor_run(int argc, char **argv)
{
    static struct engine engine;
    struct config cfg;
    char have[CPU_NAMES_CAP], used[CPU_NAMES_CAP];
    char shipped[FILE_PATH_CAP];
    const char *model = NULL;
    const struct cmd_option options[] = {{"model", "FILE",
                                          "tell what this weights file is, and check all of it",
                                          NULL, &model, NULL},
                                         CMD_THREADS};
    const struct cmd_usage usage = {
        "doctor", "", "What this machine has, and what hdrig makes of it.", options, 2};
    int code;
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    err_t e = engine_open(&engine, cfg.threads);
    if (!e) {
        print_processor();
        printf("instructions   %s\n", cpu_names(cpu_detect(), have));
        printf("used           %s\n", cpu_names(engine.cpu, used));
        printf("kernels        splat: %s, network: int8 %s, floats %s\n", engine.kernels.name,
               engine.kernels.net.s8_name, engine.kernels.net.f32_name);
        print_memory(&cfg);
        printf("threads        %d\n", pool_size(engine.pool));
        printf("settings       %s, %s\n", CONFIG_DIR,
               file_is_dir(CONFIG_DIR) ? "read" : "not there: built-in values");
        printf("small model    %s\n",
               network_shipped(shipped) ? shipped : "not there: `make` makes build/small.hdrig");
        print_nodes("camera", "/dev/video*", "video");
        print_nodes("gpio", "/dev/gpiochip*", "hdrig");
        print_libcamera();
        print_ranks();
        dl_iterate_phdr(print_library, NULL);
    }
    if (!e && model)
        e = print_model(model);
    engine_close(&engine);
    return cmd_finish(usage.name, e);
}
