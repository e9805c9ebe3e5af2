#include "firmware/recon/lpips_weights.h"

#include <string.h>

err_t lpips_weights_open(const char *path, struct lpips_weights *out)
{
    memset(out, 0, sizeof *out);
    err_t e = modelfile_open(path, &out->file);
    if (e)
        return e;
    e = lpips_bind(&out->file.model, &out->net);
    if (!e)
        return OK;
    lpips_weights_close(out);
    return err_fail(e, "%s: %s", path, err_text());
}

void lpips_weights_close(struct lpips_weights *w)
{
    modelfile_close(&w->file);
    memset(w, 0, sizeof *w);
}
