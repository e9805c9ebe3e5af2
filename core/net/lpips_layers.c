#include "core/net/lpips_layers.h"

#include <stddef.h>
#include <string.h>

enum { N_NETS = LPIPS_ALEXNET };

static const struct lpips_layers nets[N_NETS] = {
    {"vgg16",
     {{1, 1, 64, 2, {{0, 3, 1, 1}, {2, 3, 1, 1}}},
      {2, 2, 128, 2, {{5, 3, 1, 1}, {7, 3, 1, 1}}},
      {2, 2, 256, 3, {{10, 3, 1, 1}, {12, 3, 1, 1}, {14, 3, 1, 1}}},
      {2, 2, 512, 3, {{17, 3, 1, 1}, {19, 3, 1, 1}, {21, 3, 1, 1}}},
      {2, 2, 512, 3, {{24, 3, 1, 1}, {26, 3, 1, 1}, {28, 3, 1, 1}}}}},
    {"alexnet",
     {{1, 1, 64, 1, {{0, 11, 4, 2}}},
      {3, 2, 192, 1, {{3, 5, 1, 2}}},
      {3, 2, 384, 1, {{6, 3, 1, 1}}},
      {1, 1, 256, 1, {{8, 3, 1, 1}}},
      {1, 1, 256, 1, {{10, 3, 1, 1}}}}},
};

const struct lpips_layers *lpips_layers_of(enum lpips_net net)
{
    return net > LPIPS_NONE && net <= LPIPS_ALEXNET ? &nets[net - 1] : NULL;
}

enum lpips_net lpips_layers_named(const char *name)
{
    for (int i = 0; i < N_NETS; i++)
        if (strcmp(nets[i].name, name) == 0)
            return (enum lpips_net)(i + 1);
    return LPIPS_NONE;
}
