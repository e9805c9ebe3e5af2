/* First byte: a button, a lamp, or options of a table with every kind of value; the rest is the
 * URI. What is accepted is within its table. */
#include "drivers/device/gpio.h"
#include "drivers/device/uri.h"

#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

struct options {
    int64_t whole;
    double real;
    int word;
    char text[URI_TEXT];
};

#define AT(field) offsetof(struct options, field)
static const struct uri_key keys[] = {
    {"whole", AT(whole), URI_WHOLE, -1, 9007199254740992.0, NULL},
    {"real", AT(real), URI_REAL, 0.5, 1e8, NULL},
    {"word", AT(word), URI_WORD, 0, 0, "one|three|"},
    {"text", AT(text), URI_STRING, 0, 0, NULL},
};

static void must(bool truth)
{
    if (!truth)
        abort();
}

static void table(const char *text)
{
    struct options o = {.real = 1};
    const struct uri_table t = {keys, sizeof keys / sizeof keys[0], &o};
    err_t e = uri_parse("fuzz", text, &t, 1);
    must(!e || (e == ERR_ARG && *err_text()));
    must(o.whole >= -1 && o.whole <= INT64_C(9007199254740992));
    must(o.real >= 0.5 && o.real <= 1e8 && o.word >= 0 && o.word <= 2);
    must(memchr(o.text, 0, sizeof o.text) != NULL);
}

static void line(const char *text, enum gpio_use use)
{
    struct gpio_spec requested;
    uint32_t offset;
    err_t e = gpio_parse(text, "gpio", use, &requested);
    must(!e || (e == ERR_ARG && *err_text()));
    if (e)
        return;
    must(*requested.chip && *requested.line && strncmp(requested.uri, "gpio:", 5) == 0);
    must(requested.bias >= GPIO_BIAS_UP && requested.bias <= GPIO_BIAS_NONE);
    must(requested.debounce_ms >= 0 && requested.debounce_ms <= 1000);
    must((unsigned)requested.rising <= 1 && (unsigned)requested.active_low <= 1);
    must(!gpio_offset(&requested, &offset) ||
         strspn(requested.line, "0123456789") == strlen(requested.line));
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size < 1)
        return 0;
    char *text = malloc(size); // its end is seen by sanitizers
    if (!text)
        return 0;
    memcpy(text, data + 1, size - 1);
    text[size - 1] = 0;
    if (data[0] % 3 == 0)
        table(text);
    else
        line(text, data[0] % 3 == 1 ? GPIO_BUTTON : GPIO_LAMP);
    free(text);
    return 0;
}
