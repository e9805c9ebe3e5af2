#include "drivers/format/photofile.h"

#include "drivers/format/heic.h"
#include "drivers/format/rawphoto.h"
#include "drivers/format/tiff.h"

/* Raw photographs are TIFF outside, so they come after it. */
static const struct photofile kinds[] = {
    {tiff_is, tiff_look, tiff_read, false},
    {heic_is, heic_look, heic_read, false},
    {rawphoto_is, rawphoto_look, rawphoto_read, true},
};

const struct photofile *photofile_of(const void *bytes, size_t n)
{
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++)
        if (kinds[i].is(bytes, n))
            return &kinds[i];
    return NULL;
}
