/* report.h - JSON written member by member, in the order of the calls.
 * The code that closes the file asks for its errors, once.
 * thread: one per report. */
#ifndef RESULT_REPORT_H
#define RESULT_REPORT_H

#include <stdbool.h>
#include <stdio.h>

enum { REPORT_DEPTH = 8 }; // brackets inside brackets

struct report {
    FILE *f; // not owned
    int depth;
    bool empty; // the innermost bracket has no member yet
    char close[REPORT_DEPTH];
};

void report_init(struct report *r, FILE *f);

/* The outermost object of a file, with the member that marks it as ours (origin.h). report_close
 * ends it. */
void report_begin(struct report *r, FILE *f);

/* Begin an object '{' or an array '['. key: NULL inside an array and for the outermost bracket; the
 * same below. */
void report_open(struct report *r, const char *key, char bracket);

/* End the innermost bracket; a newline follows the outermost one. */
void report_close(struct report *r);

/* Six digits; null if v is not finite. */
void report_number(struct report *r, const char *key, double v);

/* An array of such numbers on one line. */
void report_row(struct report *r, const char *key, const double *v, int n);

void report_int(struct report *r, const char *key, long long v);
void report_bool(struct report *r, const char *key, bool v);

/* text: NULL for null; what is not UTF-8 in it becomes U+FFFD. */
void report_text(struct report *r, const char *key, const char *text);

#endif
