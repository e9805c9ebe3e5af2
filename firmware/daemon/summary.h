/* summary.h - a stored take in a few words, read from its manifest.
 * thread: any. */
#ifndef DAEMON_SUMMARY_H
#define DAEMON_SUMMARY_H

#include "firmware/store/manifest.h"
#include "firmware/store/store.h"

#include <stdbool.h>
#include <stdio.h>

enum { SUMMARY_EXPOSURES = 3, SUMMARY_IMAGES = MANIFEST_CAMERAS_MAX };

struct summary {
    char id[STORE_ID_CAP];
    char session[STORE_ID_CAP]; // session that it is a place of (places.h); "": none
    bool complete;
    int frames, cameras;
    double stops;         // range of the scene; 0: not metered
    double clipped, dark; // shares, worst camera; -1: not known
    char reason[TAKE_TEXT];
    int n_images;
    char image[SUMMARY_IMAGES][32]; // names in images/: of one camera up to SUMMARY_EXPOSURES, of
                                    // more the middle exposure of each
    int64_t report_ns;              // mtime of the report that was read last, and
    int warnings;                   // those in it
};

/* err: ERR_IO, ERR_FORMAT */
MUST_USE err_t summary_read(const char *store, const char *id, struct summary *out);

/* Warnings in the report of the scene of that take or of its session, -1 if there is no scene. The
 * report is read only if it changed since the last call, which *s remembers. */
int summary_warnings(const char *results, struct summary *s);

/* As a JSON object; warnings: as summary_warnings returned them. */
void summary_write(const struct summary *s, int warnings, FILE *out);

#endif
