/* verify_take FOLDER - compares a take with its manifest. */
#include "firmware/store/store.h"

#include <stdio.h>

int main(int argc, char **argv)
{
    err_t e = argc == 2 ? store_verify(argv[1]) : err_fail(ERR_ARG, "usage: verify_take FOLDER");
    if (e)
        fprintf(stderr, "%s\n", err_text());
    return e != OK;
}
