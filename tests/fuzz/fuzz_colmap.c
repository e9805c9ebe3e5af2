/* First byte: bit 0 text or binary, bit 1 points. Then, for cameras and images, two bytes with the
 * length of the first file; the rest is the second. */
#include "drivers/format/colmap.h"

#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void parse_points(bool binary, const uint8_t *data, size_t size)
{
    struct colmap_points points;
    struct colmap_text text = {"points3D", data, size};
    if (colmap_parse_points(binary, &text, &points) && points.p)
        abort();
    colmap_free_points(&points);
}

static void parse_views(bool binary, const uint8_t *data, size_t size)
{
    struct rig rig;
    if (size < 2)
        return;
    size_t first = (size_t)data[0] | (size_t)data[1] << 8;
    data += 2;
    size -= 2;
    first = first < size ? first : size;
    struct colmap_text cameras = {"cameras", data, first},
                       images = {"images", data + first, size - first};
    if (colmap_parse(binary, &cameras, &images, &rig) && rig.views)
        abort();
    for (int i = 0; i < rig.n; i++)
        if (!(rig.views[i].cam.fx > 0) || !rig.views[i].name[0])
            abort();
    cameras_free(&rig);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size < 1)
        return 0;
    if (data[0] & 2)
        parse_points(data[0] & 1, data + 1, size - 1);
    else
        parse_views(data[0] & 1, data + 1, size - 1);
    return 0;
}
