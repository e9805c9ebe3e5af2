/* Any bytes as a pickle: what is understood hangs together. */
#include "drivers/format/pickle.h"

#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void check(const struct pickle *p, const uint8_t *data, size_t size)
{
    if (p->root < 0 || p->root >= p->n_values)
        abort();
    long items = 0;
    for (int v = 0; v < p->n_values; v++) {
        const struct pickle_value *x = &p->values[v];
        int n = 0;
        for (int i = x->first; i >= 0 && items < 1 << 20; i = p->items[i].next, n++, items++)
            if (i >= p->n_items || p->items[i].value < 0 || p->items[i].value >= p->n_values)
                abort();
        if (items < 1 << 20 && (n != x->count || (x->kind == PICKLE_DICT && n % 2 != 0)))
            abort();
        if (x->kind == PICKLE_TEXT &&
            ((const uint8_t *)x->text < data ||
             x->n_text > (size_t)(data + size - (const uint8_t *)x->text)))
            abort();
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct pickle p;
    if (pickle_parse("input", data, size, &p) == OK) {
        check(&p, data, size);
        pickle_get(&p, &p.values[p.root], "state_dict");
        pickle_item(&p, &p.values[p.root], 3);
    }
    pickle_free(&p);
    return 0;
}
