#include "firmware/cmd/cmd_rig.h"

#include "drivers/format/boardpdf.h"
#include "drivers/format/origin.h"

#include <string.h>

static err_t write_board(const char *out, const struct boardpdf *b)
{
    struct partial partial = {0};
    char at[FILE_PATH_CAP];
    err_t e = origin_check_place(out);
    if (!e)
        e = partial_open(out, &partial);
    if (!e)
        e = partial_path(&partial, out, at);
    if (!e)
        e = boardpdf_write(at, b);
    if (!e)
        e = partial_show(&partial, out);
    partial_close(&partial);
    if (!e)
        printf("%s: %d x %d tags of %g mm on %s; print it at 100 %% and measure the ruler, then "
               "hdrig rig calibrate TAKE... --tag %g --out FILE\n",
               out, b->board.cols, b->board.rows, b->tag, b->paper, b->tag);
    return e;
}

int cmd_rig_board(int argc, char **argv)
{
    const char *out = NULL, *paper = "a4", *tag = NULL;
    struct config cfg;
    struct boardpdf b;
    double mm = 0;
    int code;
    const struct cmd_option options[] = {
        {"out", "FILE", "the PDF", NULL, &out, NULL},
        {"paper", "P", BOARDPDF_PAPERS " (a4)", NULL, &paper, NULL},
        {"tag", "MM", "edge of a tag (six by four tags, as large as the paper allows)", NULL, &tag,
         NULL},
    };
    const struct cmd_usage usage = {
        "rig board", "--out FILE ",
        "A board of AprilTags to print, from which hdrig rig calibrate takes metres, and by which\n"
        "it ties cameras that see nothing in common.",
        options, sizeof options / sizeof options[0]};
    if (!cmd_parse(&usage, argc, argv, &cfg, &code))
        return code;
    if (!out)
        return cmd_misuse(&usage, "--out is needed");
    if (tag && cmd_number("--tag", tag, 1, 1000, &mm) != OK)
        return cmd_misuse(&usage, err_text());
    if (boardpdf_choose(paper, mm, &b) != OK)
        return cmd_misuse(&usage, err_text());
    return cmd_finish(usage.name, write_board(out, &b));
}
