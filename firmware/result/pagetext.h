/* pagetext.h - bytes into a page, as base64.
 * thread: one per stream. */
#ifndef RESULT_PAGETEXT_H
#define RESULT_PAGETEXT_H

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

struct pagetext {
    FILE *f; // not owned; whoever finishes it asks whether writing worked
    size_t n;
    uint8_t piece[3 * 1024];
};

void pagetext_begin(struct pagetext *t, FILE *f);
void pagetext_put(struct pagetext *t, const void *p, size_t n);
void pagetext_end(struct pagetext *t);

#endif
