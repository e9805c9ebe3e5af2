/* hdrig doctor: what this machine has. */
#include "firmware/cmd.h"
#include "firmware/engine.h"

#include "core/base/cpu.h"
#include "drivers/file.h"

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

static void print_memory(void)
{
    double page = (double)sysconf(_SC_PAGESIZE) * 1e-6;
    printf("cores          %ld\n", sysconf(_SC_NPROCESSORS_ONLN));
    printf("memory         %.0f MB, %.0f MB free\n", page * (double)sysconf(_SC_PHYS_PAGES),
           page * (double)sysconf(_SC_AVPHYS_PAGES));
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

int cmd_doctor_run(int argc, char **argv)
{
    static struct engine engine;
    struct config cfg;
    char have[CPU_NAMES_CAP], used[CPU_NAMES_CAP];
    const struct cmd_option options[] = {CMD_THREADS};
    const struct cmd_usage usage = {
        "doctor", "", "What this machine has, and what hdrig makes of it.", options, 1};
    int code;
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    err_t e = engine_open(&engine, cfg.threads);
    if (!e) {
        print_processor();
        printf("instructions   %s\n", cpu_names(cpu_detect(), have));
        printf("used           %s\n", cpu_names(engine.cpu, used));
        printf("kernels        splat: %s\n", engine.kernels.name);
        print_memory();
        printf("threads        %d\n", pool_size(engine.pool));
        printf("settings       %s, %s\n", CONFIG_DIR,
               file_is_dir(CONFIG_DIR) ? "read" : "not there: built-in values");
        dl_iterate_phdr(print_library, NULL);
    }
    engine_close(&engine);
    return cmd_finish(usage.name, e);
}
